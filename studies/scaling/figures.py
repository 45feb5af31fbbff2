"""Figures of the scaling study, for one column of a paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayesfric.report.figures.style import COLUMN, PALETTE, paper_style

LABELS = {
    "gearbox.alpha_drive": r"$\alpha_1$",
    "gearbox.alpha_back": r"$\alpha_2$",
    "load.first_moment": r"$ml$ (kg m)",
}
NAMES = {
    "flat": "flat priors",
    "cad-moment": r"$ml$ from CAD, 2.5 %",
    "known-mass": "known mass",
}


def interval_figure(positions: Mapping[str, np.ndarray]) -> Figure:
    """Draw histograms of the scale between its bounds by dissipativity."""
    with paper_style():
        figure = Figure(figsize=(COLUMN, 0.62 * COLUMN))
        ax = figure.add_axes((0.13, 0.2, 0.84, 0.76))
        edges = np.linspace(0.0, 1.0, 61)
        for k, (case, position) in enumerate(positions.items()):
            ax.hist(
                position,
                bins=edges,
                density=True,
                histtype="step",
                color=PALETTE[k],
                linestyle=("-", "--", ":")[k],
                label=NAMES[case],
            )
        for end, text, side in (
            (0.0, r"$\alpha_2 = 1$", "left"),
            (1.0, r"$\alpha_1 = 1$", "right"),
        ):
            ax.axvline(end, color="0.4", linewidth=0.6)
            ax.annotate(
                text,
                (end, 0.94),
                xycoords=("data", "axes fraction"),
                xytext=(3 if side == "left" else -3, 0),
                textcoords="offset points",
                ha=side,
                va="top",
            )
        ax.set_xlim(-0.03, 1.03)
        ax.set_xlabel("place of ln(scale) between its bounds (no unit)")
        ax.set_ylabel("density (no unit)")
        ax.legend(loc="upper left", bbox_to_anchor=(0.03, 0.85))
    return figure


def lifted_figure(
    cases: Mapping[str, str],
    rows: Mapping[str, Mapping[str, Any]],
    truth: Mapping[str, float],
    names: Sequence[str],
) -> Figure:
    """Draw 90 % intervals by additional knowledge, filled where the data determine them."""
    with paper_style():
        figure = Figure(figsize=(2.05 * COLUMN, 0.8 * COLUMN))
        axes = figure.subplots(1, len(names), sharey=True)
        figure.subplots_adjust(left=0.3, right=0.985, bottom=0.16, top=0.9, wspace=0.12)
        for ax, name in zip(axes, names, strict=True):
            for y, case in enumerate(cases):
                row = rows[case][name]
                if row is None:
                    continue
                by_data = row["verdict"] == "data"
                low, high = row["interval"]
                ax.plot(
                    [low, high],
                    [y, y],
                    color="black" if by_data else "0.55",
                    linewidth=1.4 if by_data else 0.8,
                    linestyle="-" if by_data else (0, (4, 2)),
                )
                ax.plot(
                    row["median"],
                    y,
                    "o",
                    markersize=3.5,
                    color="black" if by_data else "0.55",
                    markerfacecolor="black" if by_data else "white",
                )
            ax.axvline(truth[name], color=PALETTE[0], linewidth=0.8, linestyle=":")
            ax.set_xlabel(LABELS[name] if "(" in LABELS[name] else f"{LABELS[name]} (no unit)")
            ax.set_ylim(len(cases) - 0.4, -0.6)
        axes[0].set_yticks(range(len(cases)), list(cases.values()))
        axes[0].tick_params(axis="y", length=0)
        handles = [
            figure.axes[0].plot([], [], "-o", color="black", markersize=3.5, linewidth=1.4)[0],
            figure.axes[0].plot(
                [],
                [],
                "o",
                linestyle=(0, (4, 2)),
                color="0.55",
                markerfacecolor="white",
                markersize=3.5,
                linewidth=0.8,
            )[0],
            figure.axes[0].plot([], [], ":", color=PALETTE[0], linewidth=0.8)[0],
        ]
        figure.legend(
            handles,
            ["determined by the data", "held by prior or bounds", "truth (simulated)"],
            loc="upper right",
            ncols=3,
            borderaxespad=0.1,
        )
    return figure
