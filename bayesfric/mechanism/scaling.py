"""The scaling that no torque can see: everything behind a gearbox, and its alphas, together.

Section 4.2 of the paper notes it (with a misprint, see the notes): leg parameters and
``alpha_1, alpha_2`` times one factor leave eq. (13) as it was. A known mass on the
load, or a known parameter behind the gearbox, takes the freedom away.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayesfric.mechanism.chain import Chain

Array = NDArray[np.float64]

# What grows with the torque behind the gearbox; the other quantities are ratios, angles or speeds.
_SCALED = frozenset(
    {
        "inertia",
        "viscous",
        "quadratic",
        "coulomb",
        "coulomb_positive",
        "coulomb_negative",
        "first_moment",
    }
)


@dataclass(frozen=True)
class Scaling:
    """The one-parameter family of parameter vectors that feel the same to the motor.

    Attributes
    ----------
    element
        The element with two load losses.
    behind
        Names of the parameters that are multiplied by the factor.
    drive, back
        Names of its two load losses, whose alphas are multiplied by the factor.
    """

    chain: Chain
    element: str
    behind: tuple[str, ...]

    @property
    def drive(self) -> str:
        """Name of ``mu_1``."""
        return f"{self.element}.load_drive"

    @property
    def back(self) -> str:
        """Name of ``mu_2``."""
        return f"{self.element}.load_back"

    @property
    def names(self) -> tuple[str, ...]:
        """Everything that changes along the scaling."""
        return (*self.behind, self.drive, self.back)

    def bounds(self, values: ArrayLike) -> tuple[float, float]:
        """Smallest and largest factor that a passive gearbox allows.

        ``1/alpha_2 <= k <= 1/alpha_1``, from ``alpha_1 <= 1 <= alpha_2``.

        Parameters
        ----------
        values
            ``(n_parameters,)`` in the order of ``chain.names``.
        """
        at = np.asarray(values, dtype=np.float64)
        drive, back = (self.chain.names.index(name) for name in (self.drive, self.back))
        return max(1.0 - float(at[back]), 0.0), 1.0 + float(at[drive])

    def scaled(self, values: ArrayLike, factor: ArrayLike) -> Array:
        """Parameter vectors that make the same torque.

        Parameters
        ----------
        values
            ``(n_parameters,)`` in the order of ``chain.names``.
        factor
            One factor, or ``(n,)`` of them.

        Returns
        -------
        ndarray
            ``(n_parameters,)`` or ``(n, n_parameters)``.
        """
        k = np.asarray(factor, dtype=np.float64)
        out = np.tile(np.asarray(values, dtype=np.float64), (*k.shape, 1))
        for name in self.behind:
            out[..., self.chain.names.index(name)] *= k
        drive, back = (self.chain.names.index(name) for name in (self.drive, self.back))
        # alpha_1 = 1/(1 + mu_1), alpha_2 = 1/(1 - mu_2), eq. (6)
        out[..., drive] = (1.0 + out[..., drive]) / k - 1.0
        out[..., back] = 1.0 - (1.0 - out[..., back]) / k
        return out if k.shape else out.reshape(-1)

    def tangent(self, values: ArrayLike) -> Array:
        """Differentiate :meth:`scaled` by the factor's logarithm at one, ``(n_parameters,)``."""
        at = np.asarray(values, dtype=np.float64)
        out = np.zeros_like(at)
        names = self.chain.names
        for name in self.behind:
            out[names.index(name)] = at[names.index(name)]
        out[names.index(self.drive)] = -1.0 - at[names.index(self.drive)]
        out[names.index(self.back)] = 1.0 - at[names.index(self.back)]
        return out

    def middle(self, values: ArrayLike) -> float:
        """Factor in the (geometric) middle of its bounds; one where there is no lower bound."""
        low, high = self.bounds(values)
        return math.sqrt(low * high) if low > 0.0 else 1.0


def scalings(chain: Chain) -> tuple[Scaling, ...]:
    """Find the scalings a chain has while nothing behind the gearbox is known.

    One for every element with two load losses that has something behind it.
    """
    found = []
    for i, element in enumerate(chain.elements):
        if element.load_loss != "two":
            continue
        owners = {e.name for e in chain.elements[i + 1 :]} | {"load"}
        behind = tuple(
            p.name
            for p in chain.parameters
            if p.name.rpartition(".")[0] in owners and p.quantity in _SCALED
        )
        if behind:
            found.append(Scaling(chain, element.name, behind))
    return tuple(found)
