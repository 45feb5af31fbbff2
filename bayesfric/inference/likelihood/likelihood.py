"""What a likelihood is, whichever quantity it compares: torque or position."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.inference.noise.scale import NoiseDescription
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

LikelihoodMethod = Literal["input-error", "output-error"]


@dataclass(frozen=True, eq=False)
class Outputs:
    """The measured numbers ``(M,)`` of one recording that a likelihood is about."""

    name: str
    quantity: str  # motor torque or force, or joint position
    unit: str
    time: Array  # s
    measured: Array
    period: float  # from one output to the next of the same segment, s
    segment_of: NDArray[np.int64]  # number of the segment each belongs to
    follows: NDArray[np.bool_]  # (M - 1,) whether the next comes one period after


class Likelihood(ABC):
    """How probable the measurements are, given the joint's parameters.

    Noise scales are handed over as ``(n, R, Q)``: vectors, recordings, and
    :attr:`noise`'s own.
    """

    chain: Joint
    observations: tuple[Observation, ...]
    outputs: tuple[Outputs, ...]
    method: LikelihoodMethod
    noise: NoiseDescription

    @property
    def outside(self) -> int:
        """Vectors so far that lay where the likelihood is not prepared, and were dear."""
        return 0

    @property
    def cheap(self) -> bool:
        """Whether a vector costs no more than the sampler's own bookkeeping."""
        return False

    def about(self, values: Array) -> Likelihood:  # noqa: ARG002
        """Give the same likelihood with its approximations made near ``(n_parameters,)``."""
        return self

    def prepared(self, draws: Array) -> Likelihood:  # noqa: ARG002
        """Give the same likelihood, cheaper near draws ``(n, n_parameters)``."""
        return self

    @abstractmethod
    def log_density(self, values: Array, scales: Array) -> Array:
        """Log-likelihood of parameter vectors ``(n, n_parameters)``, ``(n,)``."""

    @abstractmethod
    def pointwise(self, values: Array, scales: Array) -> list[Array]:
        """Terms that sum to the log-likelihood, ``(n, terms)`` a recording."""

    @abstractmethod
    def predict(self, values: Array) -> list[Array]:
        """Modelled outputs, ``(n, M)`` a recording."""

    @abstractmethod
    def standardised(self, values: Array, scales: Array) -> list[Array]:
        """Modelled outputs as linear combinations with unit noise, ``(n, terms)`` a recording.

        ``scales`` ``(R, Q)``. Their derivatives make up the Fisher information.
        """

    @abstractmethod
    def noise_information(self, scales: Array) -> Array:
        """Fisher information of the noise scales ``(R, Q)``, ``(R, Q, Q)``."""

    @abstractmethod
    def noise_sd(self, scales: Array) -> list[Array]:
        """Spread of each output about its prediction, ``(M,)``; ``scales`` ``(R, Q)``."""

    @abstractmethod
    def draw_noise(self, scales: Array, rng: np.random.Generator) -> list[Array]:
        """Noise of each output, ``(n, M)`` a recording."""
