"""Whether several independent ensembles agree, and how many independent draws they are worth.

When may sampling end, and when is it of no use to go on? Arrays of draws are
``(ensembles, walkers, steps, d)``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from bayesfric.recordings.arrays import Array

# A run is trusted when its ensembles together are this many autocorrelation times long: then they
# tell that time (Goodman and Weare 2010, emcee's rule); that each has forgotten its start, R-hat.
LONG_ENOUGH = 50.0
# Share of all walkers that may be left out where they never moved: if each stood for its share
# of the posterior, a 90 % interval of the others still held 89 %. And of an ensemble, so that
# each is still there to be compared.
_STUCK, _STUCK_IN_ONE = 0.01, 0.05
# Looks and share of the steps allowed at least, and how many times these must be too few at all
# late looks, before a run is given up: a prediction from a short run may be wrong by that much.
# A short run is over before that matters.
_LOOKS, _LEAST_SHARE, _LEAST_STEPS, _FAR = 4, 0.1, 500, 2.0
# A run that only forgets where it started falls to half in twice the steps; above that it is slow.
_FALLING = 0.7
# Walkers of an ensemble whose own autocorrelations are looked at: enough for their mean.
_WALKERS = 64


def nested_rhat(draws: Array) -> Array:
    """Nested R-hat: ensembles against each other [1]_.

    Plain R-hat over the walkers of one ensemble says nothing, since they are not
    independent chains. Here an ensemble is a superchain. It means something
    only if the ensembles started further apart than their walkers.

    References
    ----------
    .. [1] C. C. Margossian et al., "Nested R-hat: assessing the convergence of Markov chain Monte
       Carlo when running many short chains", Bayesian Analysis (2024).

    Shapes: ``draws`` (ensembles, walkers, steps, d), returns (d,).
    """
    from arviz_stats.base import array_stats  # takes a while, and few commands need it

    ensembles, walkers, steps, d = draws.shape
    with np.errstate(divide="ignore", invalid="ignore"):
        found = array_stats.rhat_nested(
            draws.reshape(-1, steps, d),
            superchain_ids=np.repeat(np.arange(ensembles), walkers),
            method="identity",
            chain_axis=0,
            draw_axis=1,
        )
    return np.where(np.ptp(draws, axis=(0, 1, 2)) == 0.0, 1.0, found)


def autocorrelation_time(draws: Array) -> Array:
    """Integrated autocorrelation time, over all ensembles.

    The larger of two estimates. One averages the walkers' autocorrelations, taken around the mean
    of all, so that walkers that stay apart from each other show as what they are. The other takes
    the series of ensemble means, whose variance also feels that walkers move together. On a ridge
    either can be too small. Both are summed over Sokal's window, the first lag above five times the
    sum.

    It is over all ensembles, as the largest of some noisy estimates would grow with their
    number; that ensembles agree is for :func:`nested_rhat` to say.

    Shapes: ``draws`` (ensembles, walkers, steps, d), returns (d,).
    """
    _, walkers, steps, d = draws.shape
    times = np.full(d, np.inf)
    # one parameter's series after the other in memory
    draws = np.ascontiguousarray(np.moveaxis(draws, 3, 0))
    for j in range(d):
        x = draws[j] - draws[j].mean()
        if not np.isfinite(x).all() or (np.ptp(x, axis=2) == 0.0).any():
            continue
        variance = np.mean(x**2)
        some = x[:, :: -(-walkers // _WALKERS)]
        own = _integrated(_autocovariance(some.reshape(-1, steps)) / np.mean(some**2))
        means = x.mean(axis=1)
        means -= means.mean(axis=1, keepdims=True)
        # var(grand mean) = tau_mean var(mean) / n; in steps of a lone walker that
        # is tau_mean * walkers * var(mean) / var(x)
        spread = np.mean(means**2)
        together = _integrated(_autocovariance(means) / spread)
        times[j] = max(own, together * walkers * spread / variance)
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
    """Count the independent draws that a sample is worth.

    Shapes: ``draws`` (ensembles, walkers, steps, d), ``tau`` (d,), returns (d,).
    """
    ensembles, walkers, steps, _ = draws.shape
    return np.asarray(ensembles * walkers * steps / tau)


def few(walkers: NDArray[np.bool_]) -> bool:
    """Tell whether flagged walkers ``(ensembles, walkers)`` are too few to change an interval.

    At most one per cent of all, and five of any ensemble.
    """
    return bool(walkers.mean() <= _STUCK and walkers.mean(axis=1).max() <= _STUCK_IN_ONE)


def without_stuck(draws: Array, acceptance: Array) -> Array:
    """Leave out the few walkers that never moved, as many of each ensemble.

    Shapes: ``draws`` (ensembles, walkers, ..), ``acceptance`` (ensembles, walkers).
    """
    moved = acceptance > 0.0
    if moved.all() or not few(~moved):
        return draws
    kept = int(moved.sum(axis=1).min())
    return np.stack([own[np.flatnonzero(m)[:kept]] for own, m in zip(draws, moved, strict=True)])


def steps_needed(
    steps: int, ensembles: int, rhat: Array, max_rhat: float, tau: Array | float = 0.0
) -> Array:
    """Predict after how many steps each parameter would have converged.

    The variance between ensembles falls with the number of steps; an autocorrelation time
    that is not yet seen whole grows with it, so for what mixes slowly this is too few.

    Shapes: ``rhat`` (d,), ``tau`` (d,), returns (d,).
    """
    agree = steps * (rhat**2 - 1.0) / (max_rhat**2 - 1.0)
    return np.maximum(agree, LONG_ENOUGH * tau / ensembles)


def hopeless(seen: Sequence[tuple[int, float]], allowed: int) -> bool:
    """Tell whether a run cannot converge in the steps allowed, and does not come nearer to it."""
    last = seen[-1][0]
    lately = [needed for steps, needed in seen if 2 * steps >= last]
    far = min(lately) > _FAR * allowed and lately[-1] >= _FALLING * lately[0]
    least = max(_LEAST_STEPS, _LEAST_SHARE * allowed)
    return len(seen) >= _LOOKS and last >= least and far
