"""What a likelihood is, whichever quantity it compares: torque or position."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from bayesfric.inference.noise.scale import NoiseDescription
from bayesfric.mechanism.chain import Chain
from bayesfric.recordings.observation import Observation

Array = NDArray[np.float64]
LikelihoodMethod = Literal["input-error", "output-error"]


@dataclass(frozen=True, eq=False)
class Outputs:
    """The measured numbers of one recording that a likelihood is about.

    Attributes
    ----------
    name
        Of the recording.
    quantity, unit
        ``motor torque`` in N m, ``motor force`` in N, or ``joint position`` in rad or m.
    time
        ``(M,)``, s.
    measured
        ``(M,)``
    period
        From one output to the next of the same segment, s.
    segment_of
        ``(M,)`` number of the segment each belongs to.
    follows
        ``(M - 1,)`` whether output m + 1 comes one period after output m.
    """

    name: str
    quantity: str
    unit: str
    time: Array
    measured: Array
    period: float
    segment_of: NDArray[np.int64]
    follows: NDArray[np.bool_]


class Likelihood(Protocol):
    """How probable the measurements are, given the joint's parameters.

    Noise scales are handed over as ``(n, R, Q)``: vectors, recordings, and the
    :attr:`noise`'s own.
    """

    chain: Chain
    observations: tuple[Observation, ...]
    outputs: tuple[Outputs, ...]
    method: LikelihoodMethod

    @property
    def noise(self) -> NoiseDescription:
        """What it takes for noise."""
        ...

    def about(self, values: Array) -> Likelihood:
        """Give the same likelihood with its approximations made near ``(n_parameters,)``."""
        ...

    @property
    def outside(self) -> int:
        """Vectors so far that lay where the likelihood is not prepared, and were dear."""
        ...

    @property
    def cheap(self) -> bool:
        """Whether a vector costs no more than the sampler's own bookkeeping."""
        ...

    @property
    def evaluation(self) -> str:
        """How it is computed, in words."""
        ...

    def prepared(self, draws: Array) -> Likelihood:
        """Give the same likelihood, cheaper near draws ``(n, n_parameters)``."""
        ...

    def log_density(self, values: Array, scales: Array) -> Array:
        """Log-likelihood of parameter vectors ``(n, n_parameters)``, ``(n,)``."""
        ...

    def pointwise(self, values: Array, scales: Array) -> list[Array]:
        """Terms that sum to the log-likelihood, ``(n, terms)`` a recording."""
        ...

    def predict(self, values: Array) -> list[Array]:
        """Modelled outputs, ``(n, M)`` a recording."""
        ...

    def standardised(self, values: Array, scales: Array) -> list[Array]:
        """Modelled outputs as linear combinations with unit noise, ``(n, terms)`` a recording.

        ``scales`` ``(R, Q)``. Their derivatives make up the Fisher information.
        """
        ...

    def noise_information(self, scales: Array) -> Array:
        """Fisher information of the noise scales ``(R, Q)``, ``(R, Q, Q)``."""
        ...

    def noise_sd(self, scales: Array) -> list[Array]:
        """Spread of each output about its prediction, ``(M,)``; ``scales`` ``(R, Q)``."""
        ...

    def draw_noise(self, scales: Array, rng: np.random.Generator) -> list[Array]:
        """Noise of each output, ``(n, M)`` a recording."""
        ...


def normal_terms(z: Sequence[Array], sd: Sequence[Array]) -> list[Array]:
    """Log densities of normal residuals, given over their sds ``sd`` as ``z``."""
    return [-0.5 * a**2 - np.log(s) - 0.5 * np.log(2.0 * np.pi) for a, s in zip(z, sd, strict=True)]
