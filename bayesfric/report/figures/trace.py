"""Trace plot: do the ensembles agree, and how fast do they forget."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from bayesfric.inference.fit import Fit
from bayesfric.inference.sampling.convergence import autocorrelation
from bayesfric.report.figures.quantity import Quantity, not_shown, quantities
from bayesfric.report.figures.style import (
    PAGE,
    SMALL,
    Array,
    few_ticks,
    line_style,
    margins,
    paper_style,
)
from bayesfric.report.summary.summary import LEVEL

_MOST = 14
_TALLEST = 9.0  # inches; a page
_ROW = 0.72
_LEFT, _RIGHT, _TOP, _BOTTOM = 1.22, 0.14, 0.30, 0.36


def trace_figure(fit: Fit) -> Figure:
    """Draw the way of every ensemble and its autocorrelation.

    On the left the median of each ensemble's walkers at every kept step and a
    90 % band over them; on the right the autocorrelation of the walkers over
    the lag in steps of the sampler.

    Parameters
    ----------
    fit
        A finished fit.

    Returns
    -------
    matplotlib.figure.Figure
        A page wide, at most nine inches high; a row for each of at most
        fourteen parameters, noise scales last.
    """
    everything = quantities(fit)
    shown, left_out = everything[:_MOST], everything[_MOST:]
    diagnostics = fit.posterior.diagnostics
    with paper_style():
        height = min(_TALLEST, _TOP + _BOTTOM + _ROW * len(shown))
        figure = Figure(figsize=(PAGE, height))
        axes = figure.subplots(
            len(shown),
            2,
            squeeze=False,
            sharex="col",
            gridspec_kw={
                **margins(figure, left=_LEFT, right=_RIGHT, bottom=_BOTTOM, top=_TOP),
                "wspace": 0.17,
                "hspace": 0.12,
                "width_ratios": (2.0, 1.0),
            },
        )
        longest = _longest_lag(fit)
        for (left, right), q, tau in zip(axes, shown, diagnostics.tau, strict=False):
            ensembles = fit.posterior[q.name]
            _trace(left, q, ensembles / q.factor, diagnostics.thin)
            _forgetting(right, ensembles, diagnostics.thin, float(tau), longest)
        axes[-1, 0].set_xlabel("step after warm-up")
        axes[-1, 1].set_xlabel("lag (steps)")
        axes[-1, 0].set_xlim(0, max(diagnostics.thin * fit.posterior.draws.shape[2], 1))
        axes[-1, 1].set_xlim(0, longest)
        few_ticks(axes[-1, 1].xaxis, 6)
        for ax in axes[:, 0]:
            ax.yaxis.set_label_coords(-0.42 / (ax.get_position().width * PAGE), 0.5)
        _legend(figure, fit.posterior.draws.shape[0], not_shown(left_out))
    return figure


def _trace(ax: Axes, q: Quantity, draws: Array, thin: int) -> None:
    # the first kept draw is the one at the end of the first `thin` steps
    steps = thin * np.arange(1, draws.shape[2] + 1)
    for k, ensemble in enumerate(draws):
        colour, dashes = line_style(k)
        low, middle, high = np.quantile(ensemble, [0.5 - LEVEL / 2, 0.5, 0.5 + LEVEL / 2], axis=0)
        ax.fill_between(steps, low, high, color=colour, alpha=0.1, linewidth=0.0)
        ax.plot(steps, middle, color=colour, linestyle=dashes)
    # upright, for a long unit is wider than a row is high
    ax.set_ylabel(q.label("\n"), rotation=0.0, ha="right", va="center", linespacing=1.2)
    ax.margins(y=0.1)
    few_ticks(ax.yaxis, 3, inner=True)


def _forgetting(ax: Axes, ensembles: Array, thin: int, tau: float, longest: float) -> None:
    ax.axhline(0.0, color="0.6", linewidth=0.5)
    for k, ensemble in enumerate(ensembles):
        moving = _moving(ensemble)
        if moving.shape[0] == 0:
            continue
        colour, dashes = line_style(k)
        rho = autocorrelation(moving)
        lags = thin * np.arange(rho.size)
        inside = lags <= longest + thin
        ax.plot(
            lags[inside], rho[inside], color=colour, linestyle=dashes, marker=".", markersize=2.0
        )
    ax.set_ylim(-0.35, 1.1)
    ax.set_yticks([0.0, 0.5, 1.0])
    ax.set_ylabel("ACF")
    said = rf"$\tau$ = {tau:.3g} steps" if np.isfinite(tau) else "never moved"
    ax.text(0.97, 0.88, said, ha="right", va="top", fontsize=SMALL, transform=ax.transAxes)


def _moving(ensemble: Array) -> Array:
    """Leave walkers out that never moved: their autocorrelation is 0/0."""
    moved: NDArray[np.bool_] = np.ptp(ensemble, axis=1) > 0.0
    return ensemble[moved]


def _longest_lag(fit: Fit) -> float:
    """Far enough to see the slowest parameter forget, and at least ten kept draws."""
    d = fit.posterior.diagnostics
    finite = d.tau[np.isfinite(d.tau)]
    wanted = max(6.0 * float(finite.max(initial=0.0)), 10.0 * d.thin)
    return float(max(min(wanted, d.thin * fit.posterior.draws.shape[2] / 2.0), d.thin))


def _legend(figure: Figure, ensembles: int, remark: str) -> None:
    # sixteen line styles differ; a legend of more would be longer than the page is wide
    named = min(ensembles, 6)
    handles = []
    for k in range(named):
        colour, dashes = line_style(k)
        handles.append(Line2D([], [], color=colour, linestyle=dashes, label=f"ensemble {k + 1}"))
    figure.legend(
        handles=handles,
        loc="upper left",
        ncols=named,
        bbox_to_anchor=(_LEFT / PAGE, 1.0),
        borderaxespad=0.3,
        borderpad=0.2,
        columnspacing=1.2,
        handlelength=2.4,
    )
    if remark:
        figure.text(
            1.0 - _RIGHT / PAGE,
            1.0 - 0.05 / figure.get_figheight(),
            remark,
            ha="right",
            va="top",
            fontsize=SMALL,
        )
