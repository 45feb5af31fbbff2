"""The figure of residuals: autocorrelation, and against speed, load and angle.

What else explains them, a fit asks by itself (:mod:`bayesfric.diagnostics`); this is to be seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import stats

from bayesfric.estimates.torque import load_at_outputs
from bayesfric.inference.fitting import Fit
from bayesfric.inference.likelihood.likelihood import Outputs
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.report.figures import style
from bayesfric.report.figures.registry import RunFigure
from bayesfric.report.figures.style import (
    Array,
    Look,
    few_ticks,
    paper_figure,
    power_of_ten,
    scaled_unit,
)
from bayesfric.report.summary.derived_quantities import rms_of

Places = NDArray[np.int64]

_LAGS = 40
_BINS = 16
# Outputs a bin needs, or its mean says nothing.
_LEAST = 5
# Half width of a normal's 95 % interval, in sds.
_HALF = float(stats.norm.ppf(0.975))

_HEIGHT = 3.6
_DOTS: Look = {"linestyle": "none", "markersize": 2.2}


def residual_figure(fit: Fit) -> Figure:
    """Draw autocorrelation, and residuals against speed, load and angle, a page wide.

    Bars hold the 95 % interval of a bin's mean.
    """
    found = residual_analysis(fit)
    with paper_figure(style.PAGE, _HEIGHT) as figure:
        halves = figure.add_gridspec(2, 1)
        _draw_correlation(figure.add_subplot(halves[0]), fit, found)
        reach = max(
            (float((abs(b.mean) + _HALF * b.error).max()) for b in found.against), default=1.0
        )
        exponent = power_of_ten(-reach, reach)
        lower = style.panel_grid(figure, len(found.against), max(len(found.against), 1), halves[1])
        for ax, binned in zip(lower, found.against, strict=True):
            _draw_binned(ax, binned, 10.0**exponent)
            ax.set_ylim(-1.15 * reach / 10.0**exponent, 1.45 * reach / 10.0**exponent)
            few_ticks(ax.yaxis, 5)
            ax.tick_params(labelleft=ax is lower[0])
        if lower:
            lower[0].set_ylabel(f"residual ({scaled_unit(exponent, found.unit)})")
    return figure


def _draw_correlation(ax: Axes, fit: Fit, found: ResidualAnalysis) -> None:
    period = fit.target.likelihood.outputs[0].period
    ax.axhline(0.0, color="0.6", linewidth=0.5)
    ax.fill_between(
        found.lags, -found.white, found.white, color=style.BAND, linewidth=0.0, gid="white",
        label="95 % of white residuals",
    )  # fmt: skip
    ax.vlines(found.lags, 0.0, found.correlation, color=style.PALETTE[0], linewidth=0.8)
    dots: Look = {"color": style.PALETTE[0], "marker": "o", "gid": "correlation", **_DOTS}
    ax.plot(found.lags, found.correlation, **dots)
    if found.innovations is not None:
        named: Look = {"label": "innovations: what the noise model leaves", "gid": "innovations"}
        look: Look = {"color": style.PALETTE[2], "marker": "s", "markerfacecolor": "white"}
        ax.plot(found.lags + 0.3, found.innovations, **look, **_DOTS, **named)
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


def _draw_binned(ax: Axes, b: Binned, factor: float) -> None:
    ax.axhline(0.0, color="0.6", linewidth=0.5)
    ax.errorbar(
        b.centre, b.mean / factor, yerr=_HALF * b.error / factor, color=style.PALETTE[0],
        linestyle="none", marker="o", markersize=2.4, elinewidth=1.6, gid="mean",
    )  # fmt: skip
    ax.set_xlabel(f"{b.what} ({b.unit})")
    few_ticks(ax.xaxis, 5)
    said = f"{100 * b.explained:.2g} % of variance"
    place: Look = {"transform": ax.transAxes, "va": "top", "fontsize": style.SMALL}
    ax.text(0.03, 0.97, said, **place).set_in_layout(False)


@dataclass(frozen=True, eq=False)
class Binned:
    """Residuals against one quantity, in bins of equally many outputs, ``(bins,)`` each."""

    name: str
    symbol: str  # LaTeX without dollar signs
    unit: str
    centre: Array
    mean: Array
    error: Array  # sd of the mean, wider where residuals are correlated
    explained: float  # share of the residuals' variance that the bins' means hold

    @property
    def what(self) -> str:
        """The quantity with its symbol, for an axis."""
        return f"{self.name} ${self.symbol}$"


@dataclass(frozen=True, eq=False)
class ResidualAnalysis:
    """Residuals of all recordings, looked at from several sides."""

    unit: str
    lags: Array  # (L,) in outputs
    correlation: Array  # (L,) over all runs without a gap
    white: Array  # (L,) half width of the 95 % band that white residuals keep to
    # (L,) of what the noise's memory does not predict; None where the model has no memory
    innovations: Array | None
    against: tuple[Binned, ...]  # speed, load and joint angle, where they vary


def residual_analysis(fit: Fit) -> ResidualAnalysis:
    """Look at what the posterior mean leaves of the measurements."""
    outputs, left = fit.target.likelihood.outputs, fit.residuals
    lags, correlation, white = _autocorrelation(outputs, left)
    inner = _innovations(fit, left)
    against = [
        _binned((name, symbol, unit), np.concatenate(x), outputs, left)
        for name, symbol, unit, x in _abscissae(fit, outputs)
        if np.ptp(np.concatenate(x)) > 0.0
    ]
    return ResidualAnalysis(
        outputs[0].unit,
        lags,
        correlation,
        white,
        _autocorrelation(outputs, inner)[1] if inner else None,
        tuple(b for b in against if b.centre.size > 1),
    )


def _innovations(fit: Fit, left: list[Array]) -> list[Array] | None:
    """Take from residuals what the noise model predicts, where it predicts anything."""
    likelihood = fit.target.likelihood
    if not isinstance(likelihood, TorqueLikelihood) or not likelihood.noise.order:
        return None
    median = fit.posterior.median
    scales = fit.target.noise.scales(median[None, len(fit.target.free) :])[0]
    return likelihood.innovations(left, scales)


def _autocorrelation(outputs: tuple[Outputs, ...], left: list[Array]) -> tuple[Array, Array, Array]:
    """Correlate residuals at even distances in time about zero, gaps left out.

    About zero, as noise is modelled, and as lag 1 is told elsewhere.
    """
    most = min(_LAGS, max(max(r.size for r in left) // 4, 1))
    grids = [_on_grid(o, r, most) for o, r in zip(outputs, left, strict=True) if rms_of(r) > 0.0]
    if not grids:
        return np.empty(0), np.empty(0), np.empty(0)
    every = np.concatenate(grids)
    lags = np.arange(1, most + 1)
    products = [every[lag:] * every[:-lag] for lag in lags]
    pairs = np.array([np.isfinite(x).sum() for x in products])
    sums = np.array([np.nansum(x) for x in products])
    seen = pairs > 0
    correlation = sums[seen] / pairs[seen] / np.nanmean(every**2)
    return lags[seen].astype(np.float64), correlation, np.asarray(_HALF / np.sqrt(pairs[seen]))


def _on_grid(o: Outputs, r: Array, room: int) -> Array:
    """Put residuals over their rms on an even grid of time, nothing in gaps, and room behind.

    Segments are not in step with each other.
    """
    begin = o.time[np.searchsorted(o.segment_of, o.segment_of)]
    place = np.rint((begin - o.time[0]) / o.period) + np.rint((o.time - begin) / o.period)
    place = place.astype(np.int64) + o.segment_of * (room + 1)
    grid = np.full(int(place.max()) + 1 + room, np.nan)
    grid[place] = r / rms_of(r)
    return grid


def _abscissae(fit: Fit, outputs: tuple[Outputs, ...]) -> list[tuple[str, str, str, list[Array]]]:
    """Speed, load torque and angle at every output."""
    median = fit.target.chain_values(fit.posterior.median[None])[0]
    speed: list[Array] = []
    load: list[Array] = []
    angle: list[Array] = []
    for o, seen in zip(outputs, fit.observations, strict=True):
        q, gamma = seen.q[seen.filter.centres], load_at_outputs(fit.chain, seen, median)
        # outputs of a simulation are at other times than those of the filter
        same = np.array_equal(seen.time, o.time)
        for kept, x in ((speed, seen.speed), (load, gamma), (angle, q)):
            kept.append(x if same else np.interp(o.time, seen.time, x))
    rotary = fit.chain.load.motion == "rotary"
    return [
        ("joint speed", r"\dot q", "rad/s" if rotary else "m/s", speed),
        ("load", r"\Gamma", "N m" if rotary else "N", load),
        ("joint angle" if rotary else "position", "q", "rad" if rotary else "m", angle),
    ]


def _binned(
    quantity: tuple[str, str, str], x: Array, outputs: tuple[Outputs, ...], left: list[Array]
) -> Binned:
    """Mean in bins; outputs that repeat what the ones before said count once.

    How often they do is measured with the means taken off: a dependence is no memory.
    """
    r = np.concatenate(left)
    parts = np.array_split(np.argsort(x, kind="stable"), max(1, min(_BINS, r.size // _LEAST)))
    bins = np.empty(r.size, dtype=np.int64)
    bins[np.concatenate(parts)] = np.repeat(np.arange(len(parts)), [p.size for p in parts])
    size = np.bincount(bins)
    centre, mean, square = (np.bincount(bins, y) / size for y in (x, r, r**2))
    inside = r - mean[bins]
    ends = np.cumsum([one.size for one in left])[:-1]
    _, correlation, white = _autocorrelation(outputs, np.split(inside, ends))
    # up to the first lag that chance explains
    few = int(np.argmin(np.append(correlation > white, False)))
    repeated = np.minimum(1.0 + 2.0 * float(correlation[:few].sum()), size)
    error = np.sqrt(np.maximum(square - mean**2, 0.0) * repeated / size)
    total = float(np.var(r))
    return Binned(
        *quantity, centre, mean, error, 1.0 - float(np.var(inside)) / total if total > 0.0 else 0.0
    )


FIGURE = RunFigure(
    stem="residual",
    title="What is left unexplained",
    section="prediction",
    draw=lambda run: residual_figure(run.fit),
    caption=(
        "What the posterior mean leaves unexplained: autocorrelation, and means of residuals "
        "against motion and load, as far as they vary (95 % intervals; the share of variance that "
        "the bins' means hold is written in each panel)."
    ),
)
