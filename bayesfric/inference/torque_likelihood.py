"""Gaussian likelihood of the measured motor torque around the inverse model.

Model output and measured torque pass the same parallel filter, so what the
filter removes is removed from both and does not bias the comparison.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.torque import filtered_torque
from bayesfric.inference.fast_moments import fast_moments
from bayesfric.inference.likelihood import LikelihoodMethod, Outputs, normal_terms
from bayesfric.inference.residual_moments import PlainMoments, ResidualMoments, follows
from bayesfric.mechanism.chain import Chain
from bayesfric.recordings.observation import Observation

Array = NDArray[np.float64]


class TorqueLikelihood:
    """How probable the measured torques are, given the joint's parameters.

    See :class:`bayesfric.inference.likelihood.Likelihood`.

    Parameters
    ----------
    chain
        The mechanism.
    observations
        One or more prepared recordings. They share the chain's parameters.
    moments
        Computes the residuals' moments of these recordings; sample by sample if left out.
    """

    method: LikelihoodMethod = "input-error"
    noise_quantities: tuple[str, ...] = ("sigma",)

    def __init__(
        self,
        chain: Chain,
        observations: Sequence[Observation],
        moments: ResidualMoments | None = None,
    ) -> None:
        self.chain = chain
        self.observations = tuple(observations)
        rotary = chain.motor_motion == "rotary"
        self.outputs = tuple(
            Outputs(
                name=o.name,
                quantity="motor torque" if rotary else "motor force",
                unit="N m" if rotary else "N",
                time=o.time,
                measured=o.measured,
                period=o.period,
                segment_of=o.segment_of,
                follows=follows(o),
            )
            for o in self.observations
        )
        self.sizes = np.array([o.measured.size for o in self.observations])
        self.moments: ResidualMoments = (
            PlainMoments(chain, self.observations) if moments is None else moments
        )

    @property
    def evaluation(self) -> str:
        """How residuals are summed, in words."""
        return self.moments.description

    def prepared(self, draws: Array) -> TorqueLikelihood:
        """Make the same likelihood at a cost that does not grow with the recordings.

        Its values are the same everywhere, up to rounding; see
        :mod:`bayesfric.inference.fast_moments`.

        Parameters
        ----------
        draws
            ``(n, n_parameters)`` vectors about as spread as the posterior, some hundreds.
            The nearer they are to it, the faster the result.

        Returns
        -------
        TorqueLikelihood
            Itself for a chain whose torque has no such form; :attr:`evaluation` tells.
        """
        moments = fast_moments(self.chain, self.observations, draws, self.moments.order)
        if moments is None:
            return self
        return TorqueLikelihood(self.chain, self.observations, moments)

    def sum_of_squares(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sum of squared residuals of each recording.

        Parameters
        ----------
        values
            ``(n, n_parameters)`` in the order of ``chain.names``.

        Returns
        -------
        ndarray
            ``(n, n_recordings)``, torque unit squared.
        """
        return self.moments.at(values).sum_of_squares

    def about(self, values: Array) -> TorqueLikelihood:  # noqa: ARG002
        """Give itself: nothing about it is approximate."""
        return self

    def log_density(self, values: Array, scales: Array) -> Array:
        """Log-likelihood with white Gaussian noise.

        Parameters
        ----------
        values
            ``(n, n_parameters)``.
        scales
            ``(n, n_recordings, 1)`` noise scales.

        Returns
        -------
        ndarray
            ``(n,)``
        """
        squares, sigma = self.sum_of_squares(values), scales[..., 0]
        terms = squares / sigma**2 + self.sizes * (2.0 * np.log(sigma) + math.log(2.0 * math.pi))
        total: Array = -0.5 * terms.sum(axis=1)
        return total

    def pointwise(self, values: Array, scales: Array) -> list[Array]:
        """See :class:`bayesfric.inference.likelihood.Likelihood`."""
        sds = [scales[:, r] for r in range(len(self.outputs))]
        z = [
            (o.measured - torque) / sd
            for o, torque, sd in zip(self.outputs, self.predict(values), sds, strict=True)
        ]
        return normal_terms(z, sds)

    def predict(self, values: Array) -> list[Array]:
        """Predict the filtered torque of each recording, ``(n, n_outputs)`` each."""
        return [filtered_torque(self.chain, o, values) for o in self.observations]

    def standardised(self, values: Array, scales: Array) -> list[Array]:
        """See :class:`bayesfric.inference.likelihood.Likelihood`."""
        return [
            torque / sigma for torque, sigma in zip(self.predict(values), scales[:, 0], strict=True)
        ]

    def noise_information(self, scales: Array) -> Array:
        """See :class:`bayesfric.inference.likelihood.Likelihood`: ``2n / sigma^2``."""
        return 2.0 * self.sizes[:, None, None] / scales[..., None] ** 2

    def noise_sd(self, scales: Array) -> list[Array]:
        """See :class:`bayesfric.inference.likelihood.Likelihood`."""
        return [np.full(n, sigma) for n, sigma in zip(self.sizes, scales[:, 0], strict=True)]

    def draw_noise(self, scales: Array, rng: np.random.Generator) -> list[Array]:
        """See :class:`bayesfric.inference.likelihood.Likelihood`."""
        return [
            scales[:, r] * rng.standard_normal((scales.shape[0], n))
            for r, n in enumerate(self.sizes)
        ]
