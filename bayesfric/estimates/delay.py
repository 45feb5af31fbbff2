"""How late the position of a recording comes after its torque.

The torque is linear in a small delay (:mod:`bayesfric.recordings.timing`), so the delay is one
more coefficient of an estimate; recordings are timed anew until it settles.
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
from bayesfric.recordings.observation import Observation
from bayesfric.recordings.timing import FAR_DELAYS, filtered_rate, longest_delay, retimed

# Each round takes the torque of the delay that the last one found: far from it, what is linear
# in the delay holds only roughly. It stands still when it moves by less than this many sds.
_ROUNDS, _STILL = 10, 0.02
# A delay is looked for as far as this, s, and a tenth of the recording.
_FURTHEST, _SHARE = 0.25, 0.1
# What a delay far from none leaves of the torque at most, over what none leaves: a swing at one
# frequency takes a quarter of its period for a spring.
_FAR_LESS = 0.5


def own_delay(given: EstimationInputs, recordings: Sequence[Measurement]) -> float:
    """Estimate the delay that a mechanism has as a parameter.

    Least squares gives it where the torque is linear. Where load-dependent friction or a Stribeck
    rise bend that, it is the input error's, which begins each round where the last one ended.
    """
    chain, pairs = given.chain, list(zip(recordings, given.observations, strict=True))
    if any(p.row.bends for p in chain.parameters):
        point: dict[str, float] | None = None

        def estimate(there: Sequence[Observation]) -> Estimate:
            nonlocal point  # the next round begins where this one ends
            found = input_error(chain, there, given.knowledge, given.options, point)
            point = dict(found.point)
            return found

        return found_delay(pairs, estimate, chain)
    return found_delay(pairs, lambda there: least_squares(chain, there), chain)


def found_delay(
    pairs: Sequence[tuple[Measurement, Observation]],
    estimate: Callable[[Sequence[Observation]], Estimate],
    chain: Joint,
) -> float:
    """Look for the one delay of all recordings that an estimate of the chain settles at.

    Ten rounds at most; it has settled where it moves by less than 0.02 standard deviations. The
    first is a far one only if that leaves less than half the squared torque: at one frequency a
    quarter of a period makes a delay look like a spring.
    """
    delay = _first(TotalsProjection(replace(chain, delay=False), [o for _, o in pairs]), pairs)
    for _ in range(_ROUNDS):
        found = estimate([retimed(o, r.segments, r.period, delay, r) for r, o in pairs])
        value, before = found[chain.delay_name], delay
        if found.method == "least-squares" and not value.determined:
            return 0.0
        delay = _within(value.value, pairs)
        # what has no sd, or is at the end, moves no more
        if not abs(delay - before) > _STILL * value.larger_sd:
            break
    return delay


def furthest_delay(observations: Sequence[Observation]) -> float:
    """Longest delay, s, that is looked for."""
    trimmed = min(longest_delay(o, 1.0 / float(o.settings["sampling_rate"])) for o in observations)
    return max(trimmed, min(_FURTHEST, _SHARE * min(float(np.ptp(o.stamps)) for o in observations)))


def _within(delay: float, pairs: Sequence[tuple[Measurement, Observation]]) -> float:
    most = furthest_delay([o for _, o in pairs])
    least = 0.0 if any(r.feedback is not None for r, _ in pairs) else -most
    return float(np.clip(delay, least, most))


def _first(projection: TotalsProjection, pairs: Sequence[tuple[Measurement, Observation]]) -> float:
    """Give the delay to begin with: none, or a far one with which far more is explained.

    Each is tried with one linear fit of the totals and the torque's rate.
    """
    near = max(longest_delay(o, r.period) for r, o in pairs)
    beyond = [d for d in FAR_DELAYS if near < d == _within(d, pairs)]
    basis, _ = np.linalg.qr(projection.regressors)

    def left(delay: float) -> float:
        there = [retimed(o, r.segments, r.period, delay, r) for r, o in pairs]
        columns = [np.concatenate([o.measured for o in there])]
        columns.append(np.concatenate([filtered_rate(o) for o in there]))
        y, rate = (x - basis @ (basis.T @ x) for x in columns)
        found = y - rate * float(rate @ y) / max(float(rate @ rate), 1e-300)
        return float(found @ found)

    both = {_within(d, pairs) for d in (0.0, *beyond, *(-d for d in beyond))}
    tried = {d: left(d) for d in both} if beyond else {0.0: 1.0}
    best = min(tried, key=tried.__getitem__)
    return best if tried[best] < _FAR_LESS * tried[0.0] else 0.0
