"""A torque once a turn of the joint that gravity does not explain.

With a known zero of its angle, gravity is a sine of the position alone. A zero that is off, or a
ripple of the motor's torque once a turn, has a cosine as well, and shows by it. The sine of a
ripple shows nowhere: it is gravity's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from bayesfric.errors import BadInput
from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.least_squares import (
    TotalsProjection,
    least_squares,
    total_label,
)
from bayesfric.estimates.methods import Given
from bayesfric.estimates.torque import places
from bayesfric.estimates.torque_near import bends, fitted_beside, larger, torque_near
from bayesfric.mechanism.joint import Joint

# Standard deviations that are no chance, and by how many of its own it must move gravity.
_SURE, _MOVED = 3.0, 1.0
# Intervals of 90 % hold 86 % where they are off by this many sds.
_FELT = 0.5
# Ratios this close to a whole number are one, written with few digits.
_ALIKE = 1e-3


@dataclass(frozen=True)
class OnceATurn:
    """The cosine of the position in the torque, where gravity is its sine."""

    value: float  # N m at the motor
    sd: float  # the larger of the plain and the robust one
    # by how many of its sds the total of gravity is off, were the sine as large
    moves: float
    # and by how many of theirs the totals of least squares are, as they take the cosine up
    others: Mapping[str, float]
    times: int  # a turn of the motor that a ripple would have, see gravity_like; 0 for none

    @property
    def moved(self) -> dict[str, float]:
        """Those of the others that move by so much that their intervals hold less than they say."""
        return {name: by for name, by in self.others.items() if abs(by) > _FELT}

    @property
    def matters(self) -> bool:
        """Whether it is no chance, and as much of a sine moves gravity by more than its sd."""
        return abs(self.value) > _SURE * self.sd and self.moves > _MOVED


def gravity_like(chain: Joint) -> int:
    """Count how often a turn the motor's torque ripples at the pace of gravity; 0 if it cannot.

    Once, where the motor turns as often as the joint; twice, where the joint turns twice as often.
    Behind a gear that makes it slower, no ripple of the motor is slow enough.
    """
    if chain.motor_motion != "rotary" or chain.load.motion != "rotary":
        return 0
    times = round(1.0 / chain.ratio)
    return times if abs(times * chain.ratio - 1.0) < _ALIKE else 0


def once_a_turn(given: Given, point: Mapping[str, float] | None = None) -> OnceATurn | None:
    """Estimate the cosine of the position in the torque.

    ``None`` where there is no gravity, where its angle is free, which takes the
    cosine up, or where nothing can be estimated. ``point`` as in
    :func:`bayesfric.estimates.delay.delays`.
    """
    chain, knowledge = given.chain, given.knowledge
    if all(p.quantity != "first_moment" for p in chain.parameters):
        return None
    if (angle := _angle(chain)) and angle not in knowledge.fixed:
        return None
    with suppress(BadInput):
        if not bends(chain) and not angle:
            return _found(given, None)
        if point is None:
            estimate = input_error(chain, given.observations, knowledge, given.options)
            point = dict(estimate.point)
        return _found(given, point)
    return None


def _angle(chain: Joint) -> str:
    """Name the angle of gravity's zero; empty where it has none."""
    return next((p.name for p in chain.parameters if p.circular), "")


def _found(given: Given, point: Mapping[str, float] | None) -> OnceATurn | None:
    chain, observations = given.chain, given.observations
    regressors, model = torque_near(chain, observations, point)
    zero = 0.0
    if angle := _angle(chain):
        assert point is not None
        # what turns gravity is known: else it would stand for the cosine
        regressors = np.delete(regressors, chain.names.index(angle), axis=1)
        zero = point[angle]
    waves = np.concatenate(
        # a cosine that hardly turns is a constant, which this must not be taken for
        [o.filter.apply(np.stack([np.ones_like(o.q), np.cos(o.q + zero)])).T for o in observations]
    )
    target = np.concatenate([o.measured for o in observations]) - model
    # a constant twice over, where the joint has one already, changes nothing else
    found = fitted_beside(regressors, waves, target, places(observations))
    if found is None:
        return None
    value, sd = found.value, found.sd
    totals, projection = least_squares(chain, observations), TotalsProjection(chain, observations)
    taken_up = projection.solve(value * waves[:, -1])
    errors = {v.name: larger(v.sd, v.sd_robust) for v in totals.values}
    by = dict(zip(projection.labels, taken_up.tolist(), strict=True))
    gravity = total_label(chain, "gravity")
    error = errors[gravity]
    if not (math.isfinite(sd) and math.isfinite(error) and error > 0.0):
        return None
    others = {
        name: shift / errors[name]
        for name, shift in by.items()
        if name != gravity and math.isfinite(errors[name]) and errors[name] > 0.0
    }
    return OnceATurn(value, sd, abs(value) / error, others, gravity_like(chain))
