"""The few seconds of the recordings that the model explains worst, to be looked at first."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from bayesfric.inference.fitting import Fit
from bayesfric.inference.likelihood.likelihood import Outputs
from bayesfric.recordings.observation import Observation
from bayesfric.report.answers.record import Gap, Stretch
from bayesfric.report.summary.derived_quantities import LEVEL, rms_of

Array = NDArray[np.float64]

_SECONDS = 5.0
# Outputs of a window below which its rms says more of chance than of the model.
_LEAST = 20
# Sampling periods from which on samples are missing.
_HOLE = 1.5
# More points than this are finer than a page is.
_POINTS = 1000


def stretch(fit: Fit) -> Stretch | None:
    """Take the 5 s in which the residuals' root mean square is largest, of all recordings.

    It is that of what was measured and fitted, against the posterior mean; the band is the
    noise's. ``None`` where no recording has outputs enough.
    """
    outputs, residuals = fit.target.likelihood.outputs, fit.residuals
    found = [
        (*worst, k)
        for k, (o, residual) in enumerate(zip(outputs, residuals, strict=True))
        if (worst := _worst(o.time, residual)) is not None
    ]
    if not found:
        return None
    _, begin, end, k = max(found)
    o, residual = outputs[k], residuals[k]
    posterior = fit.posterior
    scales = fit.target.noise.scales(posterior.median[None, len(fit.target.free) :])[0]
    reach = float(ndtri(0.5 + LEVEL / 2.0)) * fit.target.likelihood.noise_sd(scales)[k]
    columns = np.stack(
        [o.time, o.measured, o.measured - residual, np.broadcast_to(reach, o.time.shape)]
    )
    return Stretch(
        recording=o.name,
        quantity=o.quantity,
        unit=o.unit,
        span=[float(o.time[begin]), float(o.time[end - 1])],
        whole=float(o.time[-1] - o.time[0]),
        residual_rms=rms_of(residual[begin:end]),
        level=LEVEL,
        pieces=[_short(columns[:, one]) for one in _pieces(o, begin, end)],
        gaps=list(_gaps(o, fit.observations[k], begin, end)),
    )


def _worst(time: Array, residual: Array) -> tuple[float, int, int] | None:
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


def _pieces(o: Outputs, begin: int, end: int) -> Iterator[slice]:
    """Part a window where outputs are missing; thin it out evenly."""
    cuts = begin + 1 + np.flatnonzero(~o.follows[begin : end - 1])
    thin = max(1, -(-(end - begin) // _POINTS))
    for first, last in zip([begin, *cuts.tolist()], [*cuts.tolist(), end], strict=True):
        yield slice(first, last, thin)


def _gaps(o: Outputs, observation: Observation, begin: int, end: int) -> Iterator[Gap]:
    """Say of each gap of a window why nothing is compared there; one may have several reasons."""
    stamps, sample = observation.stamps, float(np.median(np.diff(observation.stamps)))
    for at in begin + np.flatnonzero(~o.follows[begin : end - 1]):
        span = [float(o.time[at]), float(o.time[at + 1])]
        first, last = np.searchsorted(stamps, np.array(span) - 0.5 * sample)
        if np.diff(stamps[first : last + 1]).max(initial=0.0) > _HOLE * sample:
            yield Gap(span=span, why="missing")
            continue
        step = max(round(o.period / sample), 1)
        absent = np.arange(first + step, last, step)
        out = [_left_out(observation, middle, sample) for middle in absent.tolist()]
        turns = [k for k in range(1, len(out)) if out[k] != out[k - 1]]
        ends = [span[0], *(0.5 * float(stamps[absent[k - 1]] + stamps[absent[k]]) for k in turns)]
        for k, low, high in zip([0, *turns], ends, [*ends[1:], span[1]], strict=True):
            yield Gap(span=[low, high], why="left-out" if out and out[k] else "rest")


def _left_out(o: Observation, middle: int, sample: float) -> bool:
    """Whether an output about a sample is missing because of what was left out there.

    Its window touches that, or holds nothing but samples that are fast enough.
    """
    half = len(o.filter.taps) // 2
    reach, at = (half + int(o.settings["trim_samples"])) * sample, o.stamps[middle]
    told = (one for one in o.left_out if one.by != "cut")
    window = o.filter.used[max(middle - half, 0) : middle - half + len(o.filter.taps)]
    return any(x.start - reach <= at <= x.stop + reach for x in told) or bool(window.all())


def _short(columns: Array) -> list[list[float]]:
    """Five digits are finer than a screen."""
    return [[float(f"{x:.6g}") for x in row] for row in columns.tolist()]
