"""The few seconds of the recordings that the model explains worst, to be looked at first."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure

from bayesfric.inference.fitting import Fit
from bayesfric.inference.likelihood.likelihood import Outputs
from bayesfric.recordings.moving import too_slow
from bayesfric.report.figures import style
from bayesfric.report.figures.prediction import (
    Predictive,
    draw_left_out,
    draw_predicted,
)
from bayesfric.report.figures.registry import FinishedRun, RunFigure
from bayesfric.report.figures.style import Array, few_ticks
from bayesfric.report.summary.derived_quantities import rms_of

_SECONDS = 5.0
# Outputs of a window below which its rms says more of chance than of the model.
_LEAST = 20
_HEIGHT = 1.7


@dataclass(frozen=True, eq=False)
class Worst:
    """A window of one recording, ``number`` among all, with its residuals to the posterior mean."""

    number: int
    outputs: Outputs
    residual: Array
    sigma: Array  # of the noise
    whole: bool  # whether it is all of its recording


def worst_seconds(fit: Fit) -> Worst | None:
    """Take the 5 s in which the residuals' root mean square is largest, of all recordings.

    ``None`` where no recording has outputs enough.
    """
    outputs, residuals = fit.target.likelihood.outputs, fit.residuals
    found = [
        (*window, k)
        for k, (o, residual) in enumerate(zip(outputs, residuals, strict=True))
        if (window := _window(o.time, residual)) is not None
    ]
    if not found:
        return None
    _, begin, end, k = max(found)
    o, part = outputs[k], slice(begin, end)
    scales = fit.target.noise.scales(fit.posterior.median[None, len(fit.target.free) :])[0]
    sigma = np.broadcast_to(fit.target.likelihood.noise_sd(scales)[k], o.time.shape)
    cut = {name: getattr(o, name)[part] for name in ("time", "measured", "segment_of")}
    seen = replace(o, **cut, follows=o.follows[begin : end - 1])
    return Worst(k, seen, residuals[k][part], sigma[part], end - begin == o.time.size)


def _window(time: Array, residual: Array) -> tuple[float, int, int] | None:
    """Find the mean square, begin and end of the worst window; it begins at any output."""
    ends = np.searchsorted(time, time + _SECONDS, side="right")
    # what begins later is shorter than the others, unless all of the recording is
    begins = np.flatnonzero((ends < time.size) | (time + _SECONDS <= time[-1]))
    begins = begins if begins.size else np.array([0])
    total = np.concatenate([[0.0], np.cumsum(residual**2)])
    number = ends[begins] - begins
    mean = np.where(
        number >= min(_LEAST, time.size), (total[ends[begins]] - total[begins]) / number, -1.0
    )
    at = int(np.argmax(mean))
    if mean[at] < 0.0 or number[at] < 2:
        return None
    return float(mean[at]), int(begins[at]), int(ends[begins[at]])


def worst_figure(fit: Fit) -> Figure | None:
    """Draw what was measured and predicted in the worst seconds, a page wide."""
    found = worst_seconds(fit)
    if found is None:
        return None
    o = found.outputs
    with style.paper_figure(style.PAGE, _HEIGHT) as figure:
        ax = figure.subplots()
        predicted = Predictive(o.measured - found.residual, found.sigma, found.sigma)
        draw_predicted(ax, o, predicted)
        draw_left_out(ax, fit.observations[found.number])
        ax.set_xlim(float(o.time[0]), float(o.time[-1]))
        ax.set_xlabel("time (s)")
        ax.set_ylabel(f"{o.quantity} ({o.unit})")
        few_ticks(ax.xaxis, 8)
        few_ticks(ax.yaxis, 4)
        style.legend_above(figure, ax.get_legend_handles_labels()[0])
    return figure


def _caption(run: FinishedRun) -> str:
    found = worst_seconds(run.fit)
    if found is None:
        return ""
    o = found.outputs
    span = f"{o.time[0]:.4g} s to {o.time[-1]:.4g} s"
    what = f"All of {o.name}" if found.whole else f"Not typical: {span} of {o.name}"
    return (
        f"{what}, where the model explains least (residuals of {rms_of(found.residual):.2g} "
        f"{o.unit} rms), with the band of the noise. Gaps that are not hatched have no samples, or "
        f"are not compared: {too_slow()}."
    )


FIGURE = RunFigure(
    stem="worst",
    title="The seconds that the model explains worst",
    section="worst",
    draw=lambda run: worst_figure(run.fit),
    caption=_caption,
)
