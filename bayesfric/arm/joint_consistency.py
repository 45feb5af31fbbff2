"""All joints of an arm together: what each says of the bodies, joined, and what that says of each.

Given the bodies, joints are independent but for what their residuals share (which a study
measures). So the posterior of all is the prior of the bodies times what each joint's own fit says
beside that prior. Of a joint's fit the directions that it feels of the bodies are taken for
Gaussian; its own parameters move along with them as its draws do. So cost does not depend on the
length of a log, and all that a joint's fit has, its noise and its corrections, stays.

A joint whose model lacks something says of bodies what its draws with room for that leave; but its
own numbers stay: that room is of many kinds of what may be missing, and does not move along.
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
from bayesfric.arm.inertial_prior import Doubt
from bayesfric.arm.inertia import drawn_possible
from bayesfric.identifiability.local import WIDE
from bayesfric.inference.fitting import Fit
from bayesfric.inference.posterior import Posterior
from bayesfric.recordings.arrays import Array
from bayesfric.report.summary.conclusions import told_by_data
from bayesfric.report.summary.derived_quantities import leaning, spread
from bayesfric.report.summary.rows import PosteriorRow
from bayesfric.results.reported import Spread, concluded

# Draws of a joint that are moved.
_DRAWS = 4000
# Share of the prior's variance that data must take off before a direction is judged by it.
_TELLING = 0.05
# Information that is none, and how far bodies may be off at most, of what was said.
_NOTHING, _WIDEST = 1e-9, 30.0
# Below this chance joints are said to disagree, and bodies to be otherwise than in the URDF.
UNLIKELY = 0.01


@dataclass(frozen=True, eq=False)
class Said:
    """What one joint's data say of the bodies: ``exp(-z'J z/2 + h'z)``, beside any prior.

    Attributes
    ----------
    information
        ``J``, ``(n_causes, n_causes)``.
    pull
        ``h``, ``(n_causes,)``.
    """

    information: Array
    pull: Array

    @classmethod
    def by(cls, draws: Array, kept: Array) -> Said:
        """Take the standard normal prior off draws ``(n, k)`` of the directions ``kept``."""
        if not kept.shape[1]:
            return cls.nothing(len(kept))
        precision = np.linalg.inv(np.atleast_2d(np.cov(draws.T)))
        size, ways = np.linalg.eigh(precision - np.eye(len(precision)))
        told = ways[:, size > 0.0]  # elsewhere sampling and model error left the prior as it was
        information = (told * size[size > 0.0]) @ told.T
        pull = told @ (told.T @ (precision @ draws.mean(axis=0)))
        return cls(kept @ information @ kept.T, kept @ pull)

    @classmethod
    def nothing(cls, count: int) -> Said:
        """Say nothing of so many causes."""
        return cls(np.zeros((count, count)), np.zeros(count))

    def __add__(self, other: Said) -> Said:
        return Said(self.information + other.information, self.pull + other.pull)

    @cached_property
    def width(self) -> float:
        """How many times as far off as was said bodies most likely are, at least as far.

        The standard deviation of ``z`` under which the data are likeliest.
        """
        size, ways = np.linalg.eigh(self.information)
        size, ways = size[size > _NOTHING], ways[:, size > _NOTHING]
        squares, noise = (ways.T @ self.pull / size) ** 2, 1.0 / size

        def unlikely(log_width: float) -> float:
            variance = noise + math.exp(2.0 * log_width)
            return float(np.sum(np.log(variance) + squares / variance))

        found = minimize_scalar(unlikely, bounds=(0.0, math.log(_WIDEST)), method="bounded")
        return math.exp(found.x) if size.size and found.fun < unlikely(0.0) else 1.0

    def posterior(self) -> tuple[Array, Array]:
        """Mean and covariance of ``z``, with a normal prior of its :attr:`width`."""
        covariance = np.linalg.inv(np.eye(len(self.pull)) / self.width**2 + self.information)
        return np.asarray(covariance @ self.pull), np.asarray(covariance)

    def p(self, mean: Array | None = None, covariance: Array | None = None) -> float:
        """Chance of data as far from a Gaussian belief in ``z``, the prior if left out."""
        size, ways = np.linalg.eigh(self.information)
        judged = size > _TELLING / (1.0 - _TELLING)
        size, ways = size[judged], ways[:, judged]
        if not size.size:
            return 1.0
        if mean is None or covariance is None:
            mean, covariance = np.zeros(len(self.pull)), np.eye(len(self.pull))
        far = ways.T @ self.pull / size - ways.T @ mean
        scatter = np.diag(1.0 / size) + ways.T @ covariance @ ways
        return float(chi2.sf(far @ np.linalg.solve(scatter, far), size.size))


@dataclass(frozen=True, eq=False)
class Felt:
    """A joint's fit, its rows of a summary, and the directions ``(n_causes, k)`` that it feels."""

    fit: Fit
    rows: Mapping[str, PosteriorRow]
    kept: Array

    @property
    def sound(self) -> bool:
        """Whether nothing was found that its model lacks."""
        return self.fit.wide is self.fit

    def draws(self, flat: Array) -> Array:
        """Take the directions ``(n, k)`` out of draws, corrected as they are reported."""
        wide, found = self.fit.wide.posterior, []
        for name in (f"load.{one}" for one in signals(self.kept.shape[1])):
            k, told = wide.names.index(name), self.rows[name].told
            found.append(flat[:, k] + told.value - np.median(wide[name]))
        return np.stack(found, axis=1) if found else np.zeros((len(flat), 0))


@dataclass(frozen=True, eq=False)
class Together:
    """What joints that agree say of the bodies.

    Attributes
    ----------
    draws
        ``(n, n_causes)`` of the causes by which bodies may be otherwise; all are bodies that can
        be.
    p
        Chance of data as far from the URDF.
    physical
        Share of the Gaussian's draws that are bodies that can be.
    width
        How many times as far off as was said bodies are taken to be.
    apart
        Chance, by joint, of data as far from what the others that agree say.
    agreed
        Joints that are in it.
    """

    draws: Array
    p: float
    physical: float
    width: float
    apart: Mapping[str, float]
    agreed: tuple[str, ...]

    def causes(self, doubt: Doubt) -> list[dict[str, Any]]:
        """Say how bodies are otherwise, those first of which that is surest.

        Each has name, value, sd, prior_sd and unit.
        """
        value, sd = self.draws.mean(axis=0), self.draws.std(axis=0)
        found = []
        for k in np.argsort(-np.abs(value) / sd).tolist():
            name, one, unit = doubt.causes[k]
            told = {"value": float(value[k]) * one, "sd": float(sd[k]) * one, "prior_sd": one}
            found.append({"name": name, **told, "unit": unit})
        return found


def together(doubt: Doubt, fits: Mapping[str, Felt], rng: np.random.Generator) -> Together:
    """Join what fits say of the bodies.

    A joint that contradicts the others is left out, the one that does so most first: each motor's
    friction by angle, or a drive gain that is wrong, looks like a body to it alone.

    Parameters
    ----------
    doubt
        What is known of the bodies beforehand.
    fits
        By joint.
    rng
        Random numbers.
    """
    said = {
        name: Said.by(one.draws(one.fit.wide.posterior.flat()), one.kept)
        for name, one in fits.items()
    }
    nothing, agreed = Said.nothing(len(doubt.causes)), [*said]

    def far(name: str) -> float:
        others = (said[one] for one in agreed if one != name)
        return said[name].p(*sum(others, nothing).posterior())

    apart = {name: far(name) for name in said}
    while len(agreed) > 1 and (least := min(apart[n] for n in agreed)) * len(agreed) < UNLIKELY:
        # of two that contradict each other none is known to be right
        agreed = [n for n in agreed if apart[n] > least] if len(agreed) > 2 else []
        apart |= {name: far(name) for name in said if agreed}
    every = sum((said[name] for name in agreed), nothing)
    draws, physical = drawn_possible(
        doubt.nominal, doubt.spread, *every.posterior(), doubt.inside, rng
    )
    return Together(draws, every.p(), physical, every.width, apart, tuple(agreed))


def beside(joint: Felt, z: Array, rng: np.random.Generator) -> Array:
    """Draw parameters ``(n, d)`` of a joint, moved to bodies ``z`` ``(n, n_causes)``.

    NaN where bounds cut what they come to.
    """
    target = joint.fit.target
    flat = joint.fit.posterior.flat(_DRAWS)
    v = target.unbounded(flat)
    fine = np.isfinite(v).all(axis=1)
    v, own = v[fine], joint.draws(flat[fine])
    slopes = np.linalg.lstsq(own - own.mean(axis=0), v - v.mean(axis=0), rcond=None)[0]
    some = rng.permutation(np.arange(len(z)) % len(v))
    found = target.from_unbounded(v[some] + (z @ joint.kept - own[some]) @ slopes)
    found[~np.isfinite(found).all(axis=1)] = np.nan
    return np.asarray(found)


def moved(joint: Felt, z: Array, rng: np.random.Generator) -> Posterior:
    """Move draws of a sound joint to bodies ``z`` ``(n, n_causes)``, the rest along with these."""
    posterior = joint.fit.posterior
    found = beside(joint, z[rng.integers(len(z), size=_DRAWS)], rng)
    found = found[np.isfinite(found).all(axis=1)]
    diagnostics = replace(posterior.diagnostics, acceptance=np.ones((1, 1)))
    unknown = np.full((1, 1, len(found)), np.nan)
    return replace(posterior, draws=found[None, None], log_density=unknown, diagnostics=diagnostics)


def retold(joint: Felt, posterior: Posterior) -> dict[str, PosteriorRow]:
    """Change numbers as reported by what all joints change of the draws of a sound one."""
    fit, before, after, found = joint.fit, joint.fit.posterior, posterior.flat(), {}
    priors = dict(zip(posterior.names, posterior.priors, strict=True))
    possible = {p.name: (p.lower, p.upper) for p in fit.chain.parameters}
    for name, row in joint.rows.items():
        if name not in possible or row.reported is None:
            found[name] = row
            continue
        k, told = posterior.names.index(name), row.reported
        was, now = spread(before[name].ravel()), spread(after[:, k])
        # corrections of the joint's own fit stay
        low, high = (
            max(end + b - a, possible[name][0])
            for end, a, b in zip(told.interval, was["interval"], now["interval"], strict=True)
        )
        value = min(max(told.value + now["median"] - was["median"], low), high)
        update = leaning(after[:, k], priors[name].limits, possible[name])
        sd = told.sd * now["sd"] / was["sd"]
        if row.verdict == "weak" and sd < WIDE * (row.prior_sd or math.inf):
            update["verdict"] = "data"  # of all joints, and the URDF
        here = row.model_copy(update=update)
        leans = here.at_bound is not None and (here.verdict == "data" or told_by_data(here))
        one = concluded(
            Spread(value, low, high, sd),
            verdict=here.verdict,
            own_prior=told.status == "prior",
            converged=told.how.converged,
            limit=here.at_bound if leans else None,
            findings=told.how.findings,
        )
        found[name] = here.model_copy(update={"reported": one})
    return found
