"""Scalings that change no torque: everything behind a gearbox, together with its alphas.

Section 4.2 of the paper notes it (with a misprint, see the notes): leg parameters and
``alpha_1, alpha_2`` times one factor leave eq. (13) as it was. A known mass on the
load, or a known parameter behind the gearbox, takes the freedom away; dissipation bounds it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from bayesfric.mechanism.joint import Joint, slots_of
from bayesfric.recordings.arrays import Array


@dataclass(frozen=True)
class Scaling:
    """The one-parameter family of parameter vectors of equal motor torque.

    With factor k: ``leg -> k leg``, ``1 + mu_1 -> (1 + mu_1)/k``, ``1 - mu_2 -> (1 - mu_2)/k``,
    which is ``alpha_1 -> k alpha_1``, ``alpha_2 -> k alpha_2``. No torque changes.
    """

    chain: Joint  # the mechanism
    # the element with load-dependent friction mu_1 (driving) and mu_2 (back-driving)
    element: str
    # of every parameter that takes part the shift and the power with which value + shift is
    # multiplied by factor**power. The shift of what is behind the element is the known amount
    # that comes on top of it; those of the losses make alphas of them, eq. (6)
    rules: Mapping[str, tuple[float, int]]

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
        return tuple(self.rules)

    @property
    def behind(self) -> tuple[str, ...]:
        """Names of the parameters behind the element, which are multiplied by the factor."""
        return tuple(name for name, (_, power) in self.rules.items() if power == 1)

    def factor_to(self, values: ArrayLike, name: str, value: float) -> float:
        """Factor at which a parameter that takes part reaches a value."""
        shift, power = self.rules[name]
        now = np.asarray(values, dtype=np.float64)[self.chain.names.index(name)] + shift
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.float64(value + shift) / now
            return float(np.maximum(share, 0.0) ** (1.0 / power)) if now else math.nan

    def bounds(
        self, values: ArrayLike, limits: Mapping[str, tuple[float, float]] | None = None
    ) -> tuple[float, float]:
        """Smallest and largest factor that a passive gearbox allows."""
        low, high = 0.0, math.inf
        for name, (shift, _) in self.rules.items():
            least = 0.0 if shift else -math.inf
            ends = (limits or {}).get(name, (least, math.inf))
            reached = [self.factor_to(values, name, end) for end in ends]
            # with max() and min() this way round, what is not a number bounds nothing
            low, high = max(low, min(reached)), min(high, max(reached))
        return low, high

    def scaled(self, values: ArrayLike, factor: ArrayLike) -> Array:
        """Parameter vectors that make the same torque."""
        k = np.asarray(factor, dtype=np.float64)
        out = np.tile(np.asarray(values, dtype=np.float64), (*k.shape, 1))
        for name, (shift, power) in self.rules.items():
            column = self.chain.names.index(name)
            out[..., column] = (out[..., column] + shift) * k**power - shift
        return out if k.shape else out.reshape(-1)

    def tangent(self, values: ArrayLike) -> Array:
        """Differentiate :meth:`scaled` by the factor's logarithm at one."""
        at = np.asarray(values, dtype=np.float64)
        out = np.zeros_like(at)
        for name, (shift, power) in self.rules.items():
            column = self.chain.names.index(name)
            out[column] = power * (at[column] + shift)
        return out

    def middle(self, values: ArrayLike) -> float:
        """Factor in the (geometric) middle of its bounds; one where these leave no middle.

        ``values`` is ``(n_parameters,)`` in the order of ``joint.names``.
        """
        low, high = self.bounds(values)
        return math.sqrt(low * high) if 0.0 < low < high else 1.0


def scalings(
    joint: Joint, added_inertia: float = 0.0, added_moment: float = 0.0
) -> tuple[Scaling, ...]:
    """Find the scalings a joint has while nothing behind the gearbox is known.

    Parameters
    ----------
    joint
        The mechanism.
    added_inertia, added_moment
        Of a known mass on the load in every recording, kg m² (kg) and kg m. It is one with the load
        where this has what the mass brings (inertia, first moment) as parameters, and else takes
        the scaling away.

    Returns
    -------
    tuple of Scaling
        One for every element with ``mu_1`` and ``mu_2`` that has something behind it. One mu for
        both power flows leaves none: ``lambda_1`` is 1 then. Nor does a Stribeck rise of the load
        loss, which multiplies ``mu_1`` and not ``1 + mu_1``: low speeds identify the factor.
    """
    known = {"load.inertia": added_inertia, "load.first_moment": added_moment}
    known = {name: amount for name, amount in known.items() if amount}
    if not set(known) <= set(joint.names):
        return ()
    family = []
    for i, element in enumerate(joint.elements):
        of_element = [p for p in joint.parameters if p.owner == element.name]
        risen = any("stribeck_load_ratio" in slots_of(p) for p in of_element)
        # ratios, angles and speeds do not grow with the torque behind the gearbox
        owners = {e.name for e in joint.elements[i + 1 :]} | {"load"}
        rules = {
            p.name: (known.get(p.name, 0.0), 1)
            for p in joint.parameters
            if p.owner in owners and p.row.role == "own"
        }
        if rules and element.load_loss == "two" and not risen:
            # alpha_1 = 1/(1 + mu_1), alpha_2 = 1/(1 - mu_2), eq. (6)
            rules |= {f"{element.name}.load_drive": (1.0, -1)}
            rules |= {f"{element.name}.load_back": (-1.0, -1)}
            rules |= {p.name: (0.0, -p.row.scaled_by) for p in of_element if p.row.scaled_by}
            family.append(Scaling(joint, element.name, rules))
    return tuple(family)
