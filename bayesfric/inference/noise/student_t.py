"""Noise of torque residuals with outliers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats
from scipy.special import gammaln, polygamma

from bayesfric.inference.moments.residual_moments import PlainMoments, ResidualMoments
from bayesfric.inference.noise.residual_noise import SIGMA, NoiseModel, ResidualNoise
from bayesfric.inference.noise.scale import Scale
from bayesfric.recordings.arrays import Array, Flags

_DOF = Scale(
    "dof",
    r"\nu",
    "degrees of freedom of the noise: fewer, more outliers",
    # Juárez and Steel (J. Bus. Econ. Stat. 28, 2010)
    lambda _: {"distribution": "gamma", "a": 2.0, "scale": 10.0},
    # below one degree of freedom not even the middle of a Student-t is worth an average
    lower=1.0,
    unit="",
    shared=True,
)


@dataclass(frozen=True)
class StudentT(ResidualNoise):
    """Uncorrelated noise with outliers: Student's t with ``dof`` degrees of freedom.

    ``sigma`` is its scale, the sd of the normal it comes close to for many degrees.
    """

    scales = (SIGMA, _DOF)
    description = "Student-t"

    def log_density_of(
        self,
        plain: PlainMoments,
        moments: ResidualMoments,  # noqa: ARG002
        values: Array,
        scales: Array,
    ) -> Array:
        """See :class:`ResidualNoise`; outliers have no moments to sum."""
        sigma, dof = scales[..., 0], scales[..., 1]
        terms = plain.student_terms(values, scales)
        total = plain.counts * (_log_constant(dof) - np.log(sigma)) - (dof + 1.0) / 2.0 * terms
        return np.asarray(total.sum(axis=1))

    def standard(self, residual: Array, follows: Flags, scales: Array) -> tuple[Array, Array]:
        """See :class:`ResidualNoise`; of scale, not variance, one."""
        return residual / scales[0], np.full(follows.size + 1, scales[0])

    def log_terms(self, standard: Array, sds: Array, scales: Array) -> Array:
        """See :class:`ResidualNoise`."""
        dof = scales[1]
        left = (dof + 1.0) / 2.0 * np.log1p(standard**2 / dof)
        return np.asarray(_log_constant(dof) - np.log(sds) - left)

    def sd(self, scales: Array) -> float:
        """See :class:`ResidualNoise`."""
        sigma, dof = scales
        return float(sigma * math.sqrt(dof / (dof - 2.0))) if dof > 2.0 else math.inf

    def marginal(self, scales: Array) -> Any:
        """See :class:`ResidualNoise`."""
        return stats.t(scales[:, 1:2], scale=scales[:, :1])

    def draw(self, follows: Flags, scales: Array, rng: np.random.Generator) -> Array:
        """See :class:`ResidualNoise`."""
        drawn = rng.standard_t(scales[:, 1:2], size=(len(scales), follows.size + 1))
        return np.asarray(scales[:, :1] * drawn)

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


def _log_constant(dof: Any) -> Any:
    return gammaln((dof + 1.0) / 2.0) - gammaln(dof / 2.0) - 0.5 * np.log(dof * math.pi)


SCALES = (_DOF,)
MODELS = (NoiseModel("student-t", lambda _: StudentT()),)
