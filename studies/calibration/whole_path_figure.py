"""Draw ``whole_path.json``: how often intervals hold the truth, case by case.

``python studies/calibration/whole_path_figure.py`` writes ``figures/calibration/whole_path`` and
prints the table of the README.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from bayesfric.report.figures.style import BAND, COLUMN, PALETTE, SMALL, paper_style, save

HERE = Path(__file__).resolve().parent
FOLDER = HERE.parents[1] / "figures" / "calibration"
# What was asked for, of 90 % intervals.
WANTED = (0.85, 0.95)
# Intervals of which a share says something.
FEWEST = 30
# Where the axis begins; what lies below is written there.
BEGIN = 0.6


def draw(result: dict[str, Any]) -> Figure:
    """One row a case: a mark for each quantity that is identified, a bar for all of them."""
    figure = Figure(figsize=(COLUMN, 0.24 * len(result) + 0.75), layout="constrained")
    ax = figure.subplots()
    ax.axvspan(*WANTED, color=BAND, linewidth=0.0)
    ax.axvline(0.9, color="black", linewidth=0.5)
    for place, case in enumerate(result.values()):
        rows, whole = _identified(case)
        ax.plot(
            [row["coverage"] for row in rows.values()],
            [place] * len(rows),
            linestyle="none",
            marker="o",
            markersize=2.6,
            markerfacecolor="none",
            markeredgewidth=0.6,
            color=PALETTE[1],
        )
        for row in rows.values():
            if row["coverage"] < BEGIN:  # beyond the frame, and said there
                beside = {"xytext": (2.0, 3.0), "textcoords": "offset points", "va": "bottom"}
                said = f"{row['coverage']:.0%}".replace("%", " %")
                ax.plot([BEGIN], [place], "<", color=PALETTE[1], markersize=3.5, clip_on=False)
                ax.annotate(said, (BEGIN, place), fontsize=SMALL, **beside)
        ax.plot(
            [whole["coverage"]], [place], linestyle="none", marker="|", markersize=9, color="black"
        )
    ax.set_yticks(range(len(result)), [*result], fontsize=SMALL)
    ax.set_ylim(len(result) - 0.5, -0.5)
    ax.set_xlim(BEGIN, 1.01)
    ax.set_xlabel("share of intervals that hold the truth")
    ax.tick_params(axis="y", length=0)
    return figure


def _identified(case: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Give what is identified often enough for a share, by name, and all of it."""
    rows = dict(case["statuses"]["identified"])
    whole = rows.pop("all")
    return {name: row for name, row in rows.items() if row["intervals"] >= FEWEST}, whole


def table(result: dict[str, Any]) -> list[str]:
    """Lay the cases out as Markdown."""
    lines = [
        "| case | recordings | with findings | identified | lowest quantity | posterior alone "
        "| width over its, median, 90th percentile | limits, prior |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, case in result.items():
        rows, whole = _identified(case)
        least = min(rows, key=lambda n: rows[n]["coverage"])
        others = [
            case["statuses"][key]["all"] for key in ("limit", "prior") if key in case["statuses"]
        ]
        count = sum(one["intervals"] for one in others)
        held = sum(one["intervals"] * one["coverage"] for one in others) / max(count, 1)
        lines.append(
            f"| {name} | {case['recordings'] - len(case['refused'])} | {case['findings']} "
            f"| {whole['coverage']:.1%} ± {whole['error']:.1%} of {whole['intervals']} "
            f"| {rows[least]['coverage']:.0%} ({least}) | {whole['posterior_coverage']:.0%} "
            f"| {whole['wider'][0]:.2f}, {whole['wider'][1]:.2f} "
            f"| {f'{held:.0%} of {count}' if count else ''} |"
        )
    return lines


def main() -> None:
    result = json.loads((HERE / "whole_path.json").read_text(encoding="utf-8"))
    FOLDER.mkdir(parents=True, exist_ok=True)
    with paper_style():
        figure = draw(result)
    save(figure, FOLDER, "whole_path")
    print("\n".join(table(result)))


if __name__ == "__main__":
    main()
