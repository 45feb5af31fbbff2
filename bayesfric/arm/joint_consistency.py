"""Combine what the fits of an arm's joints say of its inertial parameters, and test consistency.

Given the inertial parameters, joints are independent except for what their residuals share (which a
study measures). So the joint posterior is the inertial prior times each fit's likelihood, which is
its posterior divided by that prior. The fit's posterior of its directions is taken as Gaussian. The
cost does not depend on the length of a log, and noise model and corrections of each fit stay.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

from bayesfric.arm.inertial_prior import InertialPrior, sample_feasible
from bayesfric.recordings.arrays import Array

# Below this p-value joints contradict each other, or the URDF.
UNLIKELY = 0.01


@dataclass(frozen=True, eq=False)
class InertialLikelihood:
    """The likelihood ``exp(-z'J z/2 + h'z)`` of deviations ``z`` by the data of joints."""

    information: Array  # J, (n_deviations, n_deviations)
    vector: Array  # h, (n_deviations,)

    @classmethod
    def from_draws(cls, draws: Array, directions: Array) -> InertialLikelihood:
        """Divide posterior draws ``(n, k)`` of ``directions`` by their standard normal prior."""
        precision = np.linalg.inv(np.atleast_2d(np.cov(draws.T)))
        size, axes = np.linalg.eigh(precision - np.eye(len(precision)))
        # elsewhere sampling error and discrepancy left the prior as it was
        informed, size = axes[:, size > 0.0], size[size > 0.0]
        information = (informed * size) @ informed.T
        vector = informed @ (informed.T @ (precision @ draws.mean(axis=0)))
        return cls(directions @ information @ directions.T, directions @ vector)

    def __add__(self, other: InertialLikelihood) -> InertialLikelihood:
        return InertialLikelihood(self.information + other.information, self.vector + other.vector)

    def posterior(self) -> tuple[Array, Array]:
        """Mean and covariance of ``z``, with its standard normal prior."""
        covariance = np.linalg.inv(np.eye(len(self.vector)) + self.information)
        return np.asarray(covariance @ self.vector), np.asarray(covariance)

    def p(
        self,
        mean: Array | float = 0.0,
        covariance: Array | None = None,
        *,
        contraction: float = 0.05,
    ) -> float:
        """Chi-square p-value of the data under a Gaussian over ``z``, by default the prior.

        Of directions in which data remove at least a share ``contraction`` of the prior's variance.
        """
        size, axes = np.linalg.eigh(self.information)
        tested = size > contraction / (1.0 - contraction)
        size, axes = size[tested], axes[:, tested]
        if not size.size:
            return 1.0
        covariance = np.eye(len(axes)) if covariance is None else covariance
        difference = axes.T @ self.vector / size - axes.T @ (mean + np.zeros(len(axes)))
        scatter = np.diag(1.0 / size) + axes.T @ covariance @ axes
        return float(chi2.sf(difference @ np.linalg.solve(scatter, difference), size.size))


@dataclass(frozen=True, eq=False)
class JointConsistency:
    """The inertial parameters by all joints that agree."""

    draws: Array  # (n, n_deviations), all physical bodies
    p: float  # p-value of the data under the URDF, with its widths as stated
    physical: float  # share of the Gaussian's draws that are physical bodies
    p_values: Mapping[str, float]  # by joint, under what the others that agree say
    agreed: tuple[str, ...]  # joints that are combined

    def deviations(self, prior: InertialPrior) -> list[dict[str, Any]]:
        """List name, value, sd, prior_sd and unit of the deviations, the surest first."""
        value, sd = self.draws.mean(axis=0), self.draws.std(axis=0)
        rows = []
        for k in np.argsort(-np.abs(value) / sd).tolist():
            name, scale, unit = prior.deviations[k]
            numbers = {"value": float(value[k]) * scale, "sd": float(sd[k]) * scale}
            rows.append({"name": name, **numbers, "prior_sd": scale, "unit": unit})
        return rows


def combine_joints(
    prior: InertialPrior, likelihoods: Mapping[str, InertialLikelihood], rng: np.random.Generator
) -> JointConsistency:
    """Combine the likelihoods of all joints that agree.

    A joint that contradicts the others, under the widths and scales that explain all joints best,
    is excluded, the least likely first: position-dependent friction looks like an inertial
    parameter to that joint alone.
    """
    count, agreed = len(prior.deviations), [*likelihoods]
    constant = InertialLikelihood(np.zeros((count, count)), np.zeros(count))

    def p_value(name: str) -> float:
        others = (likelihoods[other] for other in agreed if other != name)
        return likelihoods[name].p(*sum(others, constant).posterior())

    p_values = {name: p_value(name) for name in likelihoods}
    while len(agreed) > 1 and (least := min(p_values[n] for n in agreed)) * len(agreed) < UNLIKELY:
        # of two that contradict each other none is known to be right
        agreed = [n for n in agreed if p_values[n] > least] if len(agreed) > 2 else []
        p_values |= {name: p_value(name) for name in likelihoods if agreed}
    total = sum((likelihoods[name] for name in agreed), constant)
    draws, physical = sample_feasible(
        prior.nominal, prior.spread, *total.posterior(), prior.feasible, rng
    )
    stated = np.diag(1.0 / (prior.widths * np.ones(len(prior.deviations))) ** 2)
    p = total.p(covariance=stated)
    return JointConsistency(draws, p, physical, p_values, tuple(agreed))
