"""Typical torque, speed and acceleration, which default priors are scaled by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.estimates.least_squares import TotalsProjection, least_squares
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.own_term import CarriedTerm, along
from bayesfric.mechanism.quantities import Sizes
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

# Quantile that is taken for the largest: a glitch must not set a scale.
_NEARLY_ALL = 0.999


@dataclass(frozen=True)
class TypicalSizes:
    """Sizes of what was measured."""

    torque: float  # Largest measured of the motor (99.9th percentile), N m or N
    speed: float  # Root mean square at the joint, rad or m and s
    acceleration: float
    lean: float = 1.0  # Largest sine of the joint's angle that gravity was seen at
    exchanged: float = 0.0  # Torque that one term surely takes, from another maybe, N m or N
    position: float = 1.0  # Range of the joint's, rad or m
    duration: float = 1.0  # Of the longest recording, s
    position_step: float = 0.0  # Finest that one was read in, rad or m; 0 where it is not known
    # rms torque of each custom or signal term, for a value of one
    columns: Mapping[str, float] = field(default_factory=dict)


def typical_sizes(chain: Joint, observations: Sequence[Observation]) -> TypicalSizes:
    """Take the scales from all recordings together."""
    torque = np.concatenate([o.measured for o in observations])
    # only where outputs are: an excluded glitch must not set a scale
    speed = np.concatenate([o.qd[o.filter.centres] for o in observations])
    acceleration = np.concatenate([o.acceleration for o in observations])
    duration = sum(o.period * o.measured.size for o in observations)
    return TypicalSizes(
        torque=float(np.quantile(np.abs(torque), _NEARLY_ALL)),
        lean=_lean(chain, observations),
        exchanged=_surely_taken(chain, observations),
        speed=_rms(speed),
        # a motion changes its speed at least once in all recordings
        acceleration=max(_rms(acceleration), _rms(speed) / duration),
        position=max(float(np.ptp(o.q[o.filter.centres])) for o in observations),
        duration=max(float(np.ptp(o.stamps)) for o in observations),
        position_step=min(o.position_step for o in observations),
        columns={
            chain.names[c.index]: _rms(np.concatenate([_at_outputs(c, o) for o in observations]))
            for c in chain.carried
        },
    )


def sizes_at(chain: Joint, owner: str, scales: TypicalSizes) -> Sizes:
    """Give the sizes at the input of an element, or of ``load``; losses on the way are left out."""
    to_joint = chain.reaches[owner]
    return Sizes(
        scales.torque * (chain.ratio / to_joint),
        scales.speed * to_joint,
        scales.acceleration * to_joint,
        chain.load.gravity,
        scales.lean,
        scales.duration,
    )


def _lean(chain: Joint, observations: Sequence[Observation]) -> float:
    # from an unknown zero it may be any
    if any(p.circular for p in chain.parameters):
        return 1.0
    largest = max(float(np.abs(np.sin(o.q[o.filter.centres])).max()) for o in observations)
    return largest or 1.0


def _surely_taken(chain: Joint, observations: Sequence[Observation]) -> float:
    """Give the largest torque of a single term by least squares, less two standard deviations."""
    projection = TotalsProjection(chain, observations)
    with suppress(BadInput):
        estimate = least_squares(chain, observations, projection)
        sizes = np.quantile(np.abs(projection.regressors), _NEARLY_ALL, axis=0)
        determined = np.array([v.determined for v in estimate.values])
        sds = np.array([max(v.sd, np.nan_to_num(v.sd_robust)) for v in estimate.values])
        lowest = np.abs([v.value for v in estimate.values]) - 2.0 * sds
        return float(np.max(lowest[determined] * sizes[determined], initial=0.0))
    return 0.0


def _at_outputs(carried: CarriedTerm, o: Observation) -> Array:
    centres = o.filter.centres
    return along(
        carried.row, carried.reach, o.q[centres], o.qd[centres], o.stamps[centres], o.inputs
    )


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))
