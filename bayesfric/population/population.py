r"""The population that runs are drawn from, from the posterior of each run alone, on a grid.

A quantity differs from run to run, ``theta_r ~ N(mu, tau^2)``. Each run's posterior divided by its
prior is its likelihood, here a mixture of normals (a smooth histogram of its draws), whose integral
over ``theta_r`` is the likelihood of ``mu`` and ``tau`` in closed form.

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
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bayesfric.recordings.arrays import Array

# Draws of a population.
_DRAWS = 8000
# Widths of the outliers' distribution, and grid of their share.
_WIDTHS = np.array([3.0, 10.0, 30.0])
_SHARES = np.geomspace(1e-4, 0.4, 14)


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


def likelihood(
    draws: Array,
    sd: float | None = None,
    prior: Array | None = None,
    *,
    normals: int = 32,
    width: float = 0.35,
    largest_ratio: float = 100.0,
) -> Likelihood:
    """Make a run's likelihood from draws of its posterior ``(n,)``.

    ``normals`` are of a ``width`` in the run's sd; ratios of prior weights are limited.
    """
    x = draws[np.isfinite(draws)]
    spread = float(x.std())
    if not spread > 0.0:
        raise ValueError("draws that do not differ are no likelihood")
    middle = float(np.median(x))
    if sd is not None:
        x = middle + (x - middle) * (sd / spread)
        spread = sd
    counts, edges = np.histogram(x, normals, range=tuple(np.quantile(x, [0.001, 0.999])))
    points, weights = 0.5 * (edges[1:] + edges[:-1]), counts / counts.sum()
    width *= spread
    # narrower, so that with the normals' width the mixture is as wide as the draws
    centre = weights @ points
    narrower = np.sqrt((spread**2 - width**2) / (weights @ (points - centre) ** 2))
    points = float(x.mean()) + (points - centre) * narrower
    if prior is not None:
        ratios = 1.0 / _density(prior, points)
        weights = weights * np.clip(ratios, None, largest_ratio * ratios.min())
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
        return self.p_value >= 0.05


@dataclass(frozen=True)
class WithOutliers:
    """A population, and the probability of each run to be an outlier."""

    mean: Interval
    spread: Interval  # sd of true values from run to run, outliers apart
    share: Interval  # of outliers
    outlying: tuple[float, ...]  # probability of each run


def population(runs: Sequence[Likelihood], level: float = 0.9, seed: int = 0) -> Population:
    """Give the posterior of a population's mean and spread, each run and the next one.

    ValueError with fewer than two runs.
    """
    likelihoods = _Likelihoods(runs)
    means, sds = likelihoods.means, likelihoods.sds
    middle, scale = likelihoods.middle, likelihoods.scale
    widest = 300.0 * (float(np.ptp(means)) + float(sds.max()))
    steps, z = np.linspace(np.log(0.01), np.log(widest), 90), np.linspace(-6.0, 6.0, 49)
    variance = sds**2 + np.exp(2.0 * steps)[:, None]
    total = (1.0 / variance).sum(axis=1)
    centre, error = (means / variance).sum(axis=1) / total, 1.0 / np.sqrt(total)
    log = np.empty((steps.size, z.size))
    for i, tau in enumerate(np.exp(steps)):
        each = likelihoods.integrated(centre[i] + error[i] * z, tau**2)
        log[i] = np.log(np.maximum(each, 1e-300)).sum(axis=1)
    # the prior, steps even in log tau, and those of the mean as wide as it
    log += (log_prior(sds, steps) + np.log(error))[:, None]
    rng = np.random.default_rng(seed)
    (row, _), (log_tau, deviation) = _draw_from_grid(log, (steps, z), rng)
    tau, mu = np.exp(log_tau), centre[row] + error[row] * deviation
    following = mu + tau * rng.standard_normal(_DRAWS)
    weights = 1.0 / sds**2
    q = float(weights @ (means - weights @ means / weights.sum()) ** 2)
    original = partial(interval, level=level, shift=middle, unit=scale)
    return Population(
        mean=original(mu),
        spread=interval(tau, level, unit=scale),
        following=original(following),
        runs=tuple(original(likelihoods.draw(r, mu, tau, rng)) for r in range(len(runs))),
        q=q,
        p_value=float(stats.chi2.sf(q, len(runs) - 1)),
    )


def with_outliers(runs: Sequence[Likelihood], level: float = 0.9, seed: int = 0) -> WithOutliers:
    """Give the posterior of a population and the probability of each run to be an outlier.

    ValueError with fewer than two runs.
    """
    likelihoods = _Likelihoods(runs)
    steps, z = likelihoods.steps_with_outliers(), np.linspace(-5.0, 5.0, 25)
    tau = np.exp(steps)
    centre, error = np.array([likelihoods.mean_of_inliers(t)[:2] for t in tau]).T
    log = np.empty((steps.size, z.size, _SHARES.size))
    for i in range(steps.size):
        inside, outside = likelihoods.both(centre[i] + error[i] * z, tau[i])
        for j, share in enumerate(_SHARES):
            mixed = (1.0 - share) * inside + share * outside
            log[i, :, j] = np.log(np.maximum(mixed, 1e-300)).sum(axis=1)
    log += (log_prior(likelihoods.sds, steps) + np.log(error))[:, None, None]
    # Beta(1, 19); steps are even in the share's logarithm
    log += 18.0 * np.log1p(-_SHARES) + np.log(_SHARES)
    rng = np.random.default_rng(seed)
    axes = (steps, z, np.log(_SHARES))
    (row, *_), (log_tau, deviation, log_share) = _draw_from_grid(log, axes, rng)
    tau, mu, e = np.exp(log_tau), centre[row] + error[row] * deviation, np.exp(log_share)
    outlying = []
    for k in range(0, _DRAWS, _DRAWS // 64):
        inside, outside = likelihoods.both(mu[k : k + 1], tau[k])
        out = e[k] * outside[0]
        outlying.append(out / np.maximum(out + (1.0 - e[k]) * inside[0], 1e-300))
    return WithOutliers(
        interval(mu, level, likelihoods.middle, likelihoods.scale),
        interval(tau, level, 0.0, likelihoods.scale),
        interval(e, level),
        tuple(np.mean(outlying, axis=0).tolist()),
    )


class _Likelihoods:
    """Likelihoods of ``R`` runs, mixtures of at most ``k`` normals.

    They are about the ``middle``, the median of their means, and in units of the smallest sd, the
    ``scale``. ``weights`` ``(R, k)`` are zero where a run has fewer normals.
    """

    def __init__(self, runs: Sequence[Likelihood]) -> None:
        if len(runs) < 2:
            raise ValueError("a population takes two runs or more")
        means, sds = np.array([r.mean for r in runs]), np.array([r.sd for r in runs])
        self.middle, self.scale = float(np.median(means)), float(sds.min())
        self.means, self.sds = (means - self.middle) / self.scale, sds / self.scale
        self.centres, self.weights = np.zeros((2, len(runs), max(r.centres.size for r in runs)))
        for k, run in enumerate(runs):
            self.centres[k, : run.centres.size] = (run.centres - self.middle) / self.scale
            self.weights[k, : run.centres.size] = run.weights
        self.width = np.array([[run.width / self.scale] for run in runs])

    def integrated(self, mean: Array, variance: float) -> Array:
        """Integrate over normals of means ``(m,)`` and a variance, ``(m, R)``."""
        v = self.width**2 + variance
        away = (mean[:, None, None] - self.centres) ** 2
        return np.asarray((self.weights * np.exp(-0.5 * away / v)).sum(axis=2) / np.sqrt(v[:, 0]))

    def both(self, mean: Array, spread: float) -> tuple[Array, Array]:
        """Integrate over inliers and outliers, ``(m, R)`` each."""
        wide = _WIDTHS**2 * (spread**2 + float(np.median(self.sds)) ** 2)
        outside = [self.integrated(mean, variance) for variance in wide]
        return self.integrated(mean, spread**2), np.mean(outside, axis=0)

    def draw(self, run: int, mean: Array, spread: Array, rng: np.random.Generator) -> Array:
        """Draw a run's true value given draws of the population ``(n,)``."""
        present = self.weights[run] > 0.0
        centres, width = self.centres[run, present], float(self.width[run, 0])
        variance = width**2 + spread**2
        terms = np.log(self.weights[run, present])
        terms = terms - 0.5 * (mean[:, None] - centres) ** 2 / variance[:, None]
        # Gumbel's trick picks one of the normals by its weight
        picked = np.argmax(terms + rng.gumbel(size=terms.shape), axis=1)
        share = spread**2 / variance
        middle = mean + share * (centres[picked] - mean)
        return np.asarray(middle + np.sqrt(share) * width * rng.standard_normal(mean.size))

    def mean_of_inliers(self, tau: float) -> tuple[float, float, float]:
        """Find the mean of a population, its sd, and its log-likelihood, as if runs were normal.

        One run in fifty is an outlier.
        """
        variance = self.sds**2 + tau**2
        wide = variance[:, None] + _WIDTHS**2 * (tau**2 + float(np.median(self.sds)) ** 2)
        mean = float(np.median(self.means))
        for _ in range(20):
            away = (self.means - mean) ** 2
            inside = 0.98 * np.exp(-0.5 * away / variance) / np.sqrt(variance)
            outside = (np.exp(-0.5 * away[:, None] / wide) / np.sqrt(wide)).mean(axis=1)
            total = inside + 0.02 * outside + 1e-300
            precisions = (inside / total + 1e-6) / variance
            mean = float(precisions @ self.means / precisions.sum())
        return mean, float(1.0 / np.sqrt(precisions.sum())), float(np.log(total).sum())

    def steps_with_outliers(self, coarse: int = 60, fine: int = 36) -> Array:
        """Give even steps of the spread's logarithm where its posterior is not negligible."""
        widest = 30.0 * (float(np.ptp(self.means)) + float(self.sds.max()))
        steps = np.linspace(np.log(0.01), np.log(widest), coarse)
        _, error, log = np.array([self.mean_of_inliers(t) for t in np.exp(steps)]).T
        log += np.log(error) + log_prior(self.sds, steps)
        near = np.flatnonzero(log > log.max() - 12.0)
        first, last = max(near[0] - 2, 0), min(near[-1] + 2, coarse - 1)
        return np.linspace(steps[first], steps[last], fine)


def _draw_from_grid(
    log: Array, axes: Sequence[Array], rng: np.random.Generator
) -> tuple[tuple[NDArray[np.intp], ...], list[Array]]:
    """Draw indices of cells by a log density, and places within cells of even axes."""
    probability = np.exp(log - log.max()).ravel()
    picked = rng.choice(probability.size, _DRAWS, p=probability / probability.sum())
    cells = np.unravel_index(picked, log.shape)
    pairs = zip(axes, cells, strict=True)
    return cells, [x[i] + (rng.random(_DRAWS) - 0.5) * (x[1] - x[0]) for x, i in pairs]


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
