"""Combine what the fits of an arm's joints say of its inertial parameters, and test consistency.

Given the inertial parameters, joints are independent except for what their residuals share (which a
study measures). So the joint posterior is the inertial prior times each fit's likelihood, which is
its posterior divided by that prior. The fit's posterior of its directions is taken as Gaussian; its
other parameters follow by linear regression on the draws. The cost does not depend on the length of
a log, and noise model and corrections of each fit stay.

A joint with model discrepancy contributes the likelihood of its widened draws, but its own numbers
stay: a discrepancy may have many causes and does not follow the inertial parameters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from bayesfric.arm.arm_log import signals
from bayesfric.arm.inertial_prior import InertialPrior, sample_feasible
from bayesfric.identifiability.local import WIDE
from bayesfric.inference.fitting import Fit
from bayesfric.inference.posterior import Posterior
from bayesfric.recordings.arrays import Array
from bayesfric.report.summary.derived_quantities import leaning, spread
from bayesfric.report.summary.record import PosteriorRow

_DRAWS = 4000
# Share of the prior's variance that data must remove before a direction is tested.
_CONTRACTION = 0.05
# Eigenvalues of the information below this are zero; largest width that is considered.
_ZERO, _MAX_WIDTH = 1e-9, 30.0
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
        if not directions.shape[1]:
            return cls.uninformative(len(directions))
        precision = np.linalg.inv(np.atleast_2d(np.cov(draws.T)))
        size, axes = np.linalg.eigh(precision - np.eye(len(precision)))
        # elsewhere sampling error and discrepancy left the prior as it was
        informed, size = axes[:, size > 0.0], size[size > 0.0]
        information = (informed * size) @ informed.T
        vector = informed @ (informed.T @ (precision @ draws.mean(axis=0)))
        return cls(directions @ information @ directions.T, directions @ vector)

    @classmethod
    def uninformative(cls, count: int) -> InertialLikelihood:
        """Return a constant likelihood of so many deviations."""
        return cls(np.zeros((count, count)), np.zeros(count))

    def __add__(self, other: InertialLikelihood) -> InertialLikelihood:
        return InertialLikelihood(self.information + other.information, self.vector + other.vector)

    @cached_property
    def width(self) -> float:
        """Factor on the prior's sds that maximises the marginal likelihood, at least 1."""
        size, axes = np.linalg.eigh(self.information)
        size, axes = size[size > _ZERO], axes[:, size > _ZERO]
        squares, noise = (axes.T @ self.vector / size) ** 2, 1.0 / size

        def negative_log_likelihood(log_width: float) -> float:
            variance = noise + math.exp(2.0 * log_width)
            return float(np.sum(np.log(variance) + squares / variance))

        bounds = (0.0, math.log(_MAX_WIDTH))
        optimum = minimize_scalar(negative_log_likelihood, bounds=bounds, method="bounded")
        wider = size.size and optimum.fun < negative_log_likelihood(0.0)
        return math.exp(optimum.x) if wider else 1.0

    def posterior(self) -> tuple[Array, Array]:
        """Mean and covariance of ``z``, with a normal prior of its :attr:`width`."""
        covariance = np.linalg.inv(np.eye(len(self.vector)) / self.width**2 + self.information)
        return np.asarray(covariance @ self.vector), np.asarray(covariance)

    def p(self, mean: Array | None = None, covariance: Array | None = None) -> float:
        """Chi-square p-value of the data under a Gaussian over ``z``, by default the prior."""
        size, axes = np.linalg.eigh(self.information)
        tested = size > _CONTRACTION / (1.0 - _CONTRACTION)
        size, axes = size[tested], axes[:, tested]
        if not size.size:
            return 1.0
        if mean is None or covariance is None:
            mean, covariance = np.zeros(len(self.vector)), np.eye(len(self.vector))
        difference = axes.T @ self.vector / size - axes.T @ mean
        scatter = np.diag(1.0 / size) + axes.T @ covariance @ axes
        return float(chi2.sf(difference @ np.linalg.solve(scatter, difference), size.size))


@dataclass(frozen=True, eq=False)
class JointFit:
    """A joint's fit, its rows of a summary, and its directions ``(n_deviations, k)``."""

    fit: Fit
    rows: Mapping[str, PosteriorRow]
    directions: Array

    @property
    def adequate(self) -> bool:
        """Whether no model discrepancy was found."""
        return self.fit.wide is self.fit

    def coefficients(self, flat: Array) -> Array:
        """Take the coefficients ``(n, k)`` of the directions, corrected as reported."""
        wide, columns = self.fit.wide.posterior, []
        for name in (f"load.{signal}" for signal in signals(self.directions.shape[1])):
            k, reported = wide.names.index(name), self.rows[name].reported.value
            columns.append(flat[:, k] + reported - np.median(wide[name]))
        return np.stack(columns, axis=1) if columns else np.zeros((len(flat), 0))

    @cached_property
    def likelihood(self) -> InertialLikelihood:
        """What the fit says of the inertial parameters."""
        draws = self.coefficients(self.fit.wide.posterior.flat())
        return InertialLikelihood.from_draws(draws, self.directions)


@dataclass(frozen=True, eq=False)
class JointConsistency:
    """The inertial parameters by all joints that agree."""

    draws: Array  # (n, n_deviations), all physical bodies
    p: float  # p-value of the data under the URDF
    physical: float  # share of the Gaussian's draws that are physical bodies
    width: float  # factor on the prior's sds
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
    prior: InertialPrior, fits: Mapping[str, JointFit], rng: np.random.Generator
) -> JointConsistency:
    """Combine the fits of all joints that agree.

    A joint that contradicts the others is excluded, the least likely first: position-dependent
    friction, or a wrong drive gain, looks like an inertial parameter to that joint alone.
    """
    likelihoods = {name: joint.likelihood for name, joint in fits.items()}
    constant = InertialLikelihood.uninformative(len(prior.deviations))
    agreed = [*likelihoods]

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
    return JointConsistency(draws, total.p(), physical, total.width, p_values, tuple(agreed))


def conditional_draws(joint: JointFit, z: Array, rng: np.random.Generator) -> Array:
    """Draw parameters ``(n, d)`` of a joint given deviations ``(n, n_deviations)``.

    NaN where they would be outside their bounds.
    """
    target = joint.fit.target
    flat = joint.fit.posterior.flat(_DRAWS)
    v = target.unbounded(flat)
    finite = np.isfinite(v).all(axis=1)
    v, x = v[finite], joint.coefficients(flat[finite])
    slopes = np.linalg.lstsq(x - x.mean(axis=0), v - v.mean(axis=0), rcond=None)[0]
    rows = rng.permutation(np.arange(len(z)) % len(v))
    draws = target.from_unbounded(v[rows] + (z @ joint.directions - x[rows]) @ slopes)
    draws[~np.isfinite(draws).all(axis=1)] = np.nan
    return np.asarray(draws)


def conditional_posterior(joint: JointFit, z: Array, rng: np.random.Generator) -> Posterior:
    """Return the posterior of an adequate joint given draws ``(n, n_deviations)``."""
    posterior = joint.fit.posterior
    draws = conditional_draws(joint, z[rng.integers(len(z), size=_DRAWS)], rng)
    draws = draws[np.isfinite(draws).all(axis=1)]
    diagnostics = replace(posterior.diagnostics, acceptance=np.ones((1, 1)))
    unknown = np.full((1, 1, len(draws)), np.nan)
    return replace(posterior, draws=draws[None, None], log_density=unknown, diagnostics=diagnostics)


def updated_rows(joint: JointFit, posterior: Posterior) -> dict[str, PosteriorRow]:
    """Change the reported numbers of an adequate joint as its draws change by all joints."""
    fit, before, after, rows = joint.fit, joint.fit.posterior, posterior.flat(), {}
    priors = dict(zip(posterior.names, posterior.priors, strict=True))
    bounds = {p.name: (p.lower, p.upper) for p in fit.chain.parameters}
    for name, row in joint.rows.items():
        if name not in bounds:
            rows[name] = row
            continue
        k, reported = posterior.names.index(name), row.reported
        was, now = spread(before[name].ravel()), spread(after[:, k])
        # corrections of the joint's own fit stay
        low, high = (
            max(end + b - a, bounds[name][0])
            for end, a, b in zip(reported.interval, was["interval"], now["interval"], strict=True)
        )
        value = min(max(reported.value + now["median"] - was["median"], low), high)
        update = leaning(after[:, k], priors[name].limits, bounds[name])
        sd = reported.sd * now["sd"] / was["sd"]
        if row.verdict == "weak" and sd < WIDE * (row.prior_sd or math.inf):
            update["verdict"] = "data"  # of all joints, and the URDF
        updated = row.model_copy(update=update)
        conclusion = updated.conclude(value, (low, high), sd)
        rows[name] = updated.model_copy(update={"reported": conclusion})
    return rows
