"""Stationary autoregressive series: coefficients, exact density, whitening, simulation.

A series of order p is described by its partial autocorrelations, each between -1 and 1: every
such vector is stationary and every stationary series has one [1]_. The Durbin-Levinson recursion
[2]_ turns the first k of them into the best predictor from k predecessors, which also gives the
exact density of the beginning of a run.

References
----------
.. [1] O. Barndorff-Nielsen, G. Schou, "On the parametrization of autoregressive models by partial
   autocorrelations", Journal of Multivariate Analysis 3 (1973) 408-419.
.. [2] J. Durbin, "The fitting of time-series models", Review of the International Statistical
   Institute 28 (1960) 233-244.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.signal import lfilter

from bayesfric.recordings.arrays import Array, Flags

# p-value of the Ljung-Box test from which a series is said to pass as white.
PASSES = 0.05


def predictors(partial: Array) -> list[Array]:
    """Coefficients of the best predictors from 0, 1, .., p predecessors.

    With ``a_(k-1)`` the coefficients before and ``r`` the k-th partial autocorrelation,
    ``a_k = [a_(k-1) - r reversed(a_(k-1)), r]``.

    Shapes: ``partial`` (n, p), returns (n, k).
    """
    found = [np.empty((partial.shape[0], 0))]
    for k in range(partial.shape[1]):
        last, r = found[-1], partial[:, k : k + 1]
        found.append(np.concatenate([last - r * last[:, ::-1], r], axis=1))
    return found


def variances(partial: Array) -> Array:
    """Variances of what 0, 1, .., p predecessors leave, in those of the innovations.

    Shapes: ``partial`` (n, p), returns (n, p + 1).
    """
    left = np.cumprod(1.0 / (1.0 - partial[:, ::-1] ** 2), axis=1)[:, ::-1]
    return np.concatenate([left, np.ones((partial.shape[0], 1))], axis=1)


def _one(partial: Array) -> tuple[list[Array], Array]:
    """Predictors of one series ``(p,)``, and the sds of what they leave, over the innovations'."""
    return [found[0] for found in predictors(partial[None])], np.sqrt(variances(partial[None])[0])


def autocovariance(partial: Array) -> Array:
    """Autocovariances at lags 0 to p, in variances of the innovations.

    Partial autocorrelations ``(p,)`` to ``(p + 1,)``.
    """
    known, sds = _one(partial)
    left = sds**2
    found = np.zeros(partial.size + 1)
    found[0] = left[0]
    for k in range(1, partial.size + 1):
        found[k] = known[k - 1] @ found[1:k][::-1] + partial[k - 1] * left[k - 1]
    return found


def whitened(x: Array, partial: Array, follows: Flags) -> Array:
    """Take from every value what its predecessors predict, and make what is left of one variance.

    Shapes: ``x`` (..., M), ``partial`` (p,), ``follows`` (M - 1,), returns (..., M).
    """
    age = ages(follows, partial.size)
    coefficients, sds = _one(partial)
    out = np.array(x, dtype=np.float64)
    for k in range(1, partial.size + 1):
        here = np.flatnonzero(age == k)
        for j in range(k):
            out[..., here] -= coefficients[k][j] * x[..., here - j - 1]
    return np.asarray(out / sds[age])


def runs(follows: Flags) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find the runs of a series.

    Shapes: ``follows`` (M - 1,).
    """
    begins = np.concatenate([[0], np.flatnonzero(~follows) + 1])
    return begins, np.diff(np.append(begins, follows.size + 1))


def ages(follows: Flags, most: int) -> NDArray[np.int64]:
    """Count the predecessors of each value in its run, up to ``most``, ``(M,)``."""
    begins, length = runs(follows)
    age = np.arange(follows.size + 1) - np.repeat(begins, length)
    return np.asarray(np.minimum(age, most))


def simulated(partial: Array, follows: Flags, n: int, rng: np.random.Generator) -> Array:
    """Draw stationary series with innovations of variance one.

    Shapes: ``partial`` (p,), ``follows`` (M - 1,), returns (n, M).
    """
    p = partial.size
    noise = rng.standard_normal((n, follows.size + 1))
    if p == 0:
        return noise
    age = ages(follows, p)
    coefficients, sds = _one(partial)
    out = noise * sds[age]
    for a, length in np.transpose(runs(follows)).tolist():
        b = a + length
        for m in range(a + 1, min(a + p, b)):
            out[:, m] += out[:, a:m][:, ::-1] @ coefficients[m - a]
        if b - a > p:
            past = out[:, a : a + p][:, ::-1]
            whole = coefficients[p]
            # lfilter's state after the p values that are there already
            state = np.stack(
                [sum(whole[j] * past[:, j - i] for j in range(i, p)) for i in range(p)], axis=1
            )
            out[:, a + p : b], _ = lfilter(
                [1.0], np.concatenate([[1.0], -whole]), noise[:, a + p : b], axis=1, zi=state
            )
    return np.asarray(out)


def burg(series: Sequence[Array], follows: Sequence[Flags], order: int) -> Array:
    """Estimate partial autocorrelations by Burg's method, all runs together.

    The k-th is ``2 sum(f b) / sum(f^2 + b^2)``, of the errors ``f`` and ``b`` of predicting
    forwards and backwards from ``k - 1`` values between (J. P. Burg, "Maximum entropy spectral
    analysis", thesis, Stanford University, 1975).

    Shapes: ``series`` (M,), ``follows`` (M - 1,), returns (order,).
    """
    runs = [
        part
        for x, f in zip(series, follows, strict=True)
        for part in np.split(x, np.flatnonzero(~f) + 1)
    ]
    forward, backward = [r[1:] for r in runs], [r[:-1] for r in runs]
    found = np.zeros(order)
    for k in range(order):
        above = sum(2.0 * float(f @ b) for f, b in zip(forward, backward, strict=True))
        below = sum(float(f @ f + b @ b) for f, b in zip(forward, backward, strict=True))
        r = above / below if below > 0.0 else 0.0
        found[k] = np.clip(r, -0.999999, 0.999999)
        pairs = [(f - r * b, b - r * f) for f, b in zip(forward, backward, strict=True)]
        forward, backward = [f[1:] for f, _ in pairs], [b[:-1] for _, b in pairs]
    return found


def ljung_box(
    series: Sequence[Array], follows: Sequence[Flags], lags: int, fitted: int = 0
) -> float:
    r"""Test that values of all runs together are uncorrelated.

    The statistic is :math:`n(n+2) \sum_k \rho_k^2 / m_k` over lags, with :math:`m_k` pairs at each;
    chi-squared for white series [1]_.

    References
    ----------
    .. [1] G. M. Ljung, G. E. P. Box, "On a measure of lack of fit in time series models",
       Biometrika 65 (1978) 297-303.
    """
    power = sum(float(x @ x) for x in series)
    statistic = 0.0
    n = sum(x.size for x in series)
    for lag in range(1, lags + 1):
        product, pairs = 0.0, 0
        for x, f in zip(series, follows, strict=True):
            joined = ages(f, lag)[lag:] == lag
            product += float(x[lag:][joined] @ x[:-lag][joined])
            pairs += int(joined.sum())
        if pairs:
            # the variance of a correlation from this many of the n products
            statistic += (product / power) ** 2 * n * (n + 2.0) / pairs
    return float(stats.chi2.sf(statistic, max(lags - fitted, 1)))
