"""Input-error likelihood: measured motor torque around the inverse model.

The torque of eq. (13), or of its extension, along the measured motion and the measured torque pass
the same parallel filter, so filtering does not bias their comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from bayesfric.estimates.torque import filtered_torque
from bayesfric.inference.likelihood.likelihood import Likelihood, Outputs
from bayesfric.inference.likelihood.static_friction import StaticFriction
from bayesfric.inference.moments.fast_moments import FastMoments, fast_moments
from bayesfric.inference.moments.residual_moments import PlainMoments, follows
from bayesfric.inference.noise.autoregressive import Autoregressive
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation


class TorqueLikelihood(Likelihood):
    """Likelihood of the measured torques."""

    method = "input-error"

    def __init__(
        self, chain: Joint, observations: Sequence[Observation], noise: Autoregressive | None = None
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
        """Whether the recordings are reduced to moments."""
        return self.moments is not self._plain

    def subsample(self) -> TorqueLikelihood:
        """See :class:`Likelihood`."""
        subsampled = [o.excerpt() for o in self.observations]
        if all(few is o for few, o in zip(subsampled, self.observations, strict=True)):
            return self
        return TorqueLikelihood(self.chain, subsampled, self.noise)

    def precomputed(self, draws: Array) -> TorqueLikelihood:
        """Return the same likelihood at a cost independent of the length of the recordings.

        Its values are the same up to rounding, see :mod:`bayesfric.inference.moments.fast_moments`.
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
        return self.moments.at(values).sum_of_squares

    def log_density(self, values: Array, scales: Array) -> Array:
        """See :class:`Likelihood`; standstill is a separate factor."""
        moments, counts = self.moments.at(values), (self._plain.counts, self._plain.head_counts)
        total = self.noise.log_density(moments, *counts, scales)
        for r, static in enumerate(self._static):
            if static is not None:
                total = total + static.log_terms(values, self.noise.marginal(scales[:, r])).sum(1)
        return total

    def pointwise(self, values: Array, scales: Array) -> list[Array]:
        """See :class:`Likelihood`: each output given the previous ones, without standstill."""
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
        """See :class:`Likelihood`; the log probability of standstill counts as an output."""
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
        """See :class:`Likelihood`."""
        return np.stack(
            [self.noise.information(s, int(n)) for s, n in zip(scales, self.sizes, strict=True)]
        )

    def noise_sd(self, scales: Array) -> list[Array]:
        """See :class:`Likelihood`."""
        return [np.full(n, self.noise.sd(s)) for n, s in zip(self.sizes, scales, strict=True)]

    def draw_noise(self, scales: Array, rng: np.random.Generator) -> list[Array]:
        """See :class:`Likelihood`."""
        return [self.noise.draw(o.follows, scales[:, r], rng) for r, o in enumerate(self.outputs)]
