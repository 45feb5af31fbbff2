"""Parameters: name, unit, symbol and support of a quantity of one element of a chain.

Names are ``element.quantity``; sliding elements have forces and metres, not torques and angles.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from bayesfric.mechanism.quantities import Motion, Quantity

TURN = 2.0 * math.pi
Angle = TypeVar("Angle", float, NDArray[np.float64])
# The word alone, not as a part of a name such as noise.torque, torque_constant or torque-steps.
_TORQUE = re.compile(r"(?<![\w.-])torque(s?)(?![\w]|[.-]\w)")


@dataclass(frozen=True)
class Parameter:
    """One parameter of the joint."""

    name: str  # element.quantity, for example motor.inertia
    row: Quantity  # its row in the table of quantities
    owner: str  # name of the element, load, drive, or empty for the whole chain
    unit: str  # as printed, in SI
    symbol: str  # LaTeX without dollar signs, the paper's where it has one
    meaning: str  # one line for people

    @property
    def quantity(self) -> str:
        """The part after the dot of its name: ``inertia`` of ``motor.inertia``."""
        return self.row.name

    @property
    def lower(self) -> float:
        """Lower end of its support; no prior may reach outside."""
        return self.row.lower

    @property
    def upper(self) -> float:
        """Upper end of its support."""
        return self.row.upper

    @property
    def default(self) -> float:
        """Value where it is not part of the model."""
        return self.row.default

    @property
    def circular(self) -> bool:
        """Whether values a turn apart are the same."""
        return self.row.circular


def parameter(
    owner: str, row: Quantity, motion: Motion, subscript: str, *, alone: bool = False
) -> Parameter:
    """Describe one quantity of one element."""
    meaning = row.alone.format(owner) if alone and row.alone else row.meaning
    return Parameter(
        name=f"{owner}.{row.name}" if owner else row.name,
        row=row,
        owner=owner,
        unit=row.unit(motion),
        symbol=row.symbol.format(subscript),
        meaning=effort_words(meaning, motion),
    )


def turned(value: Angle, towards: float) -> Angle:
    """Add whole turns to an angle until it lies at most half a turn from another one."""
    out: Angle = value + TURN * np.round((towards - value) / TURN)
    return out


def scales_with_torque(unit: str) -> bool:
    """Whether a wrong scale of the torque multiplies a number of this unit.

    A wrong torque constant multiplies inertia, friction and offsets; not a loss per torque, a speed
    or an angle.
    """
    return unit.startswith(("kg", "N"))


def effort_words(words: str, motion: Motion) -> str:
    """Say force in place of torque of what slides, and 2π m in place of a turn."""
    if motion == "rotary":
        return words
    return _TORQUE.sub(r"force\1", words).replace("cycles a turn", "cycles in 2π m")


def quantity_of(name: str) -> str:
    """Give the quantity of a parameter or total: ``inertia`` of ``total.inertia``.

    An offset may go by a recording's name, which says nothing: ``total.offset.<recording>``.
    """
    first, _, rest = name.removeprefix("total.").partition(".")
    return first if first == "offset" or not rest else rest
