"""The figure of residuals: autocorrelation, quantiles, and against speed, load and angle."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from bayesfric.inference.fitting import Fit
from bayesfric.report.figures import style
from bayesfric.report.figures.registry import RunFigure
from bayesfric.report.figures.residual_analysis import (
    HALF,
    Binned,
    ResidualAnalysis,
    residual_analysis,
)
from bayesfric.report.figures.style import (
    Array,
    Look,
    few_ticks,
    paper_figure,
    power_of_ten,
    scaled_unit,
)
from bayesfric.report.summary.summary import torque_constant

_HEIGHT = 3.6


def residual_figure(fit: Fit) -> Figure:
    """Draw autocorrelation, quantiles, and residuals against speed, load and angle, a page wide.

    Bars hold one sd of the residuals either way, thick ones the 95 % interval of their mean.
    """
    found = residual_analysis(fit)
    with paper_figure(style.PAGE, _HEIGHT) as figure:
        halves = figure.add_gridspec(2, 1)
        upper = halves[0].subgridspec(1, 2, width_ratios=(2.0, 1.0))
        _draw_correlation(figure.add_subplot(upper[0]), fit, found)
        _draw_quantiles(figure.add_subplot(upper[1]), found)
        reach = max((float((abs(b.mean) + _bar(b)).max()) for b in found.against), default=1.0)
        exponent = power_of_ten(-reach, reach)
        lower = style.panel_grid(figure, len(found.against), max(len(found.against), 1), halves[1])
        for ax, binned in zip(lower, found.against, strict=True):
            _draw_binned(ax, binned, 10.0**exponent)
            ax.set_ylim(-1.15 * reach / 10.0**exponent, 1.45 * reach / 10.0**exponent)
            few_ticks(ax.yaxis, 5)
            ax.tick_params(labelleft=ax is lower[0])
        if lower:
            lower[0].set_ylabel(f"residual ({scaled_unit(exponent, found.unit)})")
            _draw_amperes(lower[-1], torque_constant(fit), reach, 10.0**exponent)
    return figure


def _draw_correlation(ax: Axes, fit: Fit, found: ResidualAnalysis) -> None:
    period = fit.target.likelihood.outputs[0].period
    ax.axhline(0.0, color="0.6", linewidth=0.5)
    ax.fill_between(
        found.lags, -found.white, found.white, color=style.BAND, linewidth=0.0, gid="white",
        label="95 % of white residuals",
    )  # fmt: skip
    ax.vlines(found.lags, 0.0, found.correlation, color=style.PALETTE[0], linewidth=0.8)
    ax.plot(
        found.lags, found.correlation, color=style.PALETTE[0], linestyle="none", marker="o",
        markersize=2.2, gid="correlation",
    )  # fmt: skip
    if found.innovations is not None:
        ax.plot(
            found.lags + 0.3,
            found.innovations,
            color=style.PALETTE[2],
            linestyle="none",
            marker="s",
            markersize=2.2,
            markerfacecolor="white",
            label="innovations: what the noise model leaves",
            gid="innovations",
        )
    inner = found.correlation if found.innovations is None else found.innovations
    every = np.concatenate([found.correlation, inner])
    low, high = float(every.min(initial=0.0)), float(every.max(initial=0.0))
    ax.set_ylim(min(-0.2, 1.2 * low), max(0.3, 1.2 * high))
    ax.set_xlim(0.0, float(found.lags.max(initial=1.0)) + 1.0)
    ax.set_xlabel(f"lag (outputs, {1e3 * period:.3g} ms each)")
    ax.set_ylabel("autocorrelation (–)")
    few_ticks(ax.xaxis, 8)
    few_ticks(ax.yaxis, 5)
    # above the panel: a slow memory's bars reach to all of its corners
    ax.legend(
        loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, handlelength=1.6, frameon=False,
        borderpad=0.1, borderaxespad=0.1, columnspacing=1.2,
    )  # fmt: skip


def _draw_quantiles(ax: Axes, found: ResidualAnalysis) -> None:
    reach = 1.08 * float(np.abs(found.normal).max(initial=1.0))
    ax.plot([-reach, reach], [-reach, reach], color=style.PALETTE[2], linestyle=style.DASHED)
    ax.plot(
        found.normal, found.quantiles, color=style.MEASURED, linestyle="none", marker=".",
        markersize=2.2, gid="quantiles",
    )  # fmt: skip
    ax.set_xlim(-reach, reach)
    ax.set_xlabel("quantile of a normal (sd)")
    ax.set_ylabel(f"of {'residuals' if found.innovations is None else 'innovations'} (rms)")
    few_ticks(ax.xaxis, 5)
    few_ticks(ax.yaxis, 5)


def _draw_amperes(ax: Axes, constant: float | None, reach: float, factor: float) -> None:
    """Tell residuals in the current that was measured, too, on the right."""
    if not constant:
        return
    exponent = power_of_ten(-reach / abs(constant), reach / abs(constant))
    by = factor / (abs(constant) * 10.0**exponent)

    def there(y: ArrayLike) -> ArrayLike:
        return by * np.asarray(y, dtype=np.float64)

    def back(a: ArrayLike) -> ArrayLike:
        return np.asarray(a, dtype=np.float64) / by

    right = ax.secondary_yaxis("right", functions=(there, back))
    right.set_ylabel(f"as current ({scaled_unit(exponent, 'A')})")
    right.set_gid("amperes")
    few_ticks(right.yaxis, 5)


def _bar(b: Binned) -> Array:
    """Half the length of the longer of a bin's two bars."""
    return np.fmax(b.sd, HALF * b.error)


def _draw_binned(ax: Axes, b: Binned, factor: float) -> None:
    ax.axhline(0.0, color="0.6", linewidth=0.5)
    ax.errorbar(
        b.centre, b.mean / factor, yerr=b.sd / factor, color=style.PALETTE[3], linestyle="none",
        elinewidth=0.8, gid="spread",
    )  # fmt: skip
    ax.errorbar(
        b.centre, b.mean / factor, yerr=HALF * b.error / factor, color=style.PALETTE[0],
        linestyle="none", marker="o", markersize=2.4, elinewidth=1.6, gid="mean",
    )  # fmt: skip
    ax.set_xlabel(f"{b.what} ({b.unit})")
    few_ticks(ax.xaxis, 5)
    said = f"{100 * b.explained:.2g} % of variance"
    place: Look = {"transform": ax.transAxes, "va": "top", "fontsize": style.SMALL}
    ax.text(0.03, 0.97, said, **place).set_in_layout(False)


FIGURE = RunFigure(
    stem="residual",
    title="What is left unexplained",
    section="prediction",
    draw=lambda run: residual_figure(run.fit),
    caption=(
        "What the posterior mean leaves unexplained: autocorrelation, quantiles against those of a "
        "normal, and residuals against motion and load, as far as they vary (thin: one sd; "
        "thick: 95 % interval of the bin's mean; the share of variance that the bins' means hold "
        "is written in each panel)."
    ),
)
