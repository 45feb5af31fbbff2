"""Input error: the modelled torque nearest the measured one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from bayesfric.estimates.methods import Estimator, Given

if TYPE_CHECKING:
    from bayesfric.estimates.point_estimate import Estimate


def _estimate(given: Given, _: Mapping[str, Estimate]) -> Estimate:
    from bayesfric.estimates.input_error import input_error

    return input_error(given.chain, given.observations, given.knowledge, given.options)


ESTIMATOR = Estimator(
    "input-error", "Direct minimisation of the input error, section 4.2", 2, _estimate
)
