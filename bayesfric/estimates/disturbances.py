"""Spans of a recording in which something else acted, such as a hand that pushed.

There the torque is off by several times what it is elsewhere, for a while. Looked for by a robust
least squares of each recording alone, so that the span itself moves the fit little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.huber import HUBER, robust_sd, shares
from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.observation import Observation

# s over which residuals are averaged, at least so many outputs.
_WINDOW, _OUTPUTS = 0.4, 8
# How many times the usual residual is no chance and no lack of the model, in so many outputs of one
# span; and to where its ends reach. Of 16 untouched recordings of the XL330 the largest is 6.4.
_FAR, _LEAST, _ENDS = 7.0, 3, 2.5
# A shorter recording does not tell what is usual; nor one of which more than this share is far.
_ENOUGH, _MOST = 40, 0.35
_STEPS = 30
_TINY = 1e-30


@dataclass(frozen=True)
class Disturbance:
    """A span, s from the file's first stamp, and by how many times its residual is larger."""

    recording: str
    start: float
    stop: float
    times: float


def disturbances(chain: Joint, observations: Sequence[Observation]) -> list[Disturbance]:
    """Find spans in which a recording's torque is far from what its motion explains elsewhere."""
    return [one for o in observations for one in _found(chain, o)]


def _found(chain: Joint, o: Observation) -> list[Disturbance]:
    if o.time.size < _ENOUGH:
        return []
    projection = TotalsProjection(chain, [o])
    if not projection.names:
        return []
    try:
        residual = _robust(projection.regressors, o.measured)
    except np.linalg.LinAlgError:  # numbers that no joint has: nothing is usual there
        return []
    half = 0.5 * max(_WINDOW, _OUTPUTS * o.period)
    first = np.searchsorted(o.time, o.time - half)
    last = np.searchsorted(o.time, o.time + half, "right")
    sums = np.concatenate([[0.0], np.cumsum(residual**2)])
    local = np.sqrt((sums[last] - sums[first]) / (last - first))
    usual = float(np.median(local))
    # what a model explains to the last digit is no usual residual
    if not usual > 1e-9 * float(np.abs(o.measured).max(initial=0.0)):
        return []
    times = local / usual
    if np.mean(times > _FAR) > _MOST:
        return []
    found = []
    for a, b in _runs(times > _ENDS):
        if int(np.count_nonzero(times[a:b] > _FAR)) >= _LEAST:
            peak = float(times[a:b].max())
            # the average has carried it to either side already
            found.append(Disturbance(o.name, float(o.time[a]), float(o.time[b - 1]), peak))
    return _joined(found, 2.0 * half)


def _robust(regressors: NDArray[np.float64], torque: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the residual of a fit in which what is far counts little."""
    scaled = regressors / (np.linalg.norm(regressors, axis=0) + _TINY)
    weight = np.ones_like(torque)
    residual = torque
    for _ in range(_STEPS):
        root = np.sqrt(weight)
        solution = np.linalg.lstsq(scaled * root[:, None], torque * root, rcond=None)[0]
        residual = torque - scaled @ solution
        knee = HUBER * max(robust_sd(residual), _TINY)
        # squared: a long push would else still pull
        weight = shares(residual, knee) ** 2
    return np.asarray(residual)


def _runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    change = np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8))
    begins, ends = np.flatnonzero(change == 1), np.flatnonzero(change == -1)
    return list(zip(begins.tolist(), ends.tolist(), strict=True))


def _joined(spans: Sequence[Disturbance], gap: float) -> list[Disturbance]:
    """Join spans that nearly touch."""
    out: list[Disturbance] = []
    for one in spans:
        if out and one.start - out[-1].stop <= gap:
            before = out.pop()
            times = max(before.times, one.times)
            one = Disturbance(one.recording, before.start, one.stop, times)
        out.append(one)
    return out
