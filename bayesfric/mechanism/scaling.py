"""The scaling that no torque can see: everything behind a gearbox, and its alphas, together.

Section 4.2 of the paper notes it (with a misprint, see the notes): leg parameters and
``alpha_1, alpha_2`` times one factor leave eq. (13) as it was. A known mass on the
load, or a known parameter behind the gearbox, takes the freedom away.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from bayesfric.mechanism.chain import Chain
from bayesfric.recordings.arrays import Array


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
    added
        Known amounts that come on top of parameters behind it, in the order of ``behind``:
        where every recording has the same added mass, load and mass are scaled as one.
    """

    chain: Chain
    element: str
    behind: tuple[str, ...]
    added: tuple[float, ...] = ()

    @property
    def divided(self) -> dict[str, int]:
        """What else the losses of the element hold, and the power of the factor that divides it."""
        return {
            p.name: p.row.scaled_by
            for p in self.chain.parameters
            if p.owner == self.element and p.row.scaled_by
        }

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
        return (*self.behind, self.drive, self.back, *self.divided)

    def bounds(
        self, values: ArrayLike, limits: Mapping[str, tuple[float, float]] | None = None
    ) -> tuple[float, float]:
        """Smallest and largest factor that a passive gearbox allows.

        ``1/alpha_2 <= k <= 1/alpha_1``, from ``alpha_1 <= 1 <= alpha_2``.

        Parameters
        ----------
        values
            ``(n_parameters,)`` in the order of ``chain.names``.
        limits
            Lower and upper limits of parameters, which ``values`` keeps; those of scaled
            ones narrow the factor further.
        """
        at = np.asarray(values, dtype=np.float64)
        names = self.chain.names
        drive, back = (float(at[names.index(name)]) for name in (self.drive, self.back))
        low, high = max(1.0 - back, 0.0), 1.0 + drive
        limits = limits or {}
        for name, known in self.parts():
            # load and known mass together cannot shrink below the known mass
            least, most = limits.get(name, (0.0 if known > 0.0 else -math.inf, math.inf))
            whole = float(at[names.index(name)]) + known
            if whole > 0.0:
                low, high = max(low, (least + known) / whole), min(high, (most + known) / whole)
        if self.drive in limits:
            # mu_1 falls as the factor grows: 1 + mu_1 = (1 + mu_1 at k = 1) / k
            least, most = limits[self.drive]
            low = max(low, (1.0 + drive) / (1.0 + most))
            high = min(high, (1.0 + drive) / (1.0 + least))
        if self.back in limits and back < 1.0:
            # and mu_2 grows: 1 - mu_2 = (1 - mu_2 at k = 1) / k
            least, most = limits[self.back]
            low = max(low, (1.0 - back) / (1.0 - least))
            high = min(high, (1.0 - back) / (1.0 - most) if most < 1.0 else math.inf)
        return low, high

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
        for name, known in self.parts():
            column = self.chain.names.index(name)
            out[..., column] = (out[..., column] + known) * k - known
        drive, back = (self.chain.names.index(name) for name in (self.drive, self.back))
        # alpha_1 = 1/(1 + mu_1), alpha_2 = 1/(1 - mu_2), eq. (6)
        out[..., drive] = (1.0 + out[..., drive]) / k - 1.0
        out[..., back] = 1.0 - (1.0 - out[..., back]) / k
        for name, power in self.divided.items():
            out[..., self.chain.names.index(name)] /= k**power
        return out if k.shape else out.reshape(-1)

    def tangent(self, values: ArrayLike) -> Array:
        """Differentiate :meth:`scaled` by the factor's logarithm at one, ``(n_parameters,)``."""
        at = np.asarray(values, dtype=np.float64)
        out = np.zeros_like(at)
        names = self.chain.names
        for name, known in self.parts():
            out[names.index(name)] = at[names.index(name)] + known
        out[names.index(self.drive)] = -1.0 - at[names.index(self.drive)]
        out[names.index(self.back)] = 1.0 - at[names.index(self.back)]
        for name, power in self.divided.items():
            out[names.index(name)] = -power * at[names.index(name)]
        return out

    def middle(self, values: ArrayLike) -> float:
        """Factor in the (geometric) middle of its bounds; one where there is no lower bound."""
        low, high = self.bounds(values)
        return math.sqrt(low * high) if 0.0 < low < high else 1.0

    def parts(self) -> Iterator[tuple[str, float]]:
        """List the names behind the element, with what is known to come on top of each."""
        return zip(self.behind, self.added or (0.0,) * len(self.behind), strict=True)


def scalings(
    chain: Chain, added_inertia: float = 0.0, added_moment: float = 0.0
) -> tuple[Scaling, ...]:
    """Find the scalings a chain has while nothing behind the gearbox is known.

    One for every element with two load losses that has something behind it.

    Parameters
    ----------
    chain
        The mechanism.
    added_inertia, added_moment
        Of a known mass on the load in every recording, kg m² (kg) and kg m. It is one with
        the load where this has both as parameters, and else takes the scaling away.
    """
    known = {"load.inertia": added_inertia, "load.first_moment": added_moment}
    known = {name: amount for name, amount in known.items() if amount}
    if not set(known) <= set(chain.names):
        return ()
    found = []
    for i, element in enumerate(chain.elements):
        if element.load_loss != "two":
            continue
        owners = {e.name for e in chain.elements[i + 1 :]} | {"load"}
        behind = tuple(
            p.name
            for p in chain.parameters
            # ratios, angles and speeds do not grow with the torque behind the gearbox
            if p.owner in owners and p.row.role == "own"
        )
        if behind:
            added = tuple(known.get(name, 0.0) for name in behind) if known else ()
            found.append(Scaling(chain, element.name, behind, added))
    return tuple(found)
