r"""The population that runs are drawn from, from what each run alone says of a quantity.

A quantity differs from run to run, ``theta_r ~ N(mu, tau^2)``. A run determines its own to be
``y_r`` with the standard deviation ``s_r``, so that ``y_r ~ N(mu, s_r^2 + tau^2)``.

``mu`` has a flat prior and ``tau`` the reference prior of the random-effects model [1]_,
``sqrt(sum tau^2/(s_r^2 + tau^2)^2)``: far above the runs' sds it is ``1/tau``, and intervals are
Student's and chi square's; near zero it vanishes. It is proper from two runs on.

With outliers ``theta_r ~ (1 - e) N(mu, tau^2) + e Out``: normals about ``mu`` of 3, 10 and 30 times
``sqrt(tau^2 + s^2)``, one third each, with ``s`` the median of the runs' sds. Their share ``e`` is
Beta(1, 19), a priori one in twenty. Far outliers then widen neither the spread nor its interval.

References
----------
.. [1] O. Bodnar, A. Link, B. Arendacká, A. Possolo, C. Elster, "Bayesian estimation in random
   effects meta-analysis using a non-informative prior", Stat. Med. 36 (2017) 378-399.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bayesfric.recordings.arrays import Array

# Draws of a population.
_DRAWS = 8000
# Widths of the outliers' distribution, and grid of their share.
_WIDTHS = np.array([3.0, 10.0, 30.0])
_SHARES = np.geomspace(1e-4, 0.4, 14)


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
    runs: tuple[Interval, ...]  # each run's true value, from all runs together


@dataclass(frozen=True)
class Population(Varying):
    """The same from runs fitted alone, and whether they agree."""

    # Cochran's Q of one common truth, and its p value
    q: float
    p_value: float

    @property
    def agree(self) -> bool:
        """Whether runs differ by no more than chance."""
        return self.p_value >= 0.05


@dataclass(frozen=True)
class WithOutliers:
    """A population, and the probability of each run to be an outlier."""

    mean: Interval
    spread: Interval  # sd of true values from run to run, outliers apart
    share: Interval  # of outliers
    outlying: tuple[float, ...]  # probability of each run


def population(
    means: Sequence[float],
    sds: Sequence[float],
    level: float = 0.9,
    seed: int = 0,
    lower: float = -np.inf,
) -> Population:
    """Give the posterior of a population's mean and spread, each run and the next one.

    No value is below ``lower``, where the normal model would put some. ValueError with fewer than
    two runs.
    """
    y, s, middle, scale = _in_units_of_the_smallest_sd(means, sds)
    steps = np.linspace(np.log(0.01), np.log(300.0 * (float(np.ptp(y)) + float(s.max()))), 400)
    variance = s**2 + np.exp(2.0 * steps)[:, None]
    total = (1.0 / variance).sum(axis=1)
    centre = (y / variance).sum(axis=1) / total
    # the mean integrated in closed form
    log = _log_prior(s, steps) - 0.5 * np.log(total)
    log -= 0.5 * (np.log(variance) + (y - centre[:, None]) ** 2 / variance).sum(axis=1)
    rng = np.random.default_rng(seed)
    (row,), (log_tau,) = _draw_from_grid(log, (steps,), rng)
    tau = np.exp(log_tau)
    mean = centre[row] + rng.standard_normal(_DRAWS) / np.sqrt(total[row])
    following = mean + tau * rng.standard_normal(_DRAWS)
    share = tau[:, None] ** 2 / (s**2 + tau[:, None] ** 2)
    runs = mean[:, None] + share * (y - mean[:, None])
    runs += np.sqrt(share) * s * rng.standard_normal(share.shape)
    q = float((((y - np.average(y, weights=s**-2.0)) / s) ** 2).sum())

    def bounded(x: Array) -> Interval:
        return interval(np.maximum(middle + scale * x, lower), level)

    return Population(
        mean=bounded(mean),
        spread=interval(scale * tau, level),
        following=bounded(following),
        runs=tuple(map(bounded, runs.T)),
        q=q,
        p_value=float(stats.chi2.sf(q, y.size - 1)),
    )


def with_outliers(
    means: Sequence[float], sds: Sequence[float], level: float = 0.9, seed: int = 0
) -> WithOutliers:
    """Give the posterior of a population and the probability of each run to be an outlier.

    ValueError with fewer than two runs.
    """
    y, s, middle, scale = _in_units_of_the_smallest_sd(means, sds)
    z = np.linspace(-5.0, 5.0, 25)
    # first where the posterior of the spread is not negligible
    steps = np.linspace(np.log(0.01), np.log(30.0 * (float(np.ptp(y)) + float(s.max()))), 60)
    for count in (60, 36):
        steps = np.linspace(steps[0], steps[-1], count)
        centre, error = _mean_of_inliers(y, s, np.exp(steps))
        log = np.empty((count, z.size, _SHARES.size))
        for i, tau in enumerate(np.exp(steps)):
            inside, outside = _densities(y, s, centre[i] + error[i] * z, float(tau))
            for j, share in enumerate(_SHARES):
                mixed = (1.0 - share) * inside + share * outside
                log[i, :, j] = np.log(np.maximum(mixed, 1e-300)).sum(axis=1)
        log += (_log_prior(s, steps) + np.log(error))[:, None, None]
        # Beta(1, 19); steps are even in the share's logarithm
        log += 18.0 * np.log1p(-_SHARES) + np.log(_SHARES)
        near = np.flatnonzero(log.max(axis=(1, 2)) > log.max() - 12.0)
        if count == 60:
            steps = steps[max(near[0] - 2, 0) : near[-1] + 3]
    rng = np.random.default_rng(seed)
    axes = (steps, z, np.log(_SHARES))
    (row, *_), (log_tau, deviation, log_share) = _draw_from_grid(log, axes, rng)
    spreads, mean, e = np.exp(log_tau), centre[row] + error[row] * deviation, np.exp(log_share)
    outlying = []
    for k in range(0, _DRAWS, _DRAWS // 64):
        inside, outside = _densities(y, s, mean[k : k + 1], float(spreads[k]))
        out = e[k] * outside[0]
        outlying.append(out / np.maximum(out + (1.0 - e[k]) * inside[0], 1e-300))
    return WithOutliers(
        interval(middle + scale * mean, level),
        interval(scale * spreads, level),
        interval(e, level),
        tuple(np.mean(outlying, axis=0).tolist()),
    )


def _in_units_of_the_smallest_sd(
    means: Sequence[float], sds: Sequence[float]
) -> tuple[Array, Array, float, float]:
    """Give values about their median and sds, both over the smallest sd; and that median and sd."""
    if len(means) < 2:
        raise ValueError("a population takes two runs or more")
    middle, scale = float(np.median(means)), float(np.min(sds))
    return (np.asarray(means) - middle) / scale, np.asarray(sds) / scale, middle, scale


def _densities(y: Array, s: Array, mean: Array, spread: float) -> tuple[Array, Array]:
    """Densities of the runs' values as inliers and as outliers, ``(m, R)`` for means ``(m,)``."""

    def normal(variance: Array) -> Array:
        away = (y - mean[:, None]) ** 2
        return np.asarray(np.exp(-0.5 * away / variance) / np.sqrt(variance))

    wide = _WIDTHS**2 * (spread**2 + float(np.median(s)) ** 2)
    return normal(s**2 + spread**2), np.mean([normal(s**2 + v) for v in wide], axis=0)


def _mean_of_inliers(y: Array, s: Array, spreads: Array) -> tuple[Array, Array]:
    """Find the mean of a population of each spread ``(n,)``, and its sd, by iteration.

    It shapes the grid alone, with one run in fifty an outlier.
    """
    mean, error = np.full((2, spreads.size), float(np.median(y)))
    for i, tau in enumerate(spreads):
        for _ in range(20):
            inside, outside = (x[0] for x in _densities(y, s, mean[i : i + 1], float(tau)))
            weights = 0.98 * inside / (0.98 * inside + 0.02 * outside + 1e-300)
            precisions = (weights + 1e-6) / (s**2 + tau**2)
            mean[i] = precisions @ y / precisions.sum()
        error[i] = precisions.sum() ** -0.5
    return mean, error


def _draw_from_grid(
    log: Array, axes: Sequence[Array], rng: np.random.Generator
) -> tuple[tuple[NDArray[np.intp], ...], list[Array]]:
    """Draw indices of cells by a log density, and places within cells of even axes."""
    probability = np.exp(log - log.max()).ravel()
    picked = rng.choice(probability.size, _DRAWS, p=probability / probability.sum())
    cells = np.unravel_index(picked, log.shape)
    pairs = zip(axes, cells, strict=True)
    return cells, [x[i] + (rng.random(_DRAWS) - 0.5) * (x[1] - x[0]) for x, i in pairs]


def _log_prior(sds: Array, steps: Array) -> Array:
    """Give the log of the spread's reference prior on steps ``(n,)`` even in its logarithm."""
    variance = sds**2 + np.exp(2.0 * steps)[:, None]
    return np.asarray(0.5 * np.log((1.0 / variance**2).sum(axis=1)) + 2.0 * steps)


def interval(draws: Array, level: float) -> Interval:
    """Median and central interval of draws."""
    return Interval(*np.quantile(draws, [0.5, 0.5 - level / 2.0, 0.5 + level / 2.0]).tolist())
