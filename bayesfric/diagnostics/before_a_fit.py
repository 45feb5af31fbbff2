"""What makes any fit doubtful, as recordings and base parameters show it before a fit.

Checked are feedback of the motion in the torque, bands in which the inertia is attenuated, negative
losses, and unexplained torque. A doubt is a dictionary with its ``kind`` and the numbers that its
wording needs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bayesfric.diagnostics.statistics import least_outputs
from bayesfric.estimates.autoregression import CORRELATED, lag_one
from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.estimates.point_estimate import Estimate
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import QUANTITIES, effort_words, quantity_of
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.signals import Signals

# Share of the torque's variance that a model should explain if its residual is not white.
EXPLAINED = 0.8


def little_explained(chain: Joint, observations: Sequence[Signals]) -> list[dict[str, Any]]:
    """Doubt a mechanism that explains less than 80 % even with its best base parameters.

    A white residual is no doubt: a small signal in white noise may have the right model.
    """
    share, residual = best_share(chain, observations)
    white = not lag_one(residual, np.ones(residual.size - 1, np.bool_)) > CORRELATED
    if share >= EXPLAINED or white:
        return []
    quantity = effort_words("motor torque", chain.motor_motion)
    return [{"kind": "unexplained", "share": share, "quantity": quantity, "at_best": True}]


def doubts_before(totals: Estimate, observations: Sequence[Signals]) -> list[dict[str, Any]]:
    """Collect doubts of recordings and their base parameters."""
    return [*_feedback_laws(observations), *_attenuated(observations), *_negative_losses(totals)]


def few_outputs(observations: Sequence[Signals], parameters: int) -> Iterator[dict[str, Any]]:
    """Report too few outputs to test the model, and how many times as many would suffice."""
    outputs, wanted = (
        sum(o.measured.size for o in observations),
        parameters + least_outputs(observations),
    )
    if outputs < wanted:
        counts = {"outputs": outputs, "parameters_free": parameters, "wanted": wanted}
        yield {"kind": "few", **counts, "times": wanted / outputs}


def against_prior(contradicted: Mapping[str, tuple[float, float]]) -> Iterator[dict[str, Any]]:
    """Doubt estimates from data and a prior that contradict each other."""
    if contradicted:
        values = {name: value for name, (value, _) in contradicted.items()}
        times = {name: sds for name, (_, sds) in contradicted.items()}
        yield {"kind": "prior", "values": values, "priors": times}


def strange_velocity(observations: Sequence[Signals]) -> Iterator[dict[str, Any]]:
    """Report recorded velocities that differ from the position's derivative by a factor."""
    for o in observations:
        if (factor := o.settings.get("velocity_factor")) is not None:
            yield {"kind": "velocity", "recording": o.name, "factor": factor}


def _feedback_laws(observations: Sequence[Signals]) -> Iterator[dict[str, Any]]:
    """Group recordings by the feedback law that their torque follows."""
    laws: dict[str, list[str]] = {}
    for o in observations:
        if law := o.settings.get("feedback"):
            laws.setdefault(str(law), []).append(o.name)
    for law, names in laws.items():
        yield {"kind": "feedback", "law": law, "recordings": names}


def _attenuated(observations: Sequence[Signals]) -> Iterator[dict[str, Any]]:
    """Report requested bands that attenuate the inertia."""
    settings = {o.name: o.settings for o in observations if "band_narrower" in o.settings}
    bands = {n: [float(x["band_doubted"]), float(x["band_narrower"])] for n, x in settings.items()}
    if settings:
        times = max(float(numbers["inertia_narrower"]) for numbers in settings.values())
        yield {"kind": "attenuated", "bands": bands, "times": times}


def _negative_losses(totals: Estimate, sds: float = 3.0) -> Iterator[dict[str, Any]]:
    """Report losses and inertias that are significantly negative by least squares.

    A square only bends the curve of a loss.
    """
    below = {}
    for v in totals.values:
        row = QUANTITIES.get(quantity_of(v.name))
        loses = row and row.role == "own" and row.lower == 0.0 and row.power in (0, 1)
        if loses and np.isfinite(v.sd_robust) and v.value < -sds * max(v.sd, v.sd_robust):
            below[v.name] = v.value
    if below:
        yield {"kind": "negative", "values": below}


def best_share(chain: Joint, observations: Sequence[Signals]) -> tuple[float, Array]:
    """Return the share of variance explained by base parameters, and the residual ``(n,)``."""
    projection = TotalsProjection(chain, observations)
    measured = np.concatenate([o.measured for o in observations])
    residual = measured - projection.regressors @ projection.solve(measured)
    total = float(np.var(measured))  # 0 if the motor is off
    return 1.0 - float(np.var(residual)) / total if total else 1.0, residual
