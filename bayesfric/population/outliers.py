r"""A population with outliers: its mean and spread without them, and each run's probability.

Runs' true values are ``theta_r ~ (1 - e) N(mu, tau^2) + e Out``. Outliers have normals about ``mu``
of 3, 10 and 30 times ``sqrt(tau^2 + s^2)``, one third each, with ``s`` the median of the runs' sds.
Runs' likelihoods are those of :mod:`bayesfric.population.population`. The posterior is on a grid of
``mu``, ``tau`` and ``e``: ``mu`` flat, ``tau`` with that reference prior, the share ``e`` Beta(1,
19), a priori one in twenty. Far outliers then widen neither the spread nor its interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesfric.population.population import Interval, Likelihood, interval, log_prior
from bayesfric.recordings.arrays import Array

# Widths of the outliers' distribution.
_WIDTHS = np.array([3.0, 10.0, 30.0])
# Prior of the share, Beta(1, 19), and its grid.
_BETA = 19.0
_SHARES = np.geomspace(1e-4, 0.4, 14)
# Range of spreads, in the smallest sd and the largest distance; steps of a coarse and a fine grid.
_NARROWEST, _WIDEST, _COARSE, _FINE = 0.01, 30.0, 60, 36
_MEANS, _REACH = 25, 5.0
# Difference of the log posterior that is left out of the finer grid.
_NEGLIGIBLE = 12.0
_DRAWS, _POINTS = 8000, 64
# Runs at a time, for the cache.
_AT_ONCE = 500


@dataclass(frozen=True)
class WithOutliers:
    """A population, and the probability of each run to be an outlier."""

    mean: Interval
    spread: Interval  # sd of true values from run to run, outliers apart
    share: Interval  # of outliers
    outlying: tuple[float, ...]  # probability of each run


@dataclass(frozen=True, eq=False)
class _Runs:
    centres: Array  # (n, k), k the most that any has
    weights: Array  # (n, k), zero where it has fewer
    width: Array  # (n, 1)
    typical: float  # median of the sds

    def parts(self) -> list[_Runs]:
        cuts = range(0, len(self.width), _AT_ONCE)
        rows = [slice(c, c + _AT_ONCE) for c in cuts]
        return [_Runs(self.centres[r], self.weights[r], self.width[r], self.typical) for r in rows]

    def densities(self, mean: Array, spread: float) -> tuple[Array, Array]:
        """Integrals of the runs' likelihoods over both kinds, ``(m, n)`` each."""
        away = (mean[:, None, None] - self.centres) ** 2
        wide = _WIDTHS**2 * (spread**2 + self.typical**2)
        inside, *outside = (
            (self.weights * np.exp(-0.5 * away / v)).sum(axis=2) / np.sqrt(v[:, 0])
            for v in (self.width**2 + spread2 for spread2 in (spread**2, *wide))
        )
        return inside, np.mean(outside, axis=0)


def with_outliers(runs: Sequence[Likelihood], level: float = 0.9, seed: int = 0) -> WithOutliers:
    """Give the posterior of a population and the probability of each run to be an outlier.

    ValueError with fewer than two runs.
    """
    if len(runs) < 2:
        raise ValueError("a population takes two runs or more")
    means, sds = np.array([r.mean for r in runs]), np.array([r.sd for r in runs])
    middle, scale = float(np.median(means)), float(np.median(sds))
    means, sds = (means - middle) / scale, sds / scale
    count = max(r.centres.size for r in runs)
    centres, weights = np.zeros((2, len(runs), count))
    for k, run in enumerate(runs):
        centres[k, : run.centres.size] = (run.centres - middle) / scale
        weights[k, : run.centres.size] = run.weights
    width = np.array([[run.width / scale] for run in runs])
    all_runs = _Runs(centres, weights, width, 1.0)
    steps = np.linspace(*_range(means, sds), _FINE)
    centre, error = np.array([_mean(means, sds, tau) for tau in np.exp(steps)]).T
    z = np.linspace(-_REACH, _REACH, _MEANS)
    parts = all_runs.parts()
    log = np.zeros((_FINE, _MEANS, _SHARES.size))
    for i, tau in enumerate(np.exp(steps)):
        for part in parts:
            inside, outside = part.densities(centre[i] + error[i] * z, tau)
            for j, share in enumerate(_SHARES):
                both = (1.0 - share) * inside + share * outside
                log[i, :, j] += np.log(np.maximum(both, 1e-300)).sum(axis=1)
    log += (log_prior(sds, steps) + np.log(error))[:, None, None]
    # of the share: steps are even in its logarithm
    log += (_BETA - 1.0) * np.log1p(-_SHARES) + np.log(_SHARES)
    probability = np.exp(log - log.max()).ravel()
    rng = np.random.default_rng(seed)
    picked = rng.choice(probability.size, _DRAWS, p=probability / probability.sum())
    row, column, share = np.unravel_index(picked, log.shape)

    def between(size: float) -> Array:
        return np.asarray((rng.random(_DRAWS) - 0.5) * size)

    tau = np.exp(steps[row] + between(steps[1] - steps[0]))
    mu = centre[row] + error[row] * (z[column] + between(z[1] - z[0]))
    e = _SHARES[share] * np.exp(between(np.log(_SHARES[1] / _SHARES[0])))
    chances = []
    for part in parts:
        total = np.zeros(len(part.width))
        for k in range(0, _DRAWS, _DRAWS // _POINTS):
            inside, outside = part.densities(mu[k : k + 1], float(tau[k]))
            out = e[k] * outside[0]
            total += out / np.maximum(out + (1.0 - e[k]) * inside[0], 1e-300) / _POINTS
        chances += total.tolist()

    return WithOutliers(
        interval(mu, level, middle, scale),
        interval(tau, level, 0.0, scale),
        interval(e, level),
        tuple(chances),
    )


def _mean(means: Array, sds: Array, tau: float) -> tuple[float, float]:
    """Find the mean of a population of spread ``tau``, and its sd, as if runs were normal."""
    variance = sds**2 + tau**2
    mean = float(np.median(means))
    for _ in range(20):
        inliers = _inlier_probability(means, variance, mean, tau)
        mean = float((inliers / variance) @ means / (inliers / variance).sum())
    return mean, float(1.0 / np.sqrt((inliers / variance).sum()))


def _inlier_probability(means: Array, variance: Array, mean: float, tau: float) -> Array:
    """Give the probability of runs to be inliers, with one outlier in fifty."""
    inside, outside = _normals(means, variance, mean, tau)
    return np.asarray(0.98 * inside / (0.98 * inside + 0.02 * outside + 1e-300)) + 1e-6


def _normals(means: Array, variance: Array, mean: float, tau: float) -> tuple[Array, Array]:
    away = (means - mean) ** 2
    wide = variance[:, None] + _WIDTHS**2 * (tau**2 + 1.0)
    inside = np.exp(-0.5 * away / variance) / np.sqrt(variance)
    return inside, (np.exp(-0.5 * away[:, None] / wide) / np.sqrt(wide)).mean(axis=1)


def _range(means: Array, sds: Array) -> tuple[float, float]:
    """Find the range of the spread's logarithm for the finer grid."""
    low, high = _NARROWEST * float(sds.min()), _WIDEST * (float(np.ptp(means)) + float(sds.max()))
    steps = np.linspace(np.log(low), np.log(high), _COARSE)
    log = np.empty(_COARSE)
    for k, tau in enumerate(np.exp(steps)):
        mean, error = _mean(means, sds, tau)
        inside, outside = _normals(means, sds**2 + tau**2, mean, tau)
        each = np.log(np.maximum(0.98 * inside + 0.02 * outside, 1e-300))
        log[k] = each.sum() + np.log(error)
    log += log_prior(sds, steps)
    near = np.flatnonzero(log > log.max() - _NEGLIGIBLE)
    return steps[max(near[0] - 2, 0)], steps[min(near[-1] + 2, _COARSE - 1)]
