"""What residuals of the motor torque are: white, autoregressive, or white with outliers.

Each model has scales, ``(n, R, Q)``, ``sigma`` first, as
:class:`bayesfric.inference.likelihood.likelihood.Likelihood` hands them over.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import stats
from scipy.linalg import toeplitz
from scipy.special import gammaln, polygamma

from bayesfric.inference.likelihood.autoregression import (
    ages,
    autocovariance,
    predictors,
    simulated,
    variances,
    whitened,
)
from bayesfric.inference.moments.residual_moments import Moments, PlainMoments, ResidualMoments

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

_LOG_2PI = math.log(2.0 * math.pi)


class ResidualNoise(Protocol):
    """A noise model of torque residuals."""

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of its scales."""
        ...

    @property
    def order(self) -> int:
        """Predecessors of a residual that tell something of it."""
        ...

    @property
    def description(self) -> str:
        """In words, for the record."""
        ...

    @property
    def gaussian(self) -> bool:
        """Whether lagged products of residuals are all that the density asks for."""
        ...

    def log_density_of(
        self, plain: PlainMoments, moments: ResidualMoments, values: Array, scales: Array
    ) -> Array:
        """Log density of all residuals of parameter vectors, ``(n,)``.

        Parameters
        ----------
        plain, moments
            What goes through every sample, and what computes the same moments faster.
        values
            ``(n, n_parameters)``
        scales
            ``(n, R, Q)``
        """
        ...

    def standard(self, residual: Array, follows: Flags, scales: Array) -> tuple[Array, Array]:
        """Turn residuals ``(..., M)`` into uncorrelated ones of variance one.

        ``scales`` ``(Q,)``. Gives them and the ``(M,)`` sds they were divided by. It is
        linear in the residuals.
        """
        ...

    def log_terms(self, standard: Array, sds: Array, scales: Array) -> Array:
        """Log densities of residuals, from what :meth:`standard` gives, ``(..., M)``."""
        ...

    def sd(self, scales: Array) -> float:
        """Spread of one residual, ``scales`` ``(Q,)``; infinite where it has none."""
        ...

    def marginal(self, scales: Array) -> Any:
        """SciPy's distribution of one residual by itself, of shape ``(n, 1)``.

        ``scales`` ``(n, Q)``.
        """
        ...

    def draw(self, follows: Flags, scales: Array, rng: np.random.Generator) -> Array:
        """Draw residuals, one series for each row of ``scales`` ``(n, Q)``, ``(n, M)``."""
        ...

    def information(self, scales: Array, outputs: int) -> Array:
        """Fisher information of ``scales`` ``(Q,)`` from so many outputs, ``(Q, Q)``."""
        ...

    def starts(self, sigma: float) -> Array:
        """Scales to start a search from where residuals are ``sigma`` large, ``(k, Q)``."""
        ...


@dataclass(frozen=True)
class Autoregressive:
    """Gaussian noise in which a residual remembers ``order`` before it; white for none.

    ``sigma`` is the sd of the innovations, what the memory does not foretell;
    ``pacf_1, pacf_2, ..`` are partial autocorrelations.
    """

    order: int = 0
    gaussian: ClassVar[bool] = True

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of the scales."""
        return ("sigma", *(f"pacf_{k}" for k in range(1, self.order + 1)))

    @property
    def description(self) -> str:
        """In words, for the record."""
        return f"AR({self.order})" if self.order else "white"

    def log_density_of(
        self, plain: PlainMoments, moments: ResidualMoments, values: Array, scales: Array
    ) -> Array:
        """See :class:`ResidualNoise`."""
        return self.log_density(moments.at(values), plain.counts, plain.head_counts, scales)

    def log_density(
        self,
        moments: Moments,
        counts: NDArray[np.int64],
        head_counts: NDArray[np.int64],
        scales: Array,
    ) -> Array:
        """Exact log density of all residuals from their lagged products.

        Parameters
        ----------
        moments
            Of ``n`` vectors and R recordings.
        counts, head_counts
            As :class:`bayesfric.inference.moments.residual_moments.ResidualMoments` has them.
        scales
            ``(n, R, Q)``.

        Returns
        -------
        ndarray
            ``(n,)``
        """
        p = self.order
        sigma = scales[..., 0]
        if p == 0:
            squares = moments.lagged[..., 0, 0]
            total = squares / sigma**2 + counts * (2.0 * np.log(sigma) + _LOG_2PI)
            return np.asarray(-0.5 * total.sum(axis=1))
        return _log_density(
            moments.lagged, moments.heads, counts, head_counts, np.ascontiguousarray(scales)
        )

    def standard(self, residual: Array, follows: Flags, scales: Array) -> tuple[Array, Array]:
        """See :class:`ResidualNoise`."""
        z = whitened(residual, scales[1:], follows) / scales[0]
        left = variances(scales[None, 1:])[0]
        return z, scales[0] * np.sqrt(left[ages(follows, self.order)])

    def log_terms(self, standard: Array, sds: Array, scales: Array) -> Array:  # noqa: ARG002
        """See :class:`ResidualNoise`."""
        return np.asarray(-0.5 * standard**2 - np.log(sds) - 0.5 * _LOG_2PI)

    def sd(self, scales: Array) -> float:
        """See :class:`ResidualNoise`."""
        return float(scales[0] * math.sqrt(variances(scales[None, 1:])[0, 0]))

    def marginal(self, scales: Array) -> Any:
        """See :class:`ResidualNoise`."""
        return stats.norm(scale=scales[:, :1] * np.sqrt(variances(scales[:, 1:])[:, :1]))

    def draw(self, follows: Flags, scales: Array, rng: np.random.Generator) -> Array:
        """See :class:`ResidualNoise`."""
        if not self.order:
            return np.asarray(scales[:, :1] * rng.standard_normal((len(scales), follows.size + 1)))
        return np.concatenate([s[0] * simulated(s[1:], follows, 1, rng) for s in scales])

    def information(self, scales: Array, outputs: int) -> Array:
        """See :class:`ResidualNoise`; of partial autocorrelations for many outputs.

        That of the coefficients is their covariance over the innovations' variance (Box and
        Jenkins, section 7.2).
        """
        out = np.zeros((scales.size, scales.size))
        out[0, 0] = 2.0 / scales[0] ** 2
        if self.order:
            partial = scales[None, 1:]
            step = 1e-6 * np.eye(self.order)
            up, down = predictors(partial + step)[-1], predictors(partial - step)[-1]
            slope = ((up - down) / 2e-6).T
            out[1:, 1:] = slope.T @ toeplitz(autocovariance(partial[0])[:-1]) @ slope
        return np.asarray(outputs * out)

    def starts(self, sigma: float) -> Array:
        """See :class:`ResidualNoise`."""
        if not self.order:
            return np.array([[sigma]])
        first = np.array([0.0, 0.5, 0.9])
        out = np.zeros((first.size, 1 + self.order))
        out[:, 0] = sigma * np.sqrt(1.0 - first**2)
        out[:, 1] = first
        return out


@dataclass(frozen=True)
class StudentT:
    """Uncorrelated noise with outliers: Student's t with ``dof`` degrees of freedom.

    ``sigma`` is its scale, the sd of the normal it comes close to for many degrees.
    """

    quantities: tuple[str, ...] = ("sigma", "dof")
    order: int = 0
    gaussian: ClassVar[bool] = False

    @property
    def description(self) -> str:
        """In words, for the record."""
        return "Student-t"

    def log_density_of(
        self,
        plain: PlainMoments,
        moments: ResidualMoments,  # noqa: ARG002
        values: Array,
        scales: Array,
    ) -> Array:
        """See :class:`ResidualNoise`; outliers have no moments to sum."""
        return self.log_density(plain.student_terms(values, scales), plain.counts, scales)

    def log_density(self, terms: Array, sizes: NDArray[np.int64], scales: Array) -> Array:
        """Log density of all residuals, ``(n,)``.

        Parameters
        ----------
        terms
            ``(n, R)`` sums of ``log(1 + r²/(dof sigma²))``.
        sizes
            ``(R,)`` numbers of residuals.
        scales
            ``(n, R, 2)``
        """
        sigma, dof = scales[..., 0], scales[..., 1]
        constant = gammaln((dof + 1.0) / 2.0) - gammaln(dof / 2.0) - 0.5 * np.log(dof * math.pi)
        total = sizes * (constant - np.log(sigma)) - (dof + 1.0) / 2.0 * terms
        return np.asarray(total.sum(axis=1))

    def standard(self, residual: Array, follows: Flags, scales: Array) -> tuple[Array, Array]:
        """See :class:`ResidualNoise`; of scale, not variance, one."""
        return residual / scales[0], np.full(follows.size + 1, scales[0])

    def log_terms(self, standard: Array, sds: Array, scales: Array) -> Array:
        """See :class:`ResidualNoise`."""
        dof = scales[1]
        constant = gammaln((dof + 1.0) / 2.0) - gammaln(dof / 2.0) - 0.5 * math.log(dof * math.pi)
        return np.asarray(constant - np.log(sds) - (dof + 1.0) / 2.0 * np.log1p(standard**2 / dof))

    def sd(self, scales: Array) -> float:
        """See :class:`ResidualNoise`."""
        sigma, dof = scales
        return float(sigma * math.sqrt(dof / (dof - 2.0))) if dof > 2.0 else math.inf

    def marginal(self, scales: Array) -> Any:
        """See :class:`ResidualNoise`."""
        return stats.t(scales[:, 1:2], scale=scales[:, :1])

    def draw(self, follows: Flags, scales: Array, rng: np.random.Generator) -> Array:
        """See :class:`ResidualNoise`."""
        n = len(scales)
        return np.asarray(
            scales[:, :1] * rng.standard_t(scales[:, 1:2], size=(n, follows.size + 1))
        )

    def information(self, scales: Array, outputs: int) -> Array:
        """See :class:`ResidualNoise` (Lange, Little and Taylor, JASA 84, 1989, appendix B)."""
        sigma, dof = scales
        scale = 2.0 * dof / ((dof + 3.0) * sigma**2)
        both = -2.0 / (sigma * (dof + 1.0) * (dof + 3.0))
        degrees = polygamma(1, dof / 2.0) - polygamma(1, (dof + 1.0) / 2.0)
        degrees = 0.25 * (degrees - 2.0 * (dof + 5.0) / (dof * (dof + 1.0) * (dof + 3.0)))
        return outputs * np.array([[scale, both], [both, float(degrees)]])

    def starts(self, sigma: float) -> Array:
        """See :class:`ResidualNoise`."""
        return np.array([[sigma, 10.0], [0.5 * sigma, 3.0]])


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
    """Exact density of autoregressive residuals, run by run: heads first, then the rest."""
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
