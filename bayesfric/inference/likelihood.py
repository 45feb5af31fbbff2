"""Input-error likelihood: measured motor torque around the inverse model.

The torque of eq. (13), or of its extension, along the measured motion and the measured torque pass
the same parallel filter, so filtering does not bias their comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.autoregression import follows
from bayesfric.estimates.torque import filtered_torque
from bayesfric.inference.moments import FastMoments, PlainMoments, fast_moments
from bayesfric.inference.noise import Autoregressive
from bayesfric.mechanism import kernels
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.checks import Rest
from bayesfric.recordings.measurement import Inputs
from bayesfric.recordings.signals import Signals

LikelihoodMethod = Literal["input-error", "output-error", "closed-loop"]


@dataclass(frozen=True, eq=False)
class Outputs:
    """The measured outputs of one recording."""

    name: str  # of the recording
    # motor torque or force, N m or N, or joint position, rad or m
    quantity: str
    unit: str
    time: Array  # (M,) s since the first stamp of the file
    measured: Array  # (M,)
    period: float  # s, between outputs of one segment
    segment_of: NDArray[np.int64]  # (M,) index of its segment
    follows: NDArray[np.bool_]  # (M - 1,) whether the next comes one period later


class StaticFriction:
    """Log probability that a joint stays at standstill in one recording.

    At standstill friction balances any torque within its limits, those of the inverse model with
    either sign of a vanishing speed. A measured torque ``y`` of noise ``e`` contributes the
    probability that ``y - e`` is between them, and no density: only torques near or beyond a limit
    are informative.
    """

    def __init__(self, chain: Joint, rest: Rest, inputs: Inputs) -> None:
        self._chain, self._inputs, self._torque = chain, inputs, rest.torque
        zero, vanishing = np.zeros_like(rest.q), 1e-9  # far below all other speeds of the model
        self._directions = [
            chain.samples(rest.q, zero + direction * vanishing, zero, inputs, rest.stamps)
            for direction in (1.0, -1.0)
        ]

    def limits(self, values: Array) -> tuple[Array, Array]:
        """Return the torques ``(n, M)`` at which the joint would move backwards and forwards."""
        tables = self._chain.tables(values, self._inputs)
        forwards, backwards = (kernels.inverse_many(*tables, way) for way in self._directions)
        return np.minimum(forwards, backwards), np.maximum(forwards, backwards)

    def log_terms(self, values: Array, noise: Any) -> Array:
        """Return the log probability ``(n, M)`` of standstill; ``noise`` is of shape ``(n, 1)``."""
        low, high = self.limits(values)
        a, b = low - self._torque, high - self._torque
        # the tail without cancellation
        upper = a + b > 0.0
        nearer, farther = np.where(upper, -a, b), np.where(upper, -b, a)
        with np.errstate(all="ignore"):
            inner, outer = noise.logcdf(nearer), noise.logcdf(farther)
            log_probability = inner + np.log1p(-np.exp(np.minimum(outer - inner, 0.0)))
        # equal limits leave no probability
        return np.asarray(np.fmax(log_probability, -700.0))


class TorqueLikelihood:
    """Likelihood of the measured torques, given the joint's parameters.

    Parameter vectors ``(n, n_parameters)`` include fixed ones, in the order of ``chain.names`` and
    SI units; noise scales are ``(n, R, Q)``: vectors, recordings, and those of ``noise``.
    """

    method: LikelihoodMethod = "input-error"

    def __init__(
        self, chain: Joint, observations: Sequence[Signals], noise: Autoregressive | None = None
    ) -> None:
        self.chain, self.observations = chain, tuple(observations)
        rotary = chain.motor_motion == "rotary"
        kind = ("motor torque", "N m") if rotary else ("motor force", "N")
        self.outputs = tuple(
            Outputs(o.name, *kind, o.time, o.measured, o.period, o.segment_of, follows(o))
            for o in self.observations
        )
        self.sizes = np.array([o.measured.size for o in self.observations])
        self.noise: Autoregressive = Autoregressive() if noise is None else noise
        self._plain = PlainMoments(chain, self.observations, self.noise.order)
        self._static = [
            None if o.rest is None else StaticFriction(chain, o.rest, o.inputs)
            for o in self.observations
        ]
        # sample by sample until :meth:`precomputed`
        self.moments: PlainMoments | FastMoments = self._plain

    @property
    def slow_evaluations(self) -> int:
        """Number of evaluations outside the precomputed region."""
        return self.moments.slow_evaluations if isinstance(self.moments, FastMoments) else 0

    @property
    def fast(self) -> bool:
        """Whether an evaluation costs no more than the sampler's own bookkeeping."""
        return self.moments is not self._plain

    def subsample(self) -> TorqueLikelihood:
        """Return the likelihood of subsamples of long recordings."""
        subsampled = [o.excerpt() for o in self.observations]
        if all(few is o for few, o in zip(subsampled, self.observations, strict=True)):
            return self
        return TorqueLikelihood(self.chain, subsampled, self.noise)

    def precomputed(self, draws: Array) -> TorqueLikelihood:
        """Return the same likelihood near draws, at a cost independent of the recordings' length.

        Its values are the same up to rounding, see :mod:`bayesfric.inference.moments`.
        """
        moments = fast_moments(
            self.chain, self.observations, draws, self.noise.order, plain=self._plain
        )
        if moments is None:
            return self
        out = copy(self)
        out.moments = moments
        return out

    def sum_of_squares(self, values: Array) -> Array:
        """Sum of squared residuals ``(n, R)`` of each recording, torque unit squared."""
        return np.asarray(sum(products[..., 0, 0] for products in self.moments.at(values)))

    def log_density(self, values: Array, scales: Array) -> Array:
        """Log-likelihood ``(n,)`` of all recordings; standstill is a separate factor."""
        total = self.noise.log_density(self.moments.at(values), self._plain.counts, scales)
        for r, static in enumerate(self._static):
            if static is not None:
                total = total + static.log_terms(values, self.noise.marginal(scales[:, r])).sum(1)
        return total

    def pointwise(self, values: Array, scales: Array) -> list[Array]:
        """Log densities ``(n, M)`` a recording: outputs given previous ones, without standstill."""
        return [
            np.stack(
                [
                    self.noise.log_terms(*self.noise.standard(row, o.follows, s))
                    for row, s in zip(o.measured - torque, scales[:, r], strict=True)
                ]
            )
            for r, (o, torque) in enumerate(zip(self.outputs, self.predict(values), strict=True))
        ]

    def predict(self, values: Array) -> list[Array]:
        """Predict the filtered torque ``(n, M)`` of each recording, N m or N."""
        return [filtered_torque(self.chain, o, values) for o in self.observations]

    def standardised(self, values: Array, scales: Array) -> list[Array]:
        """Modelled outputs with unit noise, ``(n, terms)`` a recording; ``scales`` ``(R, Q)``.

        With their derivatives ``J``, ``J'J`` is the Fisher information. The log probability of
        standstill counts as an output.
        """
        rows = self.innovations(self.predict(values), scales)
        for r, static in enumerate(self._static):
            if static is not None:
                noise = self.noise.marginal(np.tile(scales[r], (len(values), 1)))
                terms = static.log_terms(values, noise)
                rows[r] = np.concatenate([rows[r], terms], axis=1)
        return rows

    def innovations(self, residuals: Sequence[Array], scales: Array) -> list[Array]:
        """Whiten residuals ``(..., M)`` of each recording at noise scales ``(R, Q)``."""
        return [
            self.noise.standard(residual, o.follows, s)[0]
            for o, residual, s in zip(self.outputs, residuals, scales, strict=True)
        ]

    def noise_information(self, scales: Array) -> Array:
        """Fisher information ``(R, Q, Q)`` of noise scales ``(R, Q)``."""
        return np.stack(
            [self.noise.information(s, int(n)) for s, n in zip(scales, self.sizes, strict=True)]
        )

    def noise_sd(self, scales: Array) -> list[Array]:
        """Marginal standard deviation of outputs, ``(M,)`` a recording, at scales ``(R, Q)``."""
        return [np.full(n, self.noise.sd(s)) for n, s in zip(self.sizes, scales, strict=True)]

    def draw_noise(self, scales: Array, rng: np.random.Generator) -> list[Array]:
        """Draw noise ``(n, M)`` of the outputs of each recording."""
        return [self.noise.draw(o.follows, scales[:, r], rng) for r, o in enumerate(self.outputs)]
