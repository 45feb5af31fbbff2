"""Measured torque, or position, and the posterior predictive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.special import ndtri

from bayesfric.inference.fitting import Fit
from bayesfric.inference.likelihood.likelihood import Outputs
from bayesfric.recordings.checks import too_slow
from bayesfric.recordings.observation import Observation
from bayesfric.report.figures import style
from bayesfric.report.figures.registry import RunFigure
from bayesfric.report.figures.style import Array, Look, few_ticks, remark_below, shortened
from bayesfric.report.summary.derived_quantities import LEVEL
from bayesfric.results.roll_out import Rolled

_MOST = 3
# Numbers held at once while predicting: windows of the filter, 160 MB.
_BUDGET = 20_000_000
_HEIGHT = 3.4
_GREY = "#8a8a8a"
# Lines of more points are drawn as pixels; as paths they would make a slow and huge PDF.
_MOST_POINTS = 5000


@dataclass(frozen=True, eq=False)
class Predictive:
    """Posterior predictive of one recording, ``(n_outputs,)`` each."""

    mean: Array
    reach: Array  # half the 90 % interval, noise included
    sigma: Array  # sd of the noise alone, root mean square over the draws


def predictive(fit: Fit) -> list[Predictive]:
    """Predict the outputs of every recording.

    The predictive is assumed normal: it is the normal noise, spread a little by the parameters.
    Quantiles of a few hundred draws would be far rougher than that.
    """
    flat = fit.predicting
    n = len(flat)
    values = fit.target.chain_values(flat)
    scales = fit.target.noise.scales(flat[:, len(fit.target.free) :])
    likelihood = fit.target.likelihood
    # about one draw's prediction: squares of small differences lose no digits
    origin = [f[0] for f in likelihood.predict(values[:1])]
    first, second = ([np.zeros_like(f) for f in origin] for _ in range(2))
    windows = sum(o.measured.size * o.filter.taps.size for o in fit.observations)
    at_once = max(1, _BUDGET // max(windows, 1))
    for begin in range(0, n, at_once):
        for r, f in enumerate(likelihood.predict(values[begin : begin + at_once])):
            first[r] += (f - origin[r]).sum(axis=0)
            second[r] += ((f - origin[r]) ** 2).sum(axis=0)
    # the noise changes little over the draws
    sds = [likelihood.noise_sd(scales[i]) for i in range(0, n, max(n // 20, 1))]
    predictives = []
    for r in range(len(origin)):
        variance = np.maximum(second[r] / n - (first[r] / n) ** 2, 0.0)
        noise = np.mean([sd[r] ** 2 for sd in sds], axis=0)
        reach = float(ndtri(0.5 + LEVEL / 2.0)) * np.sqrt(variance + noise)
        predictives.append(Predictive(origin[r] + first[r] / n, reach, noise**0.5))
    return predictives


def prediction_figure(fit: Fit) -> Figure:
    """Draw measured and predicted torque or position, and residuals, over time, a page wide.

    A column for each of at most three recordings, with the 90 % predictive band and two noise
    scales. Where outputs are missing (dead zone, excluded spans) the lines break; excluded spans
    are hatched.
    """
    outputs = fit.target.likelihood.outputs
    shown = outputs[:_MOST]
    quantity, unit = outputs[0].quantity, outputs[0].unit
    with style.paper_figure(style.PAGE, _HEIGHT) as figure:
        axes = figure.subplots(
            2, len(shown), squeeze=False, sharex="col", sharey="row", height_ratios=(1.8, 1.0)
        )
        drawn = zip(axes.T, shown, predictive(fit), fit.observations, strict=False)
        for (above, below), o, p, of in drawn:
            _predicted(above, o, p)
            _residual(below, o, p)
            for ax in (above, below):
                _left_out(ax, of)
            below.set_xlabel("time (s)")
            below.set_xlim(float(o.time.min()), max(float(o.time.max()), o.time.min() + 1e-9))
            few_ticks(below.xaxis, 8 if len(shown) == 1 else 4)
            above.set_title(shortened(o.name), fontsize=style.SMALL, pad=2.5)
        few_ticks(axes[0, 0].yaxis, 5)
        few_ticks(axes[1, 0].yaxis, 4)
        axes[0, 0].set_ylabel(f"{quantity} ({unit})")
        axes[1, 0].set_ylabel(f"residual ({unit})")
        figure.align_ylabels(axes[:, 0])
        every = [zip(*ax.get_legend_handles_labels(), strict=True) for ax in axes.T.flat]
        named = {label: handle for pairs in every for handle, label in pairs}
        style.legend_above(figure, list(named.values()))
        if len(outputs) > _MOST:
            remark_below(figure, f"first {_MOST} of {len(outputs)} recordings")
    return figure


def _left_out(ax: Axes, o: Observation) -> None:
    """Hatch the spans that the user excluded."""
    spans = [(start, stop - start) for start, stop in o.left_out]
    if spans:
        look: Look = {"facecolor": "none", "edgecolor": _GREY, "hatch": style.OPEN_HATCH}
        named: Look = {"label": "left out by the user", "gid": "left-out", "linewidth": 0.0}
        ax.broken_barh(spans, (0.0, 1.0), transform=ax.get_xaxis_transform(), **look, **named)


def _predicted(ax: Axes, o: Outputs, p: Predictive) -> None:
    """Draw measured outputs, and mean and band of the predictive."""
    label = f"{100 * LEVEL:.0f} % predictive band"
    draw_band(ax, o, p.mean - p.reach, p.mean + p.reach, label=label, gid="band")
    time, measured, mean = broken(o, o.measured, p.mean)
    # wide below and thin above, so that both are seen where they agree
    width = 1.0 if as_pixels(o) else 1.5
    named: Look = {"label": "predictive mean", "gid": "mean", "rasterized": as_pixels(o)}
    ax.plot(time, mean, color=style.PALETTE[2], linewidth=width, **named)
    draw_measured(ax, o, time, measured, linewidth=0.5, label="measured", gid="measured")


def _residual(ax: Axes, o: Outputs, p: Predictive) -> None:
    # on the scale of the torque a good fit's band is a hairline
    draw_band(ax, o, -p.reach, p.reach)
    time, residual, sigma = broken(o, o.measured - p.mean, p.sigma)
    draw_measured(ax, o, time, residual, linewidth=0.4, gid="residual")
    look: Look = {"color": style.PALETTE[1], "linewidth": 0.8, "linestyle": style.DASHED}
    ax.plot(time, -2.0 * sigma, gid="sigma", **look)
    ax.plot(time, 2.0 * sigma, label="$\\pm 2$ sds of the noise", gid="sigma", **look)


def as_pixels(o: Outputs | Observation | Rolled) -> bool:
    """Whether there are too many outputs to draw them as paths."""
    return o.time.size > _MOST_POINTS


def broken(o: Outputs | Observation, *values: Array) -> list[Array]:
    """Give time and values with a break wherever outputs are missing."""
    gaps = (np.diff(o.time) > 1.5 * o.period) | (np.diff(o.segment_of) != 0)
    at: NDArray[np.intp] = np.flatnonzero(gaps) + 1
    # a time inside the gap keeps the order; the values there are none
    between = 0.5 * (o.time[at - 1] + o.time[at])
    return [
        np.insert(o.time, at, between),
        *(np.insert(np.asarray(v, dtype=np.float64), at, np.nan) for v in values),
    ]


def draw_band(ax: Axes, o: Outputs | Observation, low: Array, high: Array, **named: Any) -> None:
    """Draw the band between two ends, ``(n_outputs,)`` each; ``named`` is its label and name."""
    time, low, high = broken(o, low, high)
    ax.fill_between(
        time, low, high, color=style.BAND, linewidth=0.0, rasterized=as_pixels(o), **named
    )


def draw_measured(
    ax: Axes, o: Outputs | Observation, time: Array, values: Array, **named: Any
) -> None:
    """Draw measured values with breaks; ``named`` is their width, label and name.

    An output between two gaps is a dot: no line reaches it.
    """
    finite = np.pad(np.isfinite(values), 1)
    alone = np.flatnonzero(finite[1:-1] & ~finite[:-2] & ~finite[2:]).tolist()
    named |= {"marker": ".", "markersize": 1.5, "markevery": alone, "rasterized": as_pixels(o)}
    ax.plot(time, values, color=style.MEASURED, **named)


FIGURE = RunFigure(
    stem="prediction",
    title="Measured and predicted",
    section="prediction",
    draw=lambda run: prediction_figure(run.fit),
    caption=(
        "Measured outputs and the posterior predictive, noise included, with residuals below. "
        "Dashed: two standard deviations of the noise, its autocorrelation included; "
        "the tables' scale is then that of its innovations, which is smaller. "
        f"Gaps that are not hatched have no samples, or are not compared: {too_slow()}."
    ),
)
