"""Prior against posterior of every parameter, with the verdict in each panel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesfric.inference.fit import Fit
from bayesfric.inference.priors import Prior
from bayesfric.report.comparison_cell import posterior_cell
from bayesfric.report.quantity import Quantity, not_shown, quantities
from bayesfric.report.run_summary import PosteriorRow
from bayesfric.report.style import (
    OPEN_HATCH,
    PAGE,
    POSTERIOR,
    PRIOR,
    SMALL,
    Array,
    few_ticks,
    paper_style,
)
from bayesfric.report.summary import LEVEL

_COLUMNS = 4
_MOST = 24
_BINS = 40
_GRID = 301
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
        From :func:`bayesfric.report.summary.summarise`, for the verdicts.

    Returns
    -------
    matplotlib.figure.Figure
        A page wide, four panels in a row, at most twenty-four.
    """
    everything = quantities(fit)
    shown, left_out = everything[:_MOST], everything[_MOST:]
    rows = -(-len(shown) // _COLUMNS)
    height = _TOP + rows * (_PANEL + _BELOW)
    width = (PAGE - _LEFT - _RIGHT - (_COLUMNS - 1) * _BETWEEN) / _COLUMNS
    with paper_style():
        figure = Figure(figsize=(PAGE, height))
        for k, q in enumerate(shown):
            row, column = divmod(k, _COLUMNS)
            ax = figure.add_axes(
                (
                    (_LEFT + column * (width + _BETWEEN)) / PAGE,
                    1.0 - (_TOP + row * (_PANEL + _BELOW) + _PANEL) / height,
                    width / PAGE,
                    _PANEL / height,
                )
            )
            _panel(ax, q, summary["parameters"][q.name])
        _legend(figure, not_shown(left_out))
    return figure


def _panel(ax: Axes, q: Quantity, row: Mapping[str, Any]) -> None:
    cell = posterior_cell(PosteriorRow.model_validate(row), accounts=True)
    # what the data push against a bound they do determine: from the other side
    open_ = cell.status == "undetermined"
    words = cell.remark if cell.status == "limit" else _WORDS[row["verdict"]]
    draws = q.draws / q.factor
    prior_of = q.prior
    assert prior_of is not None  # a sampled parameter has one
    low, high = _range(prior_of, q.factor, draws)
    grid = np.linspace(low, high, _GRID)
    prior = np.exp(prior_of.log_density(grid * q.factor)) * q.factor
    prior = np.where(np.isfinite(prior), prior, np.nan)
    top = float(np.nanmax(prior, initial=0.0))
    if np.ptp(draws) > 1e-12 * np.abs(draws).max():
        density, edges = np.histogram(draws, bins=_BINS, range=(low, high), density=True)
        peak = float(density.max())
        # a prior may have a pole at its bound; it must not flatten the posterior
        top = max(peak, min(2.0 * peak, top))
        ax.stairs(
            density,
            edges,
            fill=True,
            facecolor="none" if open_ else POSTERIOR,
            edgecolor=POSTERIOR if open_ else "none",
            alpha=1.0 if open_ else 0.3,
            hatch=OPEN_HATCH if open_ else None,
            linewidth=0.0,
            gid="open" if open_ else "posterior",
        )
        ax.stairs(density, edges, color=POSTERIOR, linewidth=0.8)
        for bound in np.quantile(draws, [0.5 - LEVEL / 2, 0.5 + LEVEL / 2]):
            ax.axvline(bound, ymax=0.8, color=POSTERIOR, linewidth=0.7, linestyle=(0, (1.0, 1.0)))
    else:
        ax.axvline(float(draws[0]), color=POSTERIOR)
    ax.plot(grid, prior, color=PRIOR, linestyle=(0, (4.0, 1.5)), gid="prior")
    # room for the verdict
    ax.set_ylim(0.0, 1.35 * top or 1.0)
    ax.set_xlim(low, high)
    ax.set_yticks([])
    few_ticks(ax.xaxis, 3, inner=True)
    ax.set_xlabel(q.label())
    said: dict[str, Any] = {"va": "top", "fontsize": SMALL, "transform": ax.transAxes}
    ax.text(0.03, 0.97, words, ha="left", gid="verdict", **said)
    if row["prior_sd"] and row["sd"] and row["prior_sd"] > _WIDEST * row["sd"]:
        ratio = row["prior_sd"] / row["sd"]
        ax.text(0.97, 0.97, rf"1:{_two_digits(ratio)}", ha="right", gid="ratio", **said)


def _two_digits(x: float) -> str:
    return f"{float(f'{x:.2g}'):.0f}" if x < 1e4 else rf"$10^{{{round(np.log10(x))}}}$"


def _range(prior: Prior, factor: float, draws: Array) -> tuple[float, float]:
    """All of the posterior, and of the prior as much as leaves that half of the width or so."""
    low, high = (float(x) for x in np.quantile(draws, [0.001, 0.999]))
    margin = 0.08 * (high - low) or 0.05 * abs(low) or 1.0
    low, high = low - margin, high + margin
    # a bound is part of the prior, and the density beyond it is none
    bounds = (prior.lower / factor, prior.upper / factor)
    low, high = max(low, bounds[0]), min(high, bounds[1])
    drawn = prior.draw(1000, np.random.default_rng(np.random.SeedSequence(0))) / factor
    first, last = (float(x) for x in np.quantile(drawn, [0.01, 0.99]))
    if last - first < _WIDEST * (high - low):
        low, high = min(low, first), max(high, last)
    return low, high


def _legend(figure: Figure, remark: str) -> None:
    dotted = (0, (1.0, 1.0))
    figure.legend(
        handles=[
            Patch(facecolor=POSTERIOR, alpha=0.3, label="posterior"),
            Patch(
                facecolor="none",
                edgecolor=POSTERIOR,
                hatch=OPEN_HATCH,
                linewidth=0.0,
                label="posterior that the data leave open",
            ),
            Line2D([], [], color=PRIOR, linestyle=(0, (4.0, 1.5)), label="prior"),
            Line2D(
                [],
                [],
                color=POSTERIOR,
                linewidth=0.7,
                linestyle=dotted,
                label=f"{100 * LEVEL:.0f} % interval",
            ),
            Line2D([], [], linestyle="none", label="1:n  sd of posterior to prior"),
        ],
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
