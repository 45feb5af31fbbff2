"""Convergence of several independent ensembles; draws are ``(ensembles, walkers, steps, d)``."""

from __future__ import annotations

import numpy as np
from scipy import fft

from bayesfric.recordings.arrays import Array

# A run is trusted when all ensembles together are this many autocorrelation times long, which
# suffices to estimate that time (Goodman and Weare 2010, emcee's rule).
LONG_ENOUGH = 50.0


def nested_rhat(draws: Array) -> Array:
    """Nested R-hat ``(d,)`` of ensembles as superchains.

    Walkers of an ensemble are not independent chains, so plain R-hat is meaningless; ensembles must
    start further apart than their walkers. Margossian et al., Bayesian Analysis (2024).
    """
    from arviz_stats.base import array_stats  # slow import

    ensembles, walkers, steps, d = draws.shape
    with np.errstate(divide="ignore", invalid="ignore"):
        rhat = array_stats.rhat_nested(
            draws.reshape(-1, steps, d),
            superchain_ids=np.repeat(np.arange(ensembles), walkers),
            method="identity",
            chain_axis=0,
            draw_axis=1,
        )
    return np.where(np.ptp(draws, axis=(0, 1, 2)) == 0.0, 1.0, rhat)


def autocorrelation_time(draws: Array) -> Array:
    """Estimate the integrated autocorrelation time ``(d,)`` over all ensembles.

    The larger of two estimates: from the walkers' mean autocorrelation around the common mean, and
    from the ensemble means, whose variance includes that walkers move together. On a ridge either
    can be too small. Both are summed over Sokal's window. A maximum over ensembles would be biased
    by its noise.
    """
    _, walkers, steps, d = draws.shape
    times = np.full(d, np.inf)
    # contiguous series of each parameter
    draws = np.ascontiguousarray(np.moveaxis(draws, 3, 0))
    for j in range(d):
        x = draws[j] - draws[j].mean()
        if not np.isfinite(x).all() or (np.ptp(x, axis=2) == 0.0).any():
            continue
        variance = np.mean(x**2)
        subset = x[:, :: -(-walkers // 64)]  # for speed
        tau_walkers = _integrated(_autocovariance(subset.reshape(-1, steps)) / np.mean(subset**2))
        means = x.mean(axis=1)
        means -= means.mean(axis=1, keepdims=True)
        # var(grand mean) = tau_mean var(mean) / n; in steps of a single walker that is tau_mean *
        # walkers * var(mean) / var(x)
        spread = np.mean(means**2)
        tau_means = _integrated(_autocovariance(means) / spread)
        times[j] = max(tau_walkers, tau_means * walkers * spread / variance)
    return times


def autocorrelation(series: Array) -> Array:
    """Autocorrelation of a series ``(walkers, steps)`` around its common mean."""
    x = series - series.mean()
    variance = np.mean(x**2)
    if not variance > 0.0 or np.ptp(series) == 0.0:
        return np.ones(series.shape[1])
    return np.asarray(_autocovariance(x) / variance)


def _autocovariance(x: Array) -> Array:
    """Mean over rows of ``(rows, n)`` of the autocovariance around zero, ``(n,)``."""
    n = x.shape[1]
    spectrum = fft.rfft(x, fft.next_fast_len(2 * n, real=True), axis=1)
    power = np.mean(np.abs(spectrum) ** 2, axis=0)
    return np.asarray(fft.irfft(power, fft.next_fast_len(2 * n, real=True))[:n] / n)


def _integrated(correlation: Array) -> float:
    """Sum an autocorrelation over Sokal's window, the first lag above five times the sum."""
    sums = 2.0 * np.cumsum(correlation) - 1.0
    beyond = np.arange(sums.size) >= 5.0 * sums
    return float(max(sums[int(np.argmax(beyond))] if beyond.any() else sums[-1], 1.0))


def effective_sample_size(draws: Array, tau: Array) -> Array:
    """Return the effective sample size ``(d,)``."""
    ensembles, walkers, steps, _ = draws.shape
    return np.asarray(ensembles * walkers * steps / tau)
