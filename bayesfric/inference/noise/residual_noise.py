"""What every noise model of torque residuals tells of itself, and the scale they all have.

Scales come as ``(n, R, Q)``, ``sigma`` first, as
:class:`bayesfric.inference.likelihood.likelihood.Likelihood` hands them over.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bayesfric.inference.moments.residual_moments import PlainMoments, ResidualMoments
from bayesfric.inference.noise.scale import NoiseDescription, Scale, up_to
from bayesfric.recordings.arrays import Array, Flags

SIGMA = Scale("sigma", r"\sigma", "noise of the filtered torque", lambda s: up_to(s.torque))


@dataclass(frozen=True)
class NoiseModel:
    """A noise model by the name that a configuration asks for it.

    ``make`` takes the order; where that is from says ``order``: there is ``none``, it is
    ``chosen`` by the residuals of an estimate, or that only where it is not ``given``.
    """

    name: str
    make: Callable[[int], ResidualNoise]
    order: Literal["none", "chosen", "given or chosen"] = "none"

    def chooses(self, order: int | None) -> bool:
        """Whether residuals are asked for the order where a configuration tells this one."""
        return self.order == "chosen" or (self.order == "given or chosen" and order is None)


class ResidualNoise(NoiseDescription):
    """A noise model of torque residuals."""

    # predecessors of a residual that tell something of it
    order: int = 0
    # whether lagged products of residuals are all that the density asks for
    gaussian: bool = False

    @abstractmethod
    def log_density_of(
        self, plain: PlainMoments, moments: ResidualMoments, values: Array, scales: Array
    ) -> Array:
        """Log density of all residuals of parameters ``(n, n_parameters)``, ``(n,)``.

        ``plain`` goes through every sample, ``moments`` computes the same faster; ``scales`` are
        ``(n, R, Q)``.
        """

    @abstractmethod
    def standard(self, residual: Array, follows: Flags, scales: Array) -> tuple[Array, Array]:
        """Turn residuals ``(..., M)`` into uncorrelated ones of variance one.

        ``scales`` ``(Q,)``. Gives them and the ``(M,)`` sds they were divided by. It is
        linear in the residuals.
        """

    @abstractmethod
    def log_terms(self, standard: Array, sds: Array, scales: Array) -> Array:
        """Log densities of residuals, from what :meth:`standard` gives, ``(..., M)``."""

    @abstractmethod
    def sd(self, scales: Array) -> float:
        """Spread of one residual, ``scales`` ``(Q,)``; infinite where it has none."""

    @abstractmethod
    def marginal(self, scales: Array) -> Any:
        """SciPy's distribution of one residual, of shape ``(n, 1)`` for scales ``(n, Q)``."""

    @abstractmethod
    def draw(self, follows: Flags, scales: Array, rng: np.random.Generator) -> Array:
        """Draw residuals, one series for each row of ``scales`` ``(n, Q)``, ``(n, M)``."""

    @abstractmethod
    def information(self, scales: Array, outputs: int) -> Array:
        """Fisher information of ``scales`` ``(Q,)`` from so many outputs, ``(Q, Q)``."""

    @abstractmethod
    def starts(self, sigma: float) -> Array:
        """Scales to start a search from where residuals are ``sigma`` large, ``(k, Q)``."""
