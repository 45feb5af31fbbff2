"""What a likelihood is, whichever quantity it compares: torque or position.

The input-error likelihood compares the measured motor torque with the inverse model along the
measured motion; the output-error likelihood compares the measured position with a simulation
driven by the measured torque.
"""

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
    """The measured numbers of one recording that a likelihood is about."""

    name: str  # Of the recording
    # motor torque or motor force in N m or N, or joint position in rad or m
    quantity: str
    unit: str
    time: Array  # (M,) s since the file's first stamp
    measured: Array  # (M,)
    period: float  # From one output to the next of the same segment, s
    segment_of: NDArray[np.int64]  # (M,) number of the segment each belongs to
    follows: NDArray[np.bool_]  # (M - 1,) whether the next comes one period after


class Likelihood(ABC):
    """How probable the measurements are, given the joint's parameters.

    Parameter vectors ``(n, n_parameters)`` are those of the whole mechanism, fixed ones included,
    in the order of ``chain.names`` and in SI units. Noise scales come as ``(n, R, Q)``: vectors,
    recordings, and :attr:`noise`'s own.
    """

    chain: Joint  # The mechanism
    observations: tuple[Observation, ...]  # The R prepared recordings
    outputs: tuple[Outputs, ...]  # What is compared in each of them
    method: LikelihoodMethod  # input-error for torque, output-error for position
    noise: NoiseDescription  # What the noise is described by

    @property
    def slow_evaluations(self) -> int:
        """Parameter vectors so far that lay where the likelihood is not prepared, and were dear."""
        return 0

    @property
    def fast(self) -> bool:
        """Whether a vector costs no more than the sampler's own bookkeeping."""
        return False

    def relinearised_at(self, values: Array) -> Likelihood:  # noqa: ARG002
        """Give the same likelihood with its approximations made near ``(n_parameters,)``.

        Itself where there are none.
        """
        return self

    def subsample(self) -> Likelihood:
        """Give the likelihood of excerpts of long recordings; itself where that spares nothing."""
        return self

    def precomputed(self, draws: Array) -> Likelihood:  # noqa: ARG002
        """Give the same likelihood, cheaper near draws ``(n, n_parameters)``.

        The draws, about as wide as a posterior, decide how fast it is, not what it is. Itself where
        nothing can be prepared.
        """
        return self

    @abstractmethod
    def log_density(self, values: Array, scales: Array) -> Array:
        """Log-likelihood of all recordings together.

        Shapes: ``values`` (n, n_parameters), ``scales`` (n, R, Q), returns (n,).
        """

    @abstractmethod
    def pointwise(self, values: Array, scales: Array) -> list[Array]:
        """Log densities of single outputs, ``(n, terms)`` a recording, for model comparison.

        They sum to the log density of the outputs; ``values`` and ``scales`` as for
        :meth:`log_density`.
        """

    @abstractmethod
    def predict(self, values: Array) -> list[Array]:
        """Modelled outputs of parameter vectors ``(n, n_parameters)``, ``(n, M)`` a recording."""

    @abstractmethod
    def standardised(self, values: Array, scales: Array) -> list[Array]:
        """Modelled outputs as linear combinations with unit noise.

        Their derivatives ``J`` by the parameters make up the Fisher information ``J'J``.

        Shapes: ``values`` (n, n_parameters), ``scales`` (R, Q), returns (n, terms).
        """

    @abstractmethod
    def noise_information(self, scales: Array) -> Array:
        """Fisher information ``(R, Q, Q)`` of each recording's noise scales ``(R, Q)``."""

    @abstractmethod
    def noise_sd(self, scales: Array) -> list[Array]:
        """Marginal standard deviation of each output about its prediction, ``(M,)`` a recording.

        ``scales`` ``(R, Q)``; in the outputs' unit.
        """

    @abstractmethod
    def draw_noise(self, scales: Array, rng: np.random.Generator) -> list[Array]:
        """Draw noise of the outputs, for posterior predictions.

        Shapes: ``scales`` (n, R, Q), returns (n, M).
        """
