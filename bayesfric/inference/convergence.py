"""Whether several independent ensembles agree, and how many independent draws they are worth."""

from __future__ import annotations

import numpy as np
from emcee.autocorr import function_1d, integrated_time
from numpy.typing import NDArray


def nested_rhat(draws: NDArray[np.float64]) -> NDArray[np.float64]:
    """Nested R-hat of Margossian et al. (2024): ensembles against each other.

    Plain R-hat over the walkers of one ensemble says nothing, since they are not
    independent chains. Here an ensemble is a superchain: the variance of the
    ensembles' means is compared with the variance inside them.

    Parameters
    ----------
    draws
        ``(ensembles, walkers, steps, d)``, at least two ensembles and two steps.

    Returns
    -------
    ndarray
        ``(d,)``; 1 where the ensembles agree, infinite for a constant
        parameter whose ensembles differ.
    """
    walker_means = draws.mean(axis=2)
    between_walkers = walker_means.var(axis=1, ddof=1)
    within_walkers = draws.var(axis=2, ddof=1).mean(axis=1)
    within = (between_walkers + within_walkers).mean(axis=0)
    between = walker_means.mean(axis=1).var(axis=0, ddof=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(between == 0.0, 0.0, between / within)
    return np.asarray(np.sqrt(1.0 + ratio))


def autocorrelation_time(draws: NDArray[np.float64]) -> NDArray[np.float64]:
    """Integrated autocorrelation time in steps, the larger of two estimates.

    One averages the walkers' own autocorrelations; the other takes the series of
    ensemble means, whose variance also feels that walkers move together. On a
    ridge either can be too small, so the larger is believed.

    Parameters
    ----------
    draws
        ``(ensembles, walkers, steps, d)``

    Returns
    -------
    ndarray
        ``(d,)``, the largest over ensembles; infinite where a walker never moved.
    """
    ensembles, walkers, _, d = draws.shape
    times = np.full((ensembles, d), np.inf)
    for k in range(ensembles):
        for j in range(d):
            x = draws[k, :, :, j]
            variance = x.var()
            mean = x.mean(axis=0)
            # the variance of equal numbers may come out as 1e-38, their range is zero
            moving = np.ptp(x, axis=1) > 0.0
            if not moving.all() or not np.isfinite(variance) or np.ptp(mean) == 0.0:
                continue
            own = float(integrated_time(x.T, tol=0, quiet=True, has_walkers=True)[0])
            # var(grand mean) = tau_mean var(mean) / n; in steps of a lone walker that
            # is tau_mean * walkers * var(mean) / var(x)
            together = float(integrated_time(mean, tol=0, quiet=True, has_walkers=False)[0])
            together *= walkers * mean.var() / variance
            times[k, j] = max(own, together)
    return np.asarray(times.max(axis=0))


def autocorrelation(series: NDArray[np.float64]) -> NDArray[np.float64]:
    """Autocorrelation of ``(walkers, steps)`` averaged over walkers that move, ``(steps,)``."""
    moving = series[np.ptp(series, axis=1) > 0.0]
    if moving.shape[0] == 0:
        return np.ones(series.shape[1])
    return np.asarray(np.mean([function_1d(walker) for walker in moving], axis=0))


def effective_sample_size(draws: NDArray[np.float64]) -> NDArray[np.float64]:
    """Count the independent draws that the sample is worth, ``(d,)``.

    ``ensembles * walkers * steps / tau`` with :func:`autocorrelation_time`.
    """
    ensembles, walkers, steps, _ = draws.shape
    return np.asarray(ensembles * walkers * steps / autocorrelation_time(draws))
