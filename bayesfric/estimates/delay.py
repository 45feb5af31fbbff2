"""How late the position of a recording comes after its torque."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from bayesfric.errors import BadInput
from bayesfric.estimates.information import lag_one
from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.methods import Given
from bayesfric.estimates.torque import places
from bayesfric.estimates.torque_near import bends, fitted_beside, larger, torque_near
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.measurement import Array, Measurement
from bayesfric.recordings.observation import Observation
from bayesfric.recordings.timing import FAR_DELAYS, longest_delay, retimed

# Each round takes the torque of the delay that the last one found: far from it, what is linear
# in the delay holds only roughly. It stands still when it moves by less than this many sds.
_ROUNDS, _STILL = 10, 0.02
# A delay is looked for as far as this, s, and a tenth of the recording.
_FURTHEST, _SHARE = 0.25, 0.1
# What a delay far from none leaves of the torque at most, over what none leaves: a swing at one
# frequency takes a quarter of its period for a spring.
_FAR_LESS = 0.5
# Samples that filters and kinks at reversals shift a torque by, even where there is no noise.
_FINEST = 0.025
# Correlation of neighbouring residuals below which they are the position's noise, differentiated:
# in closed loop the torque answers to it, and its rate of change then is about that, not a delay.
_OF_POSITION = -0.3
# Standard deviations that are no chance.
_SURE = 3.0


@dataclass(frozen=True)
class Delay:
    """By how much positions come late."""

    recordings: tuple[str, ...]
    value: float  # s
    sd: float  # s, the larger of the plain and the robust one; infinite if nothing tells
    period: float  # s from one sample to the next, of the first recording

    @property
    def samples(self) -> float:
        """The value in samples."""
        return self.value / self.period

    @property
    def sure(self) -> bool:
        """Whether it is no chance."""
        return abs(self.value) > _SURE * math.hypot(self.sd, _FINEST * self.period)


def delays(
    given: Given, recordings: Sequence[Measurement], point: Mapping[str, float] | None = None
) -> list[Delay]:
    """Estimate the delay of each recording by itself, and of several together last.

    Where nothing can be estimated, it is left out. ``point`` as in :func:`find_delay`; where the
    mechanism needs one, it is the input error's if left out.
    """

    def fitted(chain: Joint, observations: Sequence[Observation]) -> Mapping[str, float]:
        return dict(input_error(chain, observations, given.knowledge, given.options).point)

    pairs = list(zip(recordings, given.observations, strict=True))
    if not bends(given.chain):
        return _delays(given.chain, pairs, None)
    try:
        found = _delays(given.chain, pairs, point or fitted(given.chain, given.observations))
        if not any(one.sure for one in found):
            return found
        # what is hardly determined trades off against a delay: again from where both are fitted
        delay = found[-1].value
        there = [retimed(o, r.segments, r.period, delay, r.back_emf) for r, o in pairs]
        return _delays(given.chain, pairs, fitted(replace(given.chain, delay=True), there))
    except BadInput:
        return []


def own_delay(given: Given, recordings: Sequence[Measurement]) -> float:
    """Estimate the delay that a mechanism has as a parameter, s.

    Least squares tells it where the torque is linear. Where load losses or a Stribeck rise bend
    that, it is the input error's, from no delay on, whose recordings are timed anew by each.

    Raises
    ------
    BadInput
        If nothing can be estimated from these recordings.
    """
    chain, pairs = given.chain, list(zip(recordings, given.observations, strict=True))
    if not bends(chain):
        return find_delay(chain, recordings, given.observations)[0]
    plain = replace(chain, delay=False)
    delay = _first(*torque_near(plain, given.observations, None), pairs)
    for _ in range(_ROUNDS):
        there = [retimed(o, r.segments, r.period, delay, r.back_emf) for r, o in pairs]
        found = input_error(chain, there, given.knowledge, given.options)[chain.delay_name]
        before, delay = delay, _within(found.value, pairs)
        # what has no sd, or is at the end, moves no more
        if not abs(delay - before) > _STILL * larger(found.sd, found.sd_robust):
            break
    return delay


def _delays(
    chain: Joint,
    pairs: Sequence[tuple[Measurement, Observation]],
    point: Mapping[str, float] | None,
) -> list[Delay]:
    found = []
    for some in [*([pair] for pair in pairs), *([pairs] if len(pairs) > 1 else [])]:
        with suppress(BadInput):
            found.append(_delay(chain, some, point))
    return found


def _delay(
    chain: Joint,
    pairs: Sequence[tuple[Measurement, Observation]],
    point: Mapping[str, float] | None,
) -> Delay:
    recordings, observations = zip(*pairs, strict=True)
    names = tuple(o.name for o in observations)
    alone = replace(chain, own_offsets=names if chain.own_offsets else ())
    value, sd = find_delay(alone, recordings, observations, point)
    return Delay(names, value, sd, recordings[0].period)


def find_delay(
    chain: Joint,
    recordings: Sequence[Measurement],
    observations: Sequence[Observation],
    point: Mapping[str, float] | None = None,
) -> tuple[float, float]:
    """Estimate the one delay of all recordings, s, and its sd, infinite where nothing tells.

    Parameters
    ----------
    chain
        Its own delay, if it has one, is not looked at.
    recordings, observations
        In the same order.
    point
        Values near which the torque is taken for linear in the parameters. Without them it is
        in the totals of least squares, which load losses and a Stribeck rise bend: there it may
        be four times the delay of the mechanism (measured, UR10e).

    Returns
    -------
    tuple of float
        No longer than a quarter of a second, or a tenth of the recording; the larger of the plain
        and the robust sd.

    Raises
    ------
    BadInput
        If nothing can be estimated from these recordings.
    """
    pairs = list(zip(recordings, observations, strict=True))
    regressors, model = torque_near(replace(chain, delay=False), observations, point)
    where = places([o for _, o in pairs])
    delay, sd, lag = _first(regressors, model, pairs), np.inf, np.nan
    for _ in range(_ROUNDS):
        before = delay
        there = [retimed(o, r.segments, r.period, delay, r.back_emf) for r, o in pairs]
        target = np.concatenate([o.measured for o in there]) - model
        rate = np.concatenate([_rate(o) for o in there])
        found = fitted_beside(regressors, rate, target, where) if rate.any() else None
        if found is None:
            break
        sd, lag = found.sd, lag_one(found.residual, np.diff(where) == 1)
        if not np.isfinite(sd):
            return 0.0, np.inf
        delay = _within(found.value, pairs)
        if not abs(delay - before) > _STILL * sd:
            break
    # by more than two standard deviations of what chance does
    noisy = np.isfinite(sd) and lag < _OF_POSITION - 2.0 / math.sqrt(len(where))
    return delay, np.inf if noisy else sd


def _longest(pairs: Sequence[tuple[Measurement, Observation]]) -> float:
    """Longest delay, s, that is looked for."""
    trimmed = min(longest_delay(o, r.period) for r, o in pairs)
    return max(trimmed, min(_FURTHEST, _SHARE * min(float(np.ptp(o.stamps)) for _, o in pairs)))


def _within(delay: float, pairs: Sequence[tuple[Measurement, Observation]]) -> float:
    return float(np.clip(delay, -_longest(pairs), _longest(pairs)))


def _first(
    regressors: Array, model: Array, pairs: Sequence[tuple[Measurement, Observation]]
) -> float:
    """Give the delay to begin with: none, or a far one with which far more is explained."""
    near = max(longest_delay(o, r.period) for r, o in pairs)
    beyond = [d for d in FAR_DELAYS if near < d <= _longest(pairs)]
    basis, _ = np.linalg.qr(regressors)

    def left(delay: float) -> float:
        there = [retimed(o, r.segments, r.period, delay, r.back_emf) for r, o in pairs]
        columns = [np.concatenate([o.measured for o in there]) - model]
        columns.append(np.concatenate([_rate(o) for o in there]))
        y, rate = (x - basis @ (basis.T @ x) for x in columns)
        found = y - rate * float(rate @ y) / max(float(rate @ rate), 1e-300)
        return float(found @ found)

    tried = {d: left(d) for d in (0.0, *beyond, *(-d for d in beyond))} if beyond else {0.0: 1.0}
    best = min(tried, key=tried.__getitem__)
    return best if tried[best] < _FAR_LESS * tried[0.0] else 0.0


def _rate(o: Observation) -> Array:
    assert o.inputs.torque_rate is not None
    return o.filter.apply(o.inputs.torque_rate.values)
