"""What makes any fit doubtful, as recordings and base parameters show it before there is one.

Asked are units and columns of the position, a torque that a controller made of the motion, bands
in which the inertia comes out smaller, losses below zero, and a mechanism that leaves much of the
torque unexplained. Each doubt is a dictionary: its ``kind``, and the numbers that its wording
needs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np

from bayesfric.diagnostics.policy import LEAST_OUTPUTS
from bayesfric.estimates.information import CORRELATED, lag_one
from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.estimates.point_estimate import Estimate
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.parameter import effort_words, quantity_of
from bayesfric.mechanism.presets import PRESETS
from bayesfric.mechanism.quantities import QUANTITIES, Quantity
from bayesfric.recordings import units
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

_ANGLES = ("rad", "deg", "turn")
# What another reading leaves of the torque at most, over what this one leaves. Of the measured
# pendulums that spin the right unit leaves 0.03 to 0.4, and none leaves less than a right one does.
FAR_LESS = 0.5
# Share of the torque's variance that a model of the joint should explain, where what it leaves
# is no white noise.
EXPLAINED = 0.8
# Robust standard deviations below zero that are no chance.
_NEGATIVE = 3.0


def little_explained(chain: Joint, observations: Sequence[Observation]) -> list[dict[str, Any]]:
    """Doubt a mechanism that leaves much of the torque even with its best base parameters.

    There is a doubt where less than 80 % of the variance is explained and neighbouring residuals
    correlate by more than 0.2: a small signal in white noise is left little of, too, and its model
    may be right.
    """
    share, left = best_share(chain, observations)
    if share >= EXPLAINED or not lag_one(left, np.ones(left.size - 1, np.bool_)) > CORRELATED:
        return []
    quantity = effort_words("motor torque", chain.motor_motion)
    told = {"kind": "unexplained", "share": share, "quantity": quantity, "at_best": True}
    return [told | instead(chain, observations, share)]


def instead(chain: Joint, observations: Sequence[Observation], share: float) -> dict[str, Any]:
    """Say what may be wrong where little is explained: never the mechanism that is in use."""
    weighed = "first_moment" in chain.load.choices or chain.load.motion != "rotary"
    known = {} if weighed else {name: preset.chain() for name, preset in PRESETS.items()}
    presets = [
        name
        for name, other in known.items()
        if "first_moment" in other.load.choices
        and name != chain.made_from
        and other.ratio == chain.ratio
    ]
    return {"units": other_units(chain, observations, share), "presets": presets}


def doubts_before(totals: Estimate, observations: Sequence[Observation]) -> list[dict[str, Any]]:
    """Look for what makes any fit doubtful, in recordings and their base parameters."""
    return [*_feedback(observations), *_attenuated(observations), *_negative(totals)]


def few_outputs(observations: Sequence[Observation], parameters: int) -> Iterator[dict[str, Any]]:
    """Say that too few outputs are left to ask whether the model is right, and how long would do.

    A run says so by itself, where it has asked.
    """
    outputs, wanted = sum(o.measured.size for o in observations), parameters + LEAST_OUTPUTS
    if outputs < wanted:
        lasted = sum(float(o.stamps[-1] - o.stamps[0]) for o in observations)
        told = {"outputs": outputs, "parameters_free": parameters, "wanted": wanted}
        yield {"kind": "few", **told, "seconds": lasted * wanted / outputs}


def against_prior(contradicted: Mapping[str, tuple[float, float]]) -> Iterator[dict[str, Any]]:
    """Doubt what is made of data and a prior that contradict each other: neither supports it."""
    if contradicted:
        values = {name: value for name, (value, _) in contradicted.items()}
        times = {name: sds for name, (_, sds) in contradicted.items()}
        yield {"kind": "prior", "values": values, "priors": times}


def strange_velocity(observations: Sequence[Observation]) -> Iterator[dict[str, Any]]:
    """Name recorded velocities of another unit or column than their positions."""
    for o in observations:
        if (factor := o.settings.get("velocity_factor")) is not None:
            yield {"kind": "velocity", "recording": o.name, "factor": factor}


def _feedback(observations: Sequence[Observation]) -> Iterator[dict[str, Any]]:
    """Group recordings by the law that their torque follows, of speed's sign or position."""
    laws: dict[str, list[str]] = {}
    for o in observations:
        if law := o.settings.get("feedback"):
            laws.setdefault(str(law), []).append(o.name)
    for law, names in laws.items():
        yield {"kind": "feedback", "law": law, "recordings": names}


def _attenuated(observations: Sequence[Observation]) -> Iterator[dict[str, Any]]:
    """Name bands that were asked for and that lose part of the inertia."""
    seen = {o.name: o.settings for o in observations if "band_narrower" in o.settings}
    if seen:
        yield {
            "kind": "attenuated",
            "bands": {
                name: [float(numbers["band_doubted"]), float(numbers["band_narrower"])]
                for name, numbers in seen.items()
            },
            "times": max(float(numbers["inertia_narrower"]) for numbers in seen.values()),
        }


def _negative(totals: Estimate) -> Iterator[dict[str, Any]]:
    """Name losses and inertias that least squares finds below zero, beyond chance.

    That is three standard deviations; the larger of the plain and the robust one counts.
    """
    below = {
        v.name: v.value
        for v in totals.values
        if _loses(QUANTITIES.get(quantity_of(v.name)))
        and np.isfinite(v.sd_robust)
        and v.value < -_NEGATIVE * max(v.sd, v.sd_robust)
    }
    if below:
        yield {"kind": "negative", "values": below}


def _loses(row: Quantity | None) -> bool:
    """Whether energy is lost or stored by it; a negative square only bends the curve of a loss."""
    return row is not None and row.role == "own" and row.lower == 0.0 and row.power in (0, 1)


def best_share(chain: Joint, observations: Sequence[Observation]) -> tuple[float, Array]:
    """Give the share of the torque's variance that the best base parameters explain.

    Shapes: ``residual : ndarray`` (n,).
    """
    projection = TotalsProjection(chain, observations)
    measured = np.concatenate([o.measured for o in observations])
    left = measured - projection.regressors @ projection.solve(measured)
    return 1.0 - float(np.var(left) / np.var(measured)), left


def other_units(
    chain: Joint, observations: Sequence[Observation], explained: float | None = None
) -> list[dict[str, Any]]:
    """List units of the position that explain far more of the torque, the best first.

    Position, speed and acceleration are scaled together. Only a torque that is no power of the
    angle, such as gravity's, tells: the coefficients of inertia and friction absorb the scale.
    """
    if chain.load.motion != "rotary":
        return []
    if explained is None:
        explained = best_share(chain, observations)[0]
    least = 1.0 - FAR_LESS * (1.0 - explained)
    found = [one for one in _tried(chain, observations) if one["share"] > least]
    return sorted(found, key=lambda one: -float(one["share"]))


def _tried(chain: Joint, observations: Sequence[Observation]) -> Iterator[dict[str, Any]]:
    """Give what radian, degree and turn explain, each taken for each other one."""
    for one, other in permutations(_ANGLES, 2):
        times = units.scale([one], "angle") / units.scale([other], "angle")
        moving = ("q", "qd", "qdd", "speed")
        scaled = [
            replace(o, smooth=None, **{key: times * getattr(o, key) for key in moving})
            for o in observations
        ]
        yield {"is": one, "taken": other, "share": best_share(chain, scaled)[0]}
