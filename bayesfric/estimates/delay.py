"""The delay of the position of recordings behind their torque.

The torque is linear in a small delay (:mod:`bayesfric.recordings.observation`), so the delay is one
more coefficient of an estimate; recordings are shifted by it until it settles.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.least_squares import TotalsProjection, least_squares
from bayesfric.estimates.methods import EstimationInputs
from bayesfric.estimates.point_estimate import Estimate
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.observation import (
    FAR_DELAYS,
    Observation,
    filtered_rate,
    longest_delay,
    retimed,
)

# Rounds, each linear about the delay of the last; settled when it moves by less than so many sds.
_ROUNDS, _SETTLED = 10, 0.02
# Longest delay to look for, s, and as a share of the recording.
_LONGEST, _SHARE = 0.25, 0.1
# A far delay must leave less than this share of the squares without: at one frequency a quarter of
# a period looks like a spring.
_FAR_GAIN = 0.5


def estimate_delay(inputs: EstimationInputs, recordings: Sequence[Measurement]) -> float:
    """Estimate ``drive.delay``, s: by least squares of a linear torque, else input error."""
    chain, pairs = inputs.chain, list(zip(recordings, inputs.observations, strict=True))
    if any(p.row.bends for p in chain.parameters):
        point: dict[str, float] | None = None

        def estimate(observations: Sequence[Observation]) -> Estimate:
            nonlocal point  # the next round starts where this one ends
            fitted = input_error(chain, observations, inputs.knowledge, inputs.options, point)
            point = dict(fitted.point)
            return fitted

        return settled_delay(pairs, estimate, chain)
    return settled_delay(pairs, lambda observations: least_squares(chain, observations), chain)


def settled_delay(
    pairs: Sequence[tuple[Measurement, Observation]],
    estimate: Callable[[Sequence[Observation]], Estimate],
    chain: Joint,
) -> float:
    """Repeat an estimate, recordings shifted by its delay, until it settles; 0 if undetermined."""
    delay = _first(TotalsProjection(replace(chain, delay=False), [o for _, o in pairs]), pairs)
    for _ in range(_ROUNDS):
        fitted = estimate([retimed(o, r.segments, r.period, delay, r) for r, o in pairs])
        value, previous = fitted[chain.delay_name], delay
        if fitted.method == "least-squares" and not value.determined:
            return 0.0
        delay = _within(value.value, pairs)
        # a delay without an sd, or at the end of the range, moves no more
        if not abs(delay - previous) > _SETTLED * value.larger_sd:
            break
    return delay


def furthest_delay(observations: Sequence[Observation]) -> float:
    """Give the longest delay to look for, s."""
    trimmed = min(longest_delay(o, 1.0 / float(o.settings["sampling_rate"])) for o in observations)
    return max(trimmed, min(_LONGEST, _SHARE * min(float(np.ptp(o.stamps)) for o in observations)))


def _within(delay: float, pairs: Sequence[tuple[Measurement, Observation]]) -> float:
    longest = furthest_delay([o for _, o in pairs])
    lowest = 0.0 if any(r.feedback is not None for r, _ in pairs) else -longest
    return float(np.clip(delay, lowest, longest))


def _first(projection: TotalsProjection, pairs: Sequence[tuple[Measurement, Observation]]) -> float:
    """Choose the first delay: zero, or a far one that explains far more.

    By linear fits of the totals and the torque's rate.
    """
    near = max(longest_delay(o, r.period) for r, o in pairs)
    far = [d for d in FAR_DELAYS if near < d == _within(d, pairs)]
    basis, _ = np.linalg.qr(projection.regressors)

    def unexplained(delay: float) -> float:
        shifted = [retimed(o, r.segments, r.period, delay, r) for r, o in pairs]
        columns = [np.concatenate([o.measured for o in shifted])]
        columns.append(np.concatenate([filtered_rate(o) for o in shifted]))
        y, rate = (x - basis @ (basis.T @ x) for x in columns)
        rest = y - rate * float(rate @ y) / max(float(rate @ rate), 1e-300)
        return float(rest @ rest)

    delays = {_within(d, pairs) for d in (0.0, *far, *(-d for d in far))}
    squares = {d: unexplained(d) for d in delays} if far else {0.0: 1.0}
    best = min(squares, key=squares.__getitem__)
    return best if squares[best] < _FAR_GAIN * squares[0.0] else 0.0
