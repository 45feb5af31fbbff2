"""White and autoregressive noise of torque residuals, with an exact likelihood.

Cogging, flexible parts and filters correlate residuals; assumed white, they make intervals too
narrow.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import stats
from scipy.linalg import toeplitz

from bayesfric.inference.likelihood import autoregression as ar
from bayesfric.inference.moments.residual_moments import Moments
from bayesfric.inference.noise.scale import NoiseDescription, Scale, up_to
from bayesfric.recordings.arrays import Array, Flags

_LOG_2PI = math.log(2.0 * math.pi)
# Largest partial autocorrelation by default: above it, slow effects of the motion itself would
# count as noise.
MAX_PARTIAL = 0.95
# Largest order that is tried by default.
MAX_ORDER = 4
SIGMA = Scale("sigma", r"\sigma", "noise of the filtered torque", lambda s: up_to(s.torque))
_INNOVATION = replace(SIGMA, meaning="sd of the noise's innovations")


def _pacf(lag: int) -> Scale:
    """Describe the partial autocorrelation at a lag."""
    return Scale(
        f"pacf_{lag}",
        rf"\phi_{{{lag}{lag}}}",
        f"partial autocorrelation of the noise at lag {lag}",
        lambda _: [-MAX_PARTIAL, MAX_PARTIAL],
        lower=-1.0,
        upper=1.0,
        unit="",
        shared=True,
        chosen=True,
    )


class Autoregressive(NoiseDescription):
    """Autoregressive Gaussian noise.

    ``r_t = a_1 r_(t-1) + .. + a_p r_(t-p) + e_t`` with innovations ``e_t`` of standard deviation
    ``sigma``, stationary from each run's beginning; runs are independent. Scales ``(n, R, Q)``, ``Q
    = p + 1``, are ``sigma`` and the partial autocorrelations ``pacf_1, .., pacf_p``, see
    :mod:`bayesfric.inference.likelihood.autoregression`.
    """

    def __init__(self, order: int = 0) -> None:
        self.order = order
        scales = (_INNOVATION if order else SIGMA, *(_pacf(k + 1) for k in range(order)))
        words = f"AR({order})" if order else "white"
        super().__init__(scales, words, accounts_for_correlation=order > 0)

    def log_density(
        self,
        moments: Moments,
        counts: NDArray[np.int64],
        head_counts: NDArray[np.int64],
        scales: Array,
    ) -> Array:
        """Exact log density ``(n,)`` from sums of lagged products.

        The product of each output's normal density given up to ``p`` predecessors, of variance
        ``sigma^2 / prod(1 - pacf_k^2)`` over the lags ``k`` that are not used yet.
        """
        if not self.order:
            sigma, squares = scales[..., 0], moments.lagged[..., 0, 0]
            with np.errstate(over="ignore"):  # the density is zero there
                total = squares / sigma**2 + counts * (2.0 * np.log(sigma) + _LOG_2PI)
            return np.asarray(-0.5 * total.sum(axis=1))
        return _log_density(
            moments.lagged, moments.heads, counts, head_counts, np.ascontiguousarray(scales)
        )

    def standard(self, residual: Array, follows: Flags, scales: Array) -> tuple[Array, Array]:
        """Whiten residuals ``(..., M)`` and return their prediction standard deviations, too."""
        z = ar.whitened(residual, scales[1:], follows) / scales[0]
        variances = ar.variances(scales[None, 1:])[0]
        return z, scales[0] * np.sqrt(variances[ar.ages(follows, self.order)])

    def log_terms(self, standard: Array, sds: Array) -> Array:
        """Log densities ``(..., M)`` given predecessors, of the output of :meth:`standard`."""
        return np.asarray(-0.5 * standard**2 - np.log(sds) - 0.5 * _LOG_2PI)

    def sd(self, scales: Array) -> float:
        """Marginal standard deviation of a residual, N m or N; ``scales`` ``(Q,)``."""
        return float(scales[0] * math.sqrt(ar.variances(scales[None, 1:])[0, 0]))

    def marginal(self, scales: Array) -> Any:
        """SciPy's distribution of a residual, ``(n, 1)`` for scales ``(n, Q)``."""
        return stats.norm(scale=scales[:, :1] * np.sqrt(ar.variances(scales[:, 1:])[:, :1]))

    def draw(self, follows: Flags, scales: Array, rng: np.random.Generator) -> Array:
        """Draw residuals ``(n, M)`` for scales ``(n, Q)``."""
        if not self.order:
            return np.asarray(scales[:, :1] * rng.standard_normal((len(scales), follows.size + 1)))
        return np.concatenate([s[0] * ar.simulated(s[1:], follows, 1, rng) for s in scales])

    def information(self, scales: Array, outputs: int) -> Array:
        """Fisher information ``(Q, Q)`` of scales ``(Q,)`` from a number of outputs.

        ``2/sigma^2`` an output for ``sigma``; for the coefficients of a long series their
        autocovariance matrix over the innovations' variance (Box and Jenkins, "Time Series
        Analysis", section 7.2), converted to partial autocorrelations by the chain rule.
        """
        out = np.zeros((scales.size, scales.size))
        out[0, 0] = 2.0 / scales[0] ** 2
        if self.order:
            partial = scales[None, 1:]
            step = 1e-6 * np.eye(self.order)
            up, down = ar.predictors(partial + step)[-1], ar.predictors(partial - step)[-1]
            slope = ((up - down) / 2e-6).T
            out[1:, 1:] = slope.T @ toeplitz(ar.autocovariance(partial[0])[:-1]) @ slope
        return np.asarray(outputs * out)

    def starts(self, sigma: float) -> Array:
        """Scales ``(k, Q)`` to start a search from."""
        if not self.order:
            return np.array([[sigma]])
        first = np.array([0.0, 0.5, 0.9])
        rest = np.zeros((first.size, self.order - 1))
        return np.column_stack([sigma * np.sqrt(1.0 - first**2), first, rest])


@njit(cache=True)
def _form(coefficients: Array, k: int, products: Array, reverse: bool) -> float:
    """Sum of squared errors of a predictor from ``k`` predecessors."""
    total = 0.0
    for i in range(k + 1):
        for j in range(k + 1):
            # the newest residual has coefficient one
            a = 1.0 if i == 0 else -coefficients[i - 1]
            b = 1.0 if j == 0 else -coefficients[j - 1]
            total += a * b * (products[k - i, k - j] if reverse else products[i, j])
    return total


@njit(cache=True)
def _log_density(
    lagged: Array,
    heads: tuple[Array, ...],
    counts: NDArray[np.int64],
    head_counts: NDArray[np.int64],
    scales: Array,
) -> Array:
    """Exact density, the first outputs of each run first, by the Durbin-Levinson recursion."""
    n, recordings, p = scales.shape[0], scales.shape[1], scales.shape[2] - 1
    out = np.zeros(n)
    coefficients, previous = np.zeros(p), np.zeros(p)
    for v in range(n):
        for r in range(recordings):
            sigma, partial = scales[v, r, 0], scales[v, r, 1:]
            squares, logs, outputs = 0.0, 0.0, float(counts[r])
            # variance without predecessors over the innovations'
            remaining = 1.0
            for k in range(p):
                remaining /= 1.0 - partial[k] * partial[k]
            for k in range(p):
                for length in range(k + 1, p + 1):
                    # the heads' residuals are in time
                    head = heads[length - 1][v, r]
                    squares += _form(coefficients, k, head, True) / remaining
                    logs += head_counts[r, length - 1] * math.log(remaining)
                    outputs += head_counts[r, length - 1]
                # Durbin and Levinson: one predecessor more
                for i in range(k):
                    previous[i] = coefficients[i]
                for i in range(k):
                    coefficients[i] = previous[i] - partial[k] * previous[k - 1 - i]
                coefficients[k] = partial[k]
                remaining *= 1.0 - partial[k] * partial[k]
            squares += _form(coefficients, p, lagged[v, r], False)
            out[v] -= 0.5 * (
                squares / sigma**2 + logs + outputs * (2.0 * math.log(sigma) + _LOG_2PI)
            )
    return out


SCALES = (SIGMA, *(_pacf(lag) for lag in range(1, 10)))
