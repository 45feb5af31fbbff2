"""White and autoregressive noise of torque residuals.

What a model leaves of a torque is seldom white: cogging, flexible parts and filters correlate
neighbouring samples. Taken for white, such residuals make intervals too narrow. An autoregressive
series of low order accounts for that, with an exact likelihood.
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
# Largest partial autocorrelation that the package takes for noise by itself. What remembers more
# in a band that the motion fills is no noise but something the model lacks: a memory beyond
# would take all that is slow for noise, the motion's own effects among it.
MAX_PARTIAL = 0.95
# Longest memory that is tried where none is told.
MAX_ORDER = 4
SIGMA = Scale("sigma", r"\sigma", "noise of the filtered torque", lambda s: up_to(s.torque))
_INNOVATION = replace(
    SIGMA, meaning="sd of the noise's innovations, what its memory does not foretell"
)


def _pacf(lag: int) -> Scale:
    """Describe the partial autocorrelation at a lag; its default prior is uniform within 0.95."""
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
    """Gaussian noise in which each residual is correlated with those before it.

    ``r_t = a_1 r_(t-1) + .. + a_p r_(t-p) + e_t`` with innovations ``e_t`` of sd ``sigma``,
    stationary from each run's beginning. A run is a stretch of outputs that follow each other one
    period apart; runs are independent of each other. The scales are ``sigma`` and the partial
    autocorrelations ``pacf_1, .., pacf_p``, from which
    :mod:`bayesfric.inference.likelihood.autoregression` makes the coefficients ``a``. They come as
    ``(n, R, Q)``, vectors, recordings and scales, ``Q = p + 1``.
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
        """Exact log density of all residuals, from the sums of their lagged products.

        The density is the product of each output's normal one given its predecessors: mean by the
        best predictor from as many as there are, up to ``p``, and variance ``sigma^2 / prod(1 -
        pacf_k^2)`` over the lags ``k`` that are not used yet.

        Shapes: ``counts`` (R,), ``head_counts`` (R, p), ``scales`` (n, R, Q), returns (n,).
        """
        if not self.order:
            sigma, squares = scales[..., 0], moments.lagged[..., 0, 0]
            with np.errstate(over="ignore"):  # so far out the density is zero
                total = squares / sigma**2 + counts * (2.0 * np.log(sigma) + _LOG_2PI)
            return np.asarray(-0.5 * total.sum(axis=1))
        return _log_density(
            moments.lagged, moments.heads, counts, head_counts, np.ascontiguousarray(scales)
        )

    def standard(self, residual: Array, follows: Flags, scales: Array) -> tuple[Array, Array]:
        """Turn residuals into uncorrelated ones of variance one.

        Shapes: ``residual`` (..., M), ``follows`` (M - 1,), ``scales`` (Q,), returns (..., M).
        """
        z = ar.whitened(residual, scales[1:], follows) / scales[0]
        left = ar.variances(scales[None, 1:])[0]
        return z, scales[0] * np.sqrt(left[ar.ages(follows, self.order)])

    def log_terms(self, standard: Array, sds: Array) -> Array:
        """Log densities ``(..., M)`` of residuals given those before, from :meth:`standard`."""
        return np.asarray(-0.5 * standard**2 - np.log(sds) - 0.5 * _LOG_2PI)

    def sd(self, scales: Array) -> float:
        """Marginal standard deviation of one residual, N m or N; ``scales`` ``(Q,)``."""
        return float(scales[0] * math.sqrt(ar.variances(scales[None, 1:])[0, 0]))

    def marginal(self, scales: Array) -> Any:
        """SciPy's distribution of one residual, of shape ``(n, 1)`` for scales ``(n, Q)``."""
        return stats.norm(scale=scales[:, :1] * np.sqrt(ar.variances(scales[:, 1:])[:, :1]))

    def draw(self, follows: Flags, scales: Array, rng: np.random.Generator) -> Array:
        """Draw residuals, each series stationary from the beginning of every run.

        Shapes: ``follows`` (M - 1,), ``scales`` (n, Q), returns (n, M).
        """
        if not self.order:
            return np.asarray(scales[:, :1] * rng.standard_normal((len(scales), follows.size + 1)))
        return np.concatenate([s[0] * ar.simulated(s[1:], follows, 1, rng) for s in scales])

    def information(self, scales: Array, outputs: int) -> Array:
        """Fisher information of the scales from so many outputs.

        ``2/sigma^2`` an output for ``sigma``; for the coefficients of a long series their
        autocovariance matrix over the innovations' variance (Box and Jenkins, "Time Series
        Analysis", section 7.2), carried over to partial autocorrelations by the chain rule. Both
        are independent.

        Shapes: ``scales`` (Q,), returns (Q, Q).
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
        """Scales to start a search from.

        Shapes: returns (k, Q).
        """
        if not self.order:
            return np.array([[sigma]])
        first = np.array([0.0, 0.5, 0.9])
        rest = np.zeros((first.size, self.order - 1))
        return np.column_stack([sigma * np.sqrt(1.0 - first**2), first, rest])


@njit(cache=True)
def _form(coefficients: Array, k: int, products: Array, reverse: bool) -> float:
    """Sum of squares of what a predictor from ``k`` predecessors leaves."""
    total = 0.0
    for i in range(k + 1):
        for j in range(k + 1):
            # the newest residual has the coefficient one
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
    """Exact density of autoregressive residuals, run by run: heads first, then the rest.

    The coefficients of ever longer predictors come from the Durbin-Levinson recursion on the way.
    """
    n, recordings, p = scales.shape[0], scales.shape[1], scales.shape[2] - 1
    out = np.zeros(n)
    coefficients, before = np.zeros(p), np.zeros(p)
    for v in range(n):
        for r in range(recordings):
            sigma, partial = scales[v, r, 0], scales[v, r, 1:]
            squares, logs, outputs = 0.0, 0.0, float(counts[r])
            # variance that no predecessor leaves, in the innovations'
            left = 1.0
            for k in range(p):
                left /= 1.0 - partial[k] * partial[k]
            for k in range(p):
                for length in range(k + 1, p + 1):
                    # the heads' residuals are in time
                    head = heads[length - 1][v, r]
                    squares += _form(coefficients, k, head, True) / left
                    logs += head_counts[r, length - 1] * math.log(left)
                    outputs += head_counts[r, length - 1]
                # Durbin and Levinson: one predecessor more
                for i in range(k):
                    before[i] = coefficients[i]
                for i in range(k):
                    coefficients[i] = before[i] - partial[k] * before[k - 1 - i]
                coefficients[k] = partial[k]
                left *= 1.0 - partial[k] * partial[k]
            squares += _form(coefficients, p, lagged[v, r], False)
            out[v] -= 0.5 * (
                squares / sigma**2 + logs + outputs * (2.0 * math.log(sigma) + _LOG_2PI)
            )
    return out


SCALES = (SIGMA, *(_pacf(lag) for lag in range(1, 10)))
