"""Draw ``whole_path.json``: coverage of intervals, case by case.

``python studies/calibration/whole_path_figure.py`` writes ``figures/calibration/whole_path`` and
prints the table of the README.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from bayesfric.report.figures.style import BAND, COLUMN, PALETTE, SMALL, paper_style, save

FOLDER = Path(__file__).resolve().parent
FIGURES = FOLDER.parents[1] / "figures" / "calibration"
# Accepted coverage of 90 % intervals.
TARGET = (0.85, 0.95)
# Minimum number of intervals for a share.
FEWEST = 30
# Start of the axis; lower values are written as text.
AXIS_START = 0.6


def draw(result: dict[str, Any]) -> Figure:
    """Draw one row per case: a mark for each identified quantity, a bar for all of them."""
    figure = Figure(figsize=(COLUMN, 0.24 * len(result) + 0.75), layout="constrained")
    ax = figure.subplots()
    ax.axvspan(*TARGET, color=BAND, linewidth=0.0)
    ax.axvline(0.9, color="black", linewidth=0.5)
    for position, case in enumerate(result.values()):
        rows, total = _identified(case)
        ax.plot(
            [row["coverage"] for row in rows.values()],
            [position] * len(rows),
            linestyle="none",
            marker="o",
            markersize=2.6,
            markerfacecolor="none",
            markeredgewidth=0.6,
            color=PALETTE[1],
        )
        for row in rows.values():
            if row["coverage"] < AXIS_START:  # outside the axes, as text
                placement = {"xytext": (2.0, 3.0), "textcoords": "offset points", "va": "bottom"}
                label = f"{row['coverage']:.0%}".replace("%", " %")
                ax.plot(
                    [AXIS_START], [position], "<", color=PALETTE[1], markersize=3.5, clip_on=False
                )
                ax.annotate(label, (AXIS_START, position), fontsize=SMALL, **placement)
        ax.plot(
            [total["coverage"]],
            [position],
            linestyle="none",
            marker="|",
            markersize=9,
            color="black",
        )
    ax.set_yticks(range(len(result)), [*result], fontsize=SMALL)
    ax.set_ylim(len(result) - 0.5, -0.5)
    ax.set_xlim(AXIS_START, 1.01)
    ax.set_xlabel("share of intervals that hold the truth")
    ax.tick_params(axis="y", length=0)
    return figure


def _identified(case: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the quantities that are identified often enough for a share, and their total."""
    rows = dict(case["statuses"]["identified"])
    total = rows.pop("all")
    return {name: row for name, row in rows.items() if row["intervals"] >= FEWEST}, total


def _share(rows: dict[str, Any], name: str | None) -> str:
    return f"{rows[name]['coverage']:.0%} ({name})" if name else "–"


def table(result: dict[str, Any]) -> list[str]:
    """Format the cases as Markdown."""
    lines = [
        "| case | recordings | with findings | identified | lowest quantity | posterior alone "
        "| width over its, median, 90th percentile | limits, prior |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name, case in result.items():
        rows, total = _identified(case)
        lowest = min(rows, key=lambda n: rows[n]["coverage"], default=None)
        others = [
            case["statuses"][key]["all"] for key in ("limit", "prior") if key in case["statuses"]
        ]
        count = sum(group["intervals"] for group in others)
        held = sum(group["intervals"] * group["coverage"] for group in others) / max(count, 1)
        lines.append(
            f"| {name} | {case['recordings'] - len(case['refused'])} | {case['findings']} "
            f"| {total['coverage']:.1%} ± {total['error']:.1%} of {total['intervals']} "
            f"| {_share(rows, lowest)} "
            f"| {total['posterior_coverage']:.0%} "
            f"| {total['wider'][0]:.2f}, {total['wider'][1]:.2f} "
            f"| {f'{held:.0%} of {count}' if count else ''} |"
        )
    return lines


def main() -> None:
    """Write the figure and print the table."""
    result = json.loads((FOLDER / "whole_path.json").read_text(encoding="utf-8"))
    FIGURES.mkdir(parents=True, exist_ok=True)
    with paper_style():
        figure = draw(result)
    save(figure, FIGURES, "whole_path")
    print("\n".join(table(result)))


if __name__ == "__main__":
    main()
