"""Autocorrelated series with gaps: autoregression, whiteness test and long-run variance.

A series of order p is parametrised by its partial autocorrelations in (-1, 1): each such vector is
stationary, and each stationary series has one (Barndorff-Nielsen and Schou, Journal of Multivariate
Analysis 3 (1973) 408-419). The Durbin-Levinson recursion (Durbin, Review of the International
Statistical Institute 28 (1960) 233-244) gives the best predictor from the first k of them, and so
the exact density of the beginning of a run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numba import njit
from scipy import stats
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from bayesfric.recordings.arrays import Array, Flags, Index
from bayesfric.recordings.signals import Signals

# p-value of the Ljung-Box test from which a series passes as white.
PASSES = 0.05
# Least correlation of neighbouring residuals that counts.
CORRELATED = 0.2


def follows(o: Signals) -> Flags:
    """Flag outputs ``(M - 1,)`` that are followed one period later in the same segment."""
    step = np.diff(o.filter.starts)
    return np.asarray((step == step.min(initial=step[:1].sum())) & (np.diff(o.segment_of) == 0))


def runs(follows: Flags) -> tuple[Index, Index]:
    """Return first index and length of each run of outputs one period apart."""
    begins = np.concatenate([[0], np.flatnonzero(~follows) + 1])
    return begins, np.diff(np.append(begins, follows.size + 1))


def ages(follows: Flags, max_count: int) -> Index:
    """Count the predecessors ``(M,)`` of each value in its run, up to ``max_count``."""
    begins, length = runs(follows)
    age = np.arange(follows.size + 1) - np.repeat(begins, length)
    return np.asarray(np.minimum(age, max_count))


def predictors(partial: Array) -> list[Array]:
    """Return the coefficients ``(n, k)`` of the best predictors from k = 0, 1, .., p predecessors.

    With ``a_(k-1)`` the previous ones and ``r`` the k-th partial autocorrelation ``(n, p)``, ``a_k
    = [a_(k-1) - r reversed(a_(k-1)), r]``.
    """
    coefficients = [np.empty((partial.shape[0], 0))]
    for k in range(partial.shape[1]):
        last, r = coefficients[-1], partial[:, k : k + 1]
        coefficients.append(np.concatenate([last - r * last[:, ::-1], r], axis=1))
    return coefficients


def variances(partial: Array) -> Array:
    """Return prediction error variances ``(n, p + 1)`` from 0 to p predecessors.

    They are over the innovations' variance.
    """
    remaining = np.cumprod(1.0 / (1.0 - partial[:, ::-1] ** 2), axis=1)[:, ::-1]
    return np.concatenate([remaining, np.ones((partial.shape[0], 1))], axis=1)


def _single_series(partial: Array) -> tuple[list[Array], Array]:
    """Return predictors of one series ``(p,)``, and their relative error standard deviations."""
    return [coefficients[0] for coefficients in predictors(partial[None])], np.sqrt(
        variances(partial[None])[0]
    )


def autocovariance(partial: Array) -> Array:
    """Return autocovariances ``(p + 1,)`` over the innovations' variance, from partial ``(p,)``."""
    coefficients, sds = _single_series(partial)
    innovation_variances = sds**2
    covariances = np.zeros(partial.size + 1)
    covariances[0] = innovation_variances[0]
    for k in range(1, partial.size + 1):
        covariances[k] = (
            coefficients[k - 1] @ covariances[1:k][::-1]
            + partial[k - 1] * innovation_variances[k - 1]
        )
    return covariances


def whitened(x: Array, partial: Array, follows: Flags) -> Array:
    """Whiten a series ``(..., M)``; ``follows`` ``(M - 1,)`` flags where runs continue."""
    age = ages(follows, partial.size)
    coefficients, sds = _single_series(partial)
    out = np.array(x, dtype=np.float64)
    for k in range(1, partial.size + 1):
        places = np.flatnonzero(age == k)
        for j in range(k):
            out[..., places] -= coefficients[k][j] * x[..., places - j - 1]
    return np.asarray(out / sds[age])


def across_gaps(partial: Array) -> Callable[[Array, Index], tuple[Array, float]]:
    """Return a function that whitens rows ``(n, m)`` at whole steps ``(n,)``, across gaps.

    It returns the log determinant, too. :func:`whitened` restarts at every gap; slow noise would
    then look like a drift (Jones, Technometrics 22 (1980) 389-395).
    """
    if not partial.size:
        return lambda x, _: (x, 0.0)
    phi = np.ascontiguousarray(predictors(partial[None])[-1][0])
    stationary = toeplitz(autocovariance(partial)[:-1])
    return lambda x, at: _innovations(np.ascontiguousarray(x), at, phi, stationary)


@njit(cache=True, error_model="numpy")
def _innovations(x, at, phi, stationary):  # type: ignore[no-untyped-def]
    """Return innovations ``(n, m)`` over their standard deviations, and their log determinant.

    A Kalman filter of the last p values at whole steps ``at`` ``(n,)``; across gaps it predicts
    only. After more than 300 steps it restarts.
    """
    n, m = x.shape
    p = phi.size
    out = np.empty((n, m))
    state, cov, u = np.empty((p, m)), np.empty((p, p)), np.empty(p)
    logs = 0.0
    for i in range(n):
        gap = at[i] - at[i - 1] if i else 0
        # by loops: assignments of slices take the compiler three seconds
        if gap < 1 or gap > 300:
            for k in range(p):
                for j in range(m):
                    state[k, j] = 0.0
                for j in range(p):
                    cov[k, j] = stationary[k, j]
        else:
            for _ in range(gap):
                for j in range(m):
                    first = 0.0
                    for k in range(p - 1, -1, -1):
                        first += phi[k] * state[k, j]
                        state[k, j] = state[k - 1, j] if k else first
                for k in range(p):
                    u[k] = 0.0
                    for j in range(p):
                        u[k] += cov[k, j] * phi[j]
                variance = 1.0
                for k in range(p):
                    variance += phi[k] * u[k]
                for k in range(p - 1, 0, -1):
                    for j in range(p - 1, 0, -1):
                        cov[k, j] = cov[k - 1, j - 1]
                for k in range(1, p):
                    cov[0, k] = u[k - 1]
                    cov[k, 0] = u[k - 1]
                cov[0, 0] = variance
        variance = cov[0, 0]
        sd = math.sqrt(variance)
        logs += math.log(variance)
        for k in range(p):
            u[k] = cov[k, 0] / variance
        for j in range(m):
            error = x[i, j] - state[0, j]
            out[i, j] = error / sd
            for k in range(p):
                state[k, j] += u[k] * error
        for k in range(p):
            for j in range(p):
                cov[k, j] -= u[k] * u[j] * variance
    return out, logs


def simulated(partial: Array, follows: Flags, n: int, rng: np.random.Generator) -> Array:
    """Draw stationary series ``(n, M)`` with unit innovations."""
    p = partial.size
    noise = rng.standard_normal((n, follows.size + 1))
    if p == 0:
        return noise
    age = ages(follows, p)
    coefficients, sds = _single_series(partial)
    out = noise * sds[age]
    for a, length in np.transpose(runs(follows)).tolist():
        b = a + length
        for m in range(a + 1, min(a + p, b)):
            out[:, m] += out[:, a:m][:, ::-1] @ coefficients[m - a]
        if b - a > p:
            past = out[:, a : a + p][:, ::-1]
            last = coefficients[p]
            # lfilter's state after the first p values
            state = np.stack(
                [sum(last[j] * past[:, j - i] for j in range(i, p)) for i in range(p)], axis=1
            )
            out[:, a + p : b], _ = lfilter(
                [1.0], np.concatenate([[1.0], -last]), noise[:, a + p : b], axis=1, zi=state
            )
    return np.asarray(out)


def burg(series: Sequence[Array], follows: Sequence[Flags], order: int) -> Array:
    """Estimate partial autocorrelations by Burg's method, all runs together.

    The k-th is ``2 sum(f b) / sum(f^2 + b^2)`` of the forward and backward prediction errors (J. P.
    Burg, "Maximum entropy spectral analysis", thesis, Stanford University, 1975).
    """
    parts = [
        part
        for x, f in zip(series, follows, strict=True)
        for part in np.split(x, np.flatnonzero(~f) + 1)
    ]
    forward, backward = [r[1:] for r in parts], [r[:-1] for r in parts]
    partial = np.zeros(order)
    for k in range(order):
        numerator = sum(2.0 * float(f @ b) for f, b in zip(forward, backward, strict=True))
        denominator = sum(float(f @ f + b @ b) for f, b in zip(forward, backward, strict=True))
        r = numerator / denominator if denominator > 0.0 else 0.0
        partial[k] = np.clip(r, -0.999999, 0.999999)
        pairs = [(f - r * b, b - r * f) for f, b in zip(forward, backward, strict=True)]
        forward, backward = [f[1:] for f, _ in pairs], [b[:-1] for _, b in pairs]
    return partial


def ljung_box(
    series: Sequence[Array], follows: Sequence[Flags], lags: int, fitted: int = 0
) -> float:
    """Return the p-value of the Ljung-Box test of whiteness, all runs together.

    The statistic is ``n (n + 2) sum(rho_k^2 / m_k)`` over lags, with ``m_k`` pairs at each (Ljung
    and Box, Biometrika 65 (1978) 297-303).
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
            # variance of a correlation from this many of the n products
            statistic += (product / power) ** 2 * n * (n + 2.0) / pairs
    return float(stats.chi2.sf(statistic, max(lags - fitted, 1)))


def long_run_variance(score: Array, places: Index) -> float:
    """Estimate the variance of the sum of a correlated series ``(n,)`` at places on an even grid.

    Gaps count as zeros (Parzen 1963). Quadratic spectral kernel with the bandwidth of a first-order
    autoregression: Andrews, Econometrica 59, 1991, eqs. 6.2 to 6.4.
    """
    grid = np.zeros(int(places[-1] - places[0]) + 1)
    grid[places - places[0]] = score
    size = 1 << int(2 * grid.size - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(grid, size)) ** 2
    covariance = np.fft.irfft(spectrum, size)[: grid.size]
    if not covariance[0] > 0.0:
        return 0.0
    present = np.zeros(grid.size)
    present[places - places[0]] = 1.0
    pairs = float(present[:-1] @ present[1:])
    # correlation of neighbours, per pair
    rho = covariance[1] / covariance[0] * score.size / max(pairs, 1.0) if grid.size > 1 else 0.0
    rho = float(np.clip(rho, -0.97, 0.97))
    alpha = 4.0 * rho**2 / (1.0 - rho) ** 4
    bandwidth = max(1.3221 * (alpha * score.size) ** 0.2, 1e-9)
    lags = np.arange(1, grid.size)
    x = 6.0 * np.pi * lags / (5.0 * bandwidth)
    near = x < 0.1
    safe = np.where(near, 1.0, x)
    kernel = np.where(near, 1.0 - x**2 / 10.0, 3.0 / safe**2 * (np.sin(safe) / safe - np.cos(safe)))
    total = covariance[0] + 2.0 * float(kernel @ covariance[1:])
    return max(float(total), 0.0)


def lag_one(residual: Array, follows: Flags) -> float:
    """Correlate residuals ``(M,)`` with their successors where these follow one step later."""
    first, second, power = residual[:-1][follows], residual[1:][follows], np.mean(residual**2)
    if first.size < 10 or power == 0.0:
        return float("nan")
    return float(np.mean(first * second) / power)
