"""Output error: the simulated position nearest the measured one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from bayesfric.estimates.methods import Estimator, Given

if TYPE_CHECKING:
    from bayesfric.estimates.point_estimate import Estimate


def _estimate(given: Given, found: Mapping[str, Estimate]) -> Estimate:
    from bayesfric.estimates.output_error import output_error

    return output_error(
        given.chain,
        given.trajectories(),
        given.observations,
        given.knowledge,
        given.options,
        found["input-error"],
    )


ESTIMATOR = Estimator(
    "output-error",
    "Output error of a simulation (recursive identification), section 4.3",
    3,
    _estimate,
    starts_from="input-error",
    simulates=True,
)
