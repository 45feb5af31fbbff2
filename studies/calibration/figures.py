"""Draw ``result.json``: empirical distribution of ranks minus the uniform one.

``python studies/calibration/figures.py`` writes ``figures/calibration``.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayesfric.report.figures.style import BAND, PAGE, PALETTE, SMALL, paper_style, save

FOLDER = Path(__file__).resolve().parent
FIGURES = FOLDER.parents[1] / "figures" / "calibration"
COLUMNS = 3


def draw(result: dict[str, Any]) -> Figure:
    """Draw one panel per case, with all its quantities and one band."""
    rows = math.ceil(len(result) / COLUMNS)
    figure = Figure(figsize=(PAGE, 1.75 * rows + 0.35), layout="constrained")
    axes = figure.subplots(rows, COLUMNS, sharex=True, sharey=True, squeeze=False)
    for ax, (name, case) in zip(axes.flat, result.items(), strict=False):
        _panel(ax, name, case)
    for ax in list(axes.flat)[len(result) :]:
        ax.axis("off")
    for ax in axes[:, 0]:
        ax.set_ylabel("ECDF minus uniform")
    for ax in list(axes.flat)[max(0, len(result) - COLUMNS) : len(result)]:
        ax.set_xlabel("rank of the truth among the draws")
        ax.tick_params(labelbottom=True)
    return figure


def _panel(ax: Any, name: str, case: dict[str, Any]) -> None:
    z = np.arange(1, case["ranked"] + 1) / (case["ranked"] + 1.0)
    low, high = (np.array(side) for side in case["band"])
    ax.fill_between(z, low, high, color=BAND, linewidth=0.0, step="mid")
    ax.axhline(0.0, color="black", linewidth=0.4)
    outside = 0
    for row in case["quantities"].values():
        outside += not row["inside"]
        ax.plot(
            z,
            row["difference"],
            color=PALETTE[1] if row["inside"] else PALETTE[2],
            linewidth=0.6 if row["inside"] else 1.1,
            linestyle="solid" if row["inside"] else (0, (4.0, 1.5)),
        )
    words = name.replace("control: ", "control:\n")
    words += f"\n{case['recordings']} recordings, {outside} of {len(case['quantities'])} outside"
    label = ax.text(0.03, 0.96, words, transform=ax.transAxes, va="top", fontsize=SMALL)
    label.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 1.0})
    label.set_in_layout(False)
    ax.set_xlim(0.0, 1.0)
    # space for the label, and for controls that fail clearly
    ax.set_ylim(-0.3, 0.5)


def main() -> None:
    """Write the figure."""
    result = json.loads((FOLDER / "result.json").read_text(encoding="utf-8"))
    FIGURES.mkdir(parents=True, exist_ok=True)
    with paper_style():
        figure = draw(result)
    save(figure, FIGURES, "ranks")


if __name__ == "__main__":
    main()
