"""Whether the value of a term that fits better is one that the recordings tell.

A term may earn its place in the linear search and still come out as nothing: zero within its sd
once all parameters are fitted together, warmed up long after the recording has ended, or so far
below zero that friction would push.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Literal

import numpy as np

from bayesfric.estimates.point_estimate import Estimate, EstimatedValue
from bayesfric.estimates.torque_near import larger
from bayesfric.explain.candidates import Candidate
from bayesfric.explain.evidence import Score
from bayesfric.explain.ladder import compared
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.observation import Observation

# Standard deviations from nothing, and of how much better left-out motion is predicted, that are
# no chance.
_SURE = 2.0
# What shapes a term is told from the least to the most that is tried, and so far beyond.
_BEYOND = 2.0
# A change that was nearly over when the first output came is an extrapolation to what was before:
# this much of it must be seen, or its size says nothing of the joint.
_SEEN = 1.0 / 3.0
# Losses that may change sign with what they depend on.
_SIGNED = frozenset({"warming", "temperature"})

Reason = Literal["worse", "zero", "shape", "negative"]


def untold(
    one: Candidate,
    chain: Joint,
    estimate: Estimate,
    observations: Sequence[Observation],
    after: Score,
    before: Score,
) -> Reason | None:
    """Say why a term is not to be asked for, if it is not.

    ``chain`` has the term, ``estimate`` is of its parameters, ``after`` and ``before`` are scores
    with the term and without: each must gain by itself, or a strong one would carry others along.
    (By more than a standard error would lose one found term in thirty.) A value may be zero within
    its sds, as that of a power of speed which goes with its exponent and a constant loss, where
    left-out motion is predicted better by more than chance; see :func:`something`.
    """
    better, error = compared(after, before)
    if not (better > 0.0 and after.held_out < before.held_out):
        return "worse"
    if one.shape and not _shaped(estimate[one.shape[0]], one, observations):
        return "shape"
    if one.option in _SIGNED and _pushes(chain, dict(estimate.point), observations):
        return "negative"
    return None if something(one, estimate) or better > _SURE * error else "zero"


def sd_of(v: EstimatedValue) -> float | None:
    """Give the larger sd; what stands on a limit, or is not determined, has none."""
    sd = larger(v.sd, v.sd_robust)
    return None if math.isnan(v.sd) or math.isinf(sd) else sd


def _shaped(v: EstimatedValue, one: Candidate, observations: Sequence[Observation]) -> bool:
    """Whether a time constant, a speed or an exponent is one that this motion shows."""
    least, most = min(one.shapes), _BEYOND * max(one.shapes)
    if one.option != "warming":
        least /= _BEYOND
    if not (v.determined and least <= v.value <= most):
        return False
    if one.option != "warming":
        return True
    # the first outputs are as warm as the time since the recording began has made them
    times = [o.stamps[o.filter.centres] for o in observations]
    seen = [np.exp(-t.min() / v.value) - np.exp(-t.max() / v.value) for t in times if t.size]
    return max(seen, default=0.0) >= _SEEN


def something(one: Candidate, estimate: Estimate) -> bool:
    """Whether any number that a term brings is surely not what it is without the term."""
    neutral = {p.name: p.default for p in one.chain.parameters}
    told = [(v, sd) for v in map(estimate.__getitem__, one.new) if (sd := sd_of(v)) is not None]
    if one.instead:
        # two values in the place of one are something where they differ
        return any(
            abs(a.value - b.value) > _SURE * math.hypot(sd, other)
            for (a, sd), (b, other) in combinations(told, 2)
        )
    return any(abs(v.value - neutral[v.name]) > _SURE * sd for v, sd in told)


def _pushes(chain: Joint, point: Mapping[str, float], observations: Sequence[Observation]) -> bool:
    """Whether friction would push anywhere in the recordings."""
    values = chain.vector(point)
    for o in observations:
        speed, none = np.abs(o.qd), np.zeros(o.qd.size)
        forth, back = (
            inverse_torque(chain, values, o.q, qd, none, inputs=o.inputs, time=o.stamps)
            for qd in (speed, -speed)
        )
        if np.any((forth < back)[o.filter.centres]):
            return True
    return False
