r"""The population that runs are drawn from, from the posterior of each run alone.

A quantity differs from run to run, ``theta_r ~ N(mu, tau^2)``. Each run's posterior divided by its
prior is its likelihood, here a mixture of normals (a smooth histogram of its draws), whose integral
over ``theta_r`` is the likelihood of ``mu`` and ``tau`` in closed form.

``mu`` has a flat prior and ``tau`` the reference prior of the random-effects model [1]_,
``sqrt(sum tau^2/(s_r^2 + tau^2)^2)``: far above the runs' sds it is ``1/tau``, and intervals are
Student's and chi square's; near zero it vanishes. It is proper from two runs on.

References
----------
.. [1] O. Bodnar, A. Link, B. Arendacká, A. Possolo, C. Elster, "Bayesian estimation in random
   effects meta-analysis using a non-informative prior", Stat. Med. 36 (2017) 378-399.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy import stats

from bayesfric.recordings.arrays import Array

# Normals in a run's likelihood, and the width of each in the run's sd.
_NORMALS, _WIDTH = 32, 0.35
# Share of the draws beyond the outermost normal, on either side.
_TAIL = 1e-3
# Largest ratio of prior weights within a posterior.
_LARGEST_RATIO = 100.0
# Grid of the spread (from a share of the smallest sd to a multiple of the whole range) and of the
# mean, in its sds given the spread.
_SPREADS, _NARROWEST, _WIDEST = 90, 0.01, 300.0
_MEANS, _REACH = 49, 6.0
_DRAWS = 8000
# p value of one common truth below which runs disagree.
_P_VALUE = 0.05


@dataclass(frozen=True, eq=False)
class Likelihood:
    """One run's likelihood of a quantity: a mixture of normals."""

    centres: Array  # (k,)
    weights: Array  # (k,), sum one
    width: float  # of each normal

    @property
    def mean(self) -> float:
        """Mean of the mixture."""
        return float(self.weights @ self.centres)

    @property
    def sd(self) -> float:
        """Standard deviation of the mixture."""
        apart = float(self.weights @ (self.centres - self.mean) ** 2)
        return float(np.sqrt(apart + self.width**2))


def likelihood(draws: Array, sd: float | None = None, prior: Array | None = None) -> Likelihood:
    """Make a run's likelihood from draws of its posterior ``(n,)``."""
    x = draws[np.isfinite(draws)]
    spread = float(x.std())
    if not spread > 0.0:
        raise ValueError("draws that do not differ are no likelihood")
    middle = float(np.median(x))
    if sd is not None:
        x = middle + (x - middle) * (sd / spread)
        spread = sd
    counts, edges = np.histogram(x, _NORMALS, range=tuple(np.quantile(x, [_TAIL, 1.0 - _TAIL])))
    points, weights = 0.5 * (edges[1:] + edges[:-1]), counts / counts.sum()
    width = _WIDTH * spread
    # narrower, so that with the normals' width the mixture is as wide as the draws
    mean = float(x.mean())
    centre = weights @ points
    narrower = np.sqrt((spread**2 - width**2) / (weights @ (points - centre) ** 2))
    points = mean + (points - centre) * narrower
    if prior is not None:
        ratios = 1.0 / _density(prior, points)
        weights = weights * np.clip(ratios, None, _LARGEST_RATIO * ratios.min())
        weights /= weights.sum()
    positive = weights > 0.0
    return Likelihood(points[positive], weights[positive], width)


def normal(mean: float, sd: float) -> Likelihood:
    """Give the likelihood of a run known by a mean and an sd."""
    return Likelihood(np.array([mean]), np.ones(1), sd)


def _density(prior: Array, at: Array) -> Array:
    """Density of a prior's draws at points, by a normal kernel."""
    x = prior[np.isfinite(prior)]
    low, high = np.quantile(x, [0.25, 0.75])
    width = max(0.9 * (high - low) / 1.349 * x.size**-0.2, 1e-300)
    return np.asarray(np.exp(-0.5 * ((at[:, None] - x) / width) ** 2).mean(axis=1)) + 1e-12


@dataclass(frozen=True)
class Interval:
    """Median and ends of one number."""

    median: float
    low: float
    high: float


@dataclass(frozen=True)
class Varying:
    """A quantity that differs between runs."""

    mean: Interval  # of the population
    spread: Interval  # its standard deviation
    following: Interval  # the true value in the next recording
    runs: tuple[Interval, ...]  # each run's true value, given all runs


@dataclass(frozen=True)
class Population(Varying):
    """The same from runs fitted alone, and whether they agree."""

    # Cochran's Q of one common truth, and its p value
    q: float
    p_value: float

    @property
    def agree(self) -> bool:
        """Whether runs differ by no more than chance."""
        return self.p_value >= _P_VALUE


def population(runs: Sequence[Likelihood], level: float = 0.9, seed: int = 0) -> Population:
    """Give the posterior of a population's mean and spread, each run and the next one.

    ValueError with fewer than two runs.
    """
    if len(runs) < 2:
        raise ValueError("a population takes two runs or more")
    means, sds = np.array([r.mean for r in runs]), np.array([r.sd for r in runs])
    # scaled to order one
    middle, scale = float(np.median(means)), float(sds.min())
    means, sds = (means - middle) / scale, sds / scale
    widest = _WIDEST * (float(np.ptp(means)) + float(sds.max()))
    steps = np.linspace(np.log(_NARROWEST), np.log(widest), _SPREADS)
    spread = np.exp(steps)
    variance = sds**2 + spread[:, None] ** 2
    total = (1.0 / variance).sum(axis=1)
    centre = (means / variance).sum(axis=1) / total
    z = np.linspace(-_REACH, _REACH, _MEANS)
    mean = centre[:, None] + z / np.sqrt(total)[:, None]
    parts = [((r.centres - middle) / scale, r.weights, r.width / scale) for r in runs]
    log = sum(_log_likelihood(part, mean, spread[:, None]) for part in parts)
    # the prior, steps even in log tau, and those of the mean as wide as it
    log = log + log_prior(sds, steps)[:, None]
    log = log - 0.5 * np.log(total)[:, None]
    probability = np.exp(log - log.max()).ravel()
    rng = np.random.default_rng(seed)
    row, column = np.divmod(
        rng.choice(probability.size, _DRAWS, p=probability / probability.sum()), _MEANS
    )
    tau = np.exp(steps[row] + (rng.random(_DRAWS) - 0.5) * (steps[1] - steps[0]))
    z_drawn = z[column] + (rng.random(_DRAWS) - 0.5) * (z[1] - z[0])
    mu = centre[row] + z_drawn / np.sqrt(total[row])
    following = mu + tau * rng.standard_normal(_DRAWS)
    weights = 1.0 / sds**2
    q = float(weights @ (means - weights @ means / weights.sum()) ** 2)

    own_unit = partial(interval, level=level, shift=middle, unit=scale)
    return Population(
        mean=own_unit(mu),
        spread=interval(tau, level, unit=scale),
        following=own_unit(following),
        runs=tuple(own_unit(_draw_run(part, mu, tau, rng)) for part in parts),
        q=q,
        p_value=float(stats.chi2.sf(q, len(runs) - 1)),
    )


def log_prior(sds: Array, steps: Array) -> Array:
    """Give the log of the spread's reference prior on steps ``(n,)`` even in its logarithm.

    Up to a constant, for runs of sds ``(R,)``; see the module.
    """
    variance = sds**2 + np.exp(2.0 * steps)[:, None]
    return np.asarray(0.5 * np.log((1.0 / variance**2).sum(axis=1)) + 2.0 * steps)


def interval(draws: Array, level: float, shift: float = 0.0, unit: float = 1.0) -> Interval:
    """Median and central interval of ``shift + unit draws``."""
    ends = np.quantile(draws, [0.5, 0.5 - level / 2.0, 0.5 + level / 2.0])
    return Interval(*(shift + unit * float(end) for end in ends))


_Part = tuple[Array, Array, float]


def _log_likelihood(part: _Part, mean: Array, spread: Array) -> Array:
    """Integrate a run's likelihood over the population: log density of ``(tau, mu)`` grids."""
    centres, weights, width = part
    variance = width**2 + spread**2
    # one normal at a time: the grid of all would leave the cache
    total = np.zeros(mean.shape)
    scale = -0.5 / variance
    for centre, weight in zip(centres.tolist(), weights.tolist(), strict=True):
        total += weight * np.exp(scale * (mean - centre) ** 2)
    # no other run's likelihood can compensate where all vanish
    return np.asarray(np.log(np.maximum(total, 1e-300)) - 0.5 * np.log(variance))


def _draw_run(part: _Part, mean: Array, spread: Array, rng: np.random.Generator) -> Array:
    """Draw a run's true value given draws of the population ``(n,)``."""
    centres, weights, width = part
    variance = width**2 + spread**2
    terms = np.log(weights) - 0.5 * (mean[:, None] - centres) ** 2 / variance[:, None]
    # Gumbel's trick picks one of the normals by its weight
    picked = np.argmax(terms + rng.gumbel(size=terms.shape), axis=1)
    share = spread**2 / variance
    middle = mean + share * (centres[picked] - mean)
    return np.asarray(middle + np.sqrt(share) * width * rng.standard_normal(mean.size))
