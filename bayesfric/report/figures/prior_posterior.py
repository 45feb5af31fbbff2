"""Prior against posterior of every parameter, with the verdict in each panel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesfric.inference.fit import Fit
from bayesfric.report.comparison.cell import Cell, posterior_cells
from bayesfric.report.figures.marginal import draw_marginal, marginal_handles
from bayesfric.report.figures.quantity import Quantity, not_shown, quantities
from bayesfric.report.figures.style import PAGE, SMALL, add_panels, few_ticks, paper_style

_COLUMNS = 4
_MOST = 24
# A prior this many times as wide as the posterior would leave it no room.
_WIDEST = 6.0

_LEFT, _RIGHT, _TOP, _BETWEEN = 0.10, 0.10, 0.26, 0.16
_PANEL, _BELOW = 0.80, 0.42
_WORDS = {
    "data": "data",
    "weak": "weak: prior and data",
    "prior": "prior: NOT determined",
}


def prior_posterior_figure(fit: Fit, summary: Mapping[str, Any]) -> Figure:
    """Draw prior and posterior density of each sampled parameter.

    Densities are scaled to the panel. A panel shows the whole prior where that is at most
    some times as wide as the posterior, else the posterior with the prior passing through;
    the ratio of the two sds stands beside the verdict.

    Parameters
    ----------
    fit
        A finished fit.
    summary
        From :func:`bayesfric.report.summary.summary.summarise`, for the verdicts.

    Returns
    -------
    matplotlib.figure.Figure
        A page wide, four panels in a row, at most twenty-four.
    """
    everything = quantities(fit)
    shown, left_out = everything[:_MOST], everything[_MOST:]
    judged = posterior_cells(summary)
    cells = [judged[q.name] for q in shown]
    rows = -(-len(shown) // _COLUMNS)
    height = _TOP + rows * (_PANEL + _BELOW)
    with paper_style():
        figure = Figure(figsize=(PAGE, height))
        panels = add_panels(
            figure, len(shown), _COLUMNS, left=_LEFT, right=_RIGHT, top=_TOP, between=_BETWEEN,
            panel=_PANEL, below=_BELOW,
        )  # fmt: skip
        for ax, q, cell in zip(panels, shown, cells, strict=True):
            _panel(ax, q, summary["parameters"][q.name], cell)
        _legend(figure, cells, not_shown(left_out))
    return figure


def _panel(ax: Axes, q: Quantity, row: Mapping[str, Any], cell: Cell) -> None:
    words = _WORDS[row["verdict"]] if cell.converged else "NOT converged"
    # what the data push against a bound they do determine: from the other side
    words = cell.remark if cell.status == "limit" else words
    # room for the verdict
    draw_marginal(ax, q, _range(q), cell=cell, headroom=1.35)
    few_ticks(ax.xaxis, 3, inner=True)
    ax.set_xlabel(q.label())
    said: dict[str, Any] = {"va": "top", "fontsize": SMALL, "transform": ax.transAxes}
    ax.text(0.03, 0.97, words, ha="left", gid="verdict", **said)
    if row["prior_sd"] and row["sd"] and row["prior_sd"] > _WIDEST * row["sd"]:
        ratio = row["prior_sd"] / row["sd"]
        ax.text(0.97, 0.97, rf"1:{_two_digits(ratio)}", ha="right", gid="ratio", **said)


def _two_digits(x: float) -> str:
    return f"{float(f'{x:.2g}'):.0f}" if x < 1e4 else rf"$10^{{{round(np.log10(x))}}}$"


def _range(q: Quantity) -> tuple[float, float]:
    """All of the posterior, and of the prior as much as leaves that half of the width or so."""
    prior, draws = q.prior, q.draws / q.factor
    assert prior is not None  # a sampled parameter has one
    low, high = (float(x) for x in np.quantile(draws, [0.001, 0.999]))
    margin = 0.08 * (high - low) or 0.05 * abs(low) or 1.0
    low, high = low - margin, high + margin
    # a bound is part of the prior, and the density beyond it is none
    bounds = (prior.lower / q.factor, prior.upper / q.factor)
    low, high = max(low, bounds[0]), min(high, bounds[1])
    drawn = prior.draw(1000, np.random.default_rng(np.random.SeedSequence(0))) / q.factor
    first, last = (float(x) for x in np.quantile(drawn, [0.01, 0.99]))
    if last - first < _WIDEST * (high - low):
        low, high = min(low, first), max(high, last)
    return low, high


def _legend(figure: Figure, cells: Sequence[Cell], remark: str) -> None:
    ratio = Line2D([], [], linestyle="none", label="1:n  sd of posterior to prior")
    figure.legend(
        handles=[*marginal_handles(cells), ratio],
        loc="upper left",
        ncols=5,
        bbox_to_anchor=(_LEFT / PAGE, 1.0),
        borderaxespad=0.2,
        borderpad=0.2,
        columnspacing=1.2,
        handlelength=1.8,
    )
    if remark:
        figure.text(1.0 - _RIGHT / PAGE, 0.005, remark, ha="right", va="bottom", fontsize=SMALL)
