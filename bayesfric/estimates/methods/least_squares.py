"""Least squares: what the motor feels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from bayesfric.estimates.methods import Estimator, Given

if TYPE_CHECKING:
    from bayesfric.estimates.point_estimate import Estimate


def _estimate(given: Given, _: Mapping[str, Estimate]) -> Estimate:
    from bayesfric.estimates.least_squares import least_squares

    return least_squares(given.chain, given.observations)


ESTIMATOR = Estimator(
    "least-squares", "Least squares, section 4.1, eq. (11): what the motor feels", 1, _estimate
)
