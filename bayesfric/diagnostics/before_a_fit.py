"""What makes any fit doubtful, as recordings and base parameters show it before a fit.

Checked are the position's units and columns, feedback of the motion in the torque, bands in which
the inertia is attenuated, negative losses, and unexplained torque. A doubt is a dictionary with its
``kind`` and the numbers that its wording needs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import permutations
from typing import Any

import numpy as np

from bayesfric.diagnostics.policy import LEAST_OUTPUTS
from bayesfric.estimates.autoregression import CORRELATED, lag_one
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
# Residual variance with another unit over that with this one, at most. Of measured spinning
# pendulums the right unit has 0.03 to 0.4, and none less than the right one.
FAR_LESS = 0.5
# Share of the torque's variance that a model should explain if its residual is not white.
EXPLAINED = 0.8
# Robust standard deviations below zero that are significant.
_NEGATIVE = 3.0


def little_explained(chain: Joint, observations: Sequence[Observation]) -> list[dict[str, Any]]:
    """Doubt a mechanism that explains less than 80 % even with its best base parameters.

    A white residual is no doubt: a small signal in white noise may have the right model.
    """
    share, residual = best_share(chain, observations)
    if (
        share >= EXPLAINED
        or not lag_one(residual, np.ones(residual.size - 1, np.bool_)) > CORRELATED
    ):
        return []
    quantity = effort_words("motor torque", chain.motor_motion)
    doubt = {"kind": "unexplained", "share": share, "quantity": quantity, "at_best": True}
    return [doubt | alternatives(chain, observations, share)]


def alternatives(chain: Joint, observations: Sequence[Observation], share: float) -> dict[str, Any]:
    """Suggest units and presets that may explain more than the mechanism in use."""
    has_gravity = "first_moment" in chain.load.choices or chain.load.motion != "rotary"
    with_gravity = {} if has_gravity else {name: preset.chain() for name, preset in PRESETS.items()}
    presets = [
        name
        for name, other in with_gravity.items()
        if "first_moment" in other.load.choices
        and name != chain.made_from
        and other.ratio == chain.ratio
    ]
    return {"units": other_units(chain, observations, share), "presets": presets}


def doubts_before(totals: Estimate, observations: Sequence[Observation]) -> list[dict[str, Any]]:
    """Collect doubts of recordings and their base parameters."""
    return [*_feedback_laws(observations), *_attenuated(observations), *_negative_losses(totals)]


def few_outputs(observations: Sequence[Observation], parameters: int) -> Iterator[dict[str, Any]]:
    """Report too few outputs to test the model, and how long a recording would suffice."""
    outputs, wanted = sum(o.measured.size for o in observations), parameters + LEAST_OUTPUTS
    if outputs < wanted:
        duration = sum(float(o.stamps[-1] - o.stamps[0]) for o in observations)
        counts = {"outputs": outputs, "parameters_free": parameters, "wanted": wanted}
        yield {"kind": "few", **counts, "seconds": duration * wanted / outputs}


def against_prior(contradicted: Mapping[str, tuple[float, float]]) -> Iterator[dict[str, Any]]:
    """Doubt estimates from data and a prior that contradict each other."""
    if contradicted:
        values = {name: value for name, (value, _) in contradicted.items()}
        times = {name: sds for name, (_, sds) in contradicted.items()}
        yield {"kind": "prior", "values": values, "priors": times}


def strange_velocity(observations: Sequence[Observation]) -> Iterator[dict[str, Any]]:
    """Report recorded velocities that differ from the position's derivative by a factor."""
    for o in observations:
        if (factor := o.settings.get("velocity_factor")) is not None:
            yield {"kind": "velocity", "recording": o.name, "factor": factor}


def _feedback_laws(observations: Sequence[Observation]) -> Iterator[dict[str, Any]]:
    """Group recordings by the feedback law that their torque follows."""
    laws: dict[str, list[str]] = {}
    for o in observations:
        if law := o.settings.get("feedback"):
            laws.setdefault(str(law), []).append(o.name)
    for law, names in laws.items():
        yield {"kind": "feedback", "law": law, "recordings": names}


def _attenuated(observations: Sequence[Observation]) -> Iterator[dict[str, Any]]:
    """Report requested bands that attenuate the inertia."""
    settings = {o.name: o.settings for o in observations if "band_narrower" in o.settings}
    if settings:
        yield {
            "kind": "attenuated",
            "bands": {
                name: [float(numbers["band_doubted"]), float(numbers["band_narrower"])]
                for name, numbers in settings.items()
            },
            "times": max(float(numbers["inertia_narrower"]) for numbers in settings.values()),
        }


def _negative_losses(totals: Estimate) -> Iterator[dict[str, Any]]:
    """Report losses and inertias that are significantly negative by least squares."""
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
    """Whether it must be positive; a square only bends the curve of a loss."""
    return row is not None and row.role == "own" and row.lower == 0.0 and row.power in (0, 1)


def best_share(chain: Joint, observations: Sequence[Observation]) -> tuple[float, Array]:
    """Return the share of variance explained by base parameters, and the residual ``(n,)``."""
    projection = TotalsProjection(chain, observations)
    measured = np.concatenate([o.measured for o in observations])
    residual = measured - projection.regressors @ projection.solve(measured)
    return 1.0 - float(np.var(residual) / np.var(measured)), residual


def other_units(
    chain: Joint, observations: Sequence[Observation], explained: float | None = None
) -> list[dict[str, Any]]:
    """List units of the position that explain far more of the torque, the best first.

    Position, speed and acceleration are scaled together. Only a torque that is nonlinear in the
    angle, such as gravity's, identifies the scale.
    """
    if chain.load.motion != "rotary":
        return []
    if explained is None:
        explained = best_share(chain, observations)[0]
    least = 1.0 - FAR_LESS * (1.0 - explained)
    better = [row for row in _explained_by_unit(chain, observations) if row["share"] > least]
    return sorted(better, key=lambda row: -float(row["share"]))


def _explained_by_unit(
    chain: Joint, observations: Sequence[Observation]
) -> Iterator[dict[str, Any]]:
    """Yield the explained share with each angle unit in place of each other."""
    for unit, other in permutations(_ANGLES, 2):
        times = units.scale([unit], "angle") / units.scale([other], "angle")
        moving = ("q", "qd", "qdd", "speed")
        scaled = [
            replace(o, smooth=None, **{key: times * getattr(o, key) for key in moving})
            for o in observations
        ]
        yield {"is": unit, "taken": other, "share": best_share(chain, scaled)[0]}
