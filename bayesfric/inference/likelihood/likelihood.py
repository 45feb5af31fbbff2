"""The interface of likelihoods: input error (torque) and output error (position)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.inference.noise import NoiseDescription
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

LikelihoodMethod = Literal["input-error", "output-error"]


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


class Likelihood(ABC):
    """Likelihood of the measured outputs, given the joint's parameters.

    Parameter vectors ``(n, n_parameters)`` include fixed ones, in the order of ``chain.names`` and
    SI units; noise scales are ``(n, R, Q)``: vectors, recordings, and those of :attr:`noise`.
    """

    chain: Joint
    observations: tuple[Observation, ...]  # the R preprocessed recordings
    outputs: tuple[Outputs, ...]  # of each
    method: LikelihoodMethod  # input-error: torque; output-error: position
    noise: NoiseDescription

    @property
    def slow_evaluations(self) -> int:
        """Number of slow evaluations, outside the precomputed region."""
        return 0

    @property
    def fast(self) -> bool:
        """Whether an evaluation costs no more than the sampler's own bookkeeping."""
        return False

    def relinearised_at(self, values: Array) -> Likelihood:  # noqa: ARG002
        """Return the same likelihood, linearised at ``(n_parameters,)`` if it is at all."""
        return self

    def subsample(self) -> Likelihood:
        """Return the likelihood of subsamples of long recordings."""
        return self

    def precomputed(self, draws: Array) -> Likelihood:  # noqa: ARG002
        """Return the same likelihood, fast near draws ``(n, n_parameters)``, if possible."""
        return self

    @abstractmethod
    def log_density(self, values: Array, scales: Array) -> Array:
        """Log-likelihood ``(n,)`` of all recordings."""

    @abstractmethod
    def pointwise(self, values: Array, scales: Array) -> list[Array]:
        """Log densities of single outputs, ``(n, terms)`` a recording; they sum to the total."""

    @abstractmethod
    def predict(self, values: Array) -> list[Array]:
        """Modelled outputs, ``(n, M)`` a recording."""

    @abstractmethod
    def standardised(self, values: Array, scales: Array) -> list[Array]:
        """Modelled outputs with unit noise, ``(n, terms)`` a recording; ``scales`` ``(R, Q)``.

        With their derivatives ``J``, ``J'J`` is the Fisher information.
        """

    @abstractmethod
    def noise_information(self, scales: Array) -> Array:
        """Fisher information ``(R, Q, Q)`` of noise scales ``(R, Q)``."""

    @abstractmethod
    def noise_sd(self, scales: Array) -> list[Array]:
        """Marginal standard deviation of outputs, ``(M,)`` a recording, at scales ``(R, Q)``."""

    @abstractmethod
    def draw_noise(self, scales: Array, rng: np.random.Generator) -> list[Array]:
        """Draw noise ``(n, M)`` of the outputs of each recording."""
