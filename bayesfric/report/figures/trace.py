"""Trace plot: do the ensembles agree, and how fast do they forget."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesfric.inference.fitting import Fit
from bayesfric.inference.posterior import Posterior
from bayesfric.inference.sampling.convergence import autocorrelation
from bayesfric.report.figures import style
from bayesfric.report.figures.quantity import Quantity, not_shown, quantities
from bayesfric.report.figures.registry import JudgedRun, RunFigure
from bayesfric.report.figures.style import Array, Look, few_ticks, line_style, remark_below
from bayesfric.report.summary.summary import LEVEL

_MOST = 14
# Inches: a page, a row, and what stands above and below.
_TALLEST, _ROW, _AROUND = 9.0, 0.72, 0.66


def trace_figure(fit: Fit) -> Figure:
    """Draw the way of every ensemble and its autocorrelation, a page wide, noise scales last.

    On the left the median of each ensemble's walkers at every kept step and a
    90 % band over them; on the right the autocorrelation of the walkers over
    the lag in steps of the sampler.
    """
    return _drawn(fit.posterior, quantities(fit))


def _drawn(posterior: Posterior, everything: list[Quantity]) -> Figure:
    shown, left_out = everything[:_MOST], everything[_MOST:]
    diagnostics = posterior.diagnostics
    ensembles, _, steps, _ = posterior.draws.shape
    with style.paper_figure(style.PAGE, min(_TALLEST, _AROUND + _ROW * len(shown))) as figure:
        axes = figure.subplots(len(shown), 2, squeeze=False, sharex="col", width_ratios=(2.0, 1.0))
        figure.align_ylabels(axes[:, 0])
        longest = _longest_lag(posterior)
        for (left, right), q, tau in zip(axes, shown, diagnostics.tau, strict=False):
            draws = posterior[q.name]
            _trace(left, q, draws / q.factor, diagnostics.thin)
            _forgetting(right, draws, diagnostics.thin, float(tau), longest)
        axes[-1, 0].set_xlabel("step after warm-up")
        axes[-1, 1].set_xlabel("lag (steps)")
        axes[-1, 0].set_xlim(0, max(diagnostics.thin * steps, 1))
        axes[-1, 1].set_xlim(0, longest)
        few_ticks(axes[-1, 1].xaxis, 6)
        # sixteen line styles differ; a legend of more would be longer than the page is wide
        looks = enumerate(map(line_style, range(min(ensembles, 6))), start=1)
        style.legend_above(
            figure,
            [Line2D([], [], color=c, linestyle=d, label=f"ensemble {k}") for k, (c, d) in looks],
        )
        remark_below(figure, not_shown(left_out))
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
        # of walkers that never moved it is 0/0
        moving = ensemble[np.ptp(ensemble, axis=1) > 0.0]
        if moving.shape[0] == 0:
            continue
        colour, dashes = line_style(k)
        rho = autocorrelation(moving)
        lags = thin * np.arange(rho.size)
        inside = lags <= longest + thin
        look: Look = {"color": colour, "linestyle": dashes, "marker": ".", "markersize": 2.0}
        ax.plot(lags[inside], rho[inside], **look)
    ax.set_ylim(-0.35, 1.1)
    ax.set_yticks([0.0, 0.5, 1.0])
    ax.set_ylabel("ACF")
    said = rf"$\tau$ = {tau:.3g} steps" if np.isfinite(tau) else "never moved"
    ax.text(0.97, 0.88, said, ha="right", va="top", fontsize=style.SMALL, transform=ax.transAxes)


def _longest_lag(posterior: Posterior) -> float:
    """Far enough to see the slowest parameter forget, and at least ten kept draws."""
    d = posterior.diagnostics
    finite = d.tau[np.isfinite(d.tau)]
    wanted = max(6.0 * float(finite.max(initial=0.0)), 10.0 * d.thin)
    return float(max(min(wanted, d.thin * posterior.draws.shape[2] / 2.0), d.thin))


def _words(judged: JudgedRun) -> str:
    each = [
        f"{name}: R-hat {row.rhat:.4f}, {row.ess:.0f} independent draws"
        for name, row in judged.summary.parameters.items()
        if row.rhat is not None and row.ess is not None
    ]
    return f"Status {judged.summary.sampler.status}. " + "; ".join(each) + "."


FIGURE = RunFigure(
    stem="trace",
    title="How the ensembles ran",
    section="sampling",
    draw=lambda run: partial(_drawn, run.fit.posterior, quantities(run.fit)),
    caption=(
        "Median and spread of the walkers of every ensemble along the steps kept, and the "
        "autocorrelation of what the ensembles drew."
    ),
    alternative=_words,
)
