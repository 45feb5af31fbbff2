"""How late the position of a recording comes after its torque."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesfric.errors import BadInput
from bayesfric.estimates.least_squares import least_squares
from bayesfric.estimates.point_estimate import Estimate
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.measurement import Array, Measurement
from bayesfric.recordings.observation import Observation
from bayesfric.recordings.timing import longest_delay, retimed

_NAME = "drive.delay"
# Each round takes the torque of the delay that the last one found: far from it, what is linear
# in the delay holds only roughly. It stands still when it moves by less than this many sds.
_ROUNDS, _STILL = 10, 0.02


@dataclass(frozen=True)
class Delay:
    """By how much the position comes late, and what that does to totals where it is ignored."""

    recording: str
    value: float  # s
    sd: float  # s, the larger of the plain and the robust one; infinite if nothing tells
    samples: float  # the same in samples
    # by how many of their sds the totals of least squares move that ignore it
    moves: Mapping[str, float]


def delays(
    chain: Joint, recordings: Sequence[Measurement], observations: Sequence[Observation]
) -> list[Delay]:
    """Estimate the delay of each recording by itself; where nothing can, it is left out."""
    found = []
    for r, o in zip(recordings, observations, strict=True):
        own = (o.name,) if chain.own_offsets else ()
        alone = replace(chain, own_offsets=own, delay=False)
        try:
            value, sd = find_delay(replace(alone, delay=True), [r], [o])
            ignored = least_squares(alone, [retimed(o, r.segments, r.period, 0.0, r.back_emf)])
            there = retimed(o, r.segments, r.period, value, r.back_emf)
            # of the torque as it was then; the delay itself is taken as known
            known = replace(there, measured=there.measured - value * _rate(there))
            moves = _moves(ignored, least_squares(alone, [known]))
        except BadInput:
            continue
        found.append(Delay(o.name, value, sd, value / r.period, moves))
    return found


def find_delay(
    chain: Joint, recordings: Sequence[Measurement], observations: Sequence[Observation]
) -> tuple[float, float]:
    """Estimate the one delay of all recordings, s, and its sd.

    The chain has it among its parameters. Least squares tell it: what a mean transfer coefficient
    misses of load losses has little in common with the torque's rate. The delay found is no longer
    than what is trimmed off the ends.

    Raises
    ------
    BadInput
        If nothing can be estimated from these recordings.
    """
    pairs = list(zip(recordings, observations, strict=True))
    longest = min(longest_delay(o, r.period) for r, o in pairs)

    def at(delay: float) -> list[Observation]:
        return [retimed(o, r.segments, r.period, delay, r.back_emf) for r, o in pairs]

    delay, sd = 0.0, np.inf
    for _ in range(_ROUNDS):
        before = delay
        delay, sd = _told(least_squares(chain, at(delay)), longest)
        if not abs(delay - before) > _STILL * sd:
            break
    return delay, sd


def _told(estimate: Estimate, longest: float) -> tuple[float, float]:
    value = estimate[_NAME]
    sd = np.nanmax([value.sd, value.sd_robust, 0.0])
    if not np.isfinite(sd):
        return 0.0, np.inf
    return float(np.clip(value.value, -longest, longest)), float(sd)


def _rate(o: Observation) -> Array:
    assert o.inputs.torque_rate is not None
    return o.filter.apply(o.inputs.torque_rate.at(o.stamps))


def _moves(ignored: Estimate, known: Estimate) -> dict[str, float]:
    found = {}
    for value in ignored.values:
        sd = np.nanmax([value.sd, value.sd_robust, 0.0])
        if np.isfinite(sd) and sd > 0.0:
            found[value.name] = (value.value - known[value.name].value) / float(sd)
    return found
