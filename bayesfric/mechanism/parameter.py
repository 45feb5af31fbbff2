"""What a parameter is: its name, unit, symbol, support and one line of meaning.

Everything the package ever says about a quantity (units in tables, symbols in
figures, bounds of priors) is looked up here and nowhere else.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

Motion = Literal["rotary", "linear"]
TURN = 2.0 * math.pi
Angle = TypeVar("Angle", float, NDArray[np.float64])
Entry = TypeVar("Entry")
# The word alone, not as a part of a name such as noise.torque, torque_constant or torque-steps.
_TORQUE = re.compile(r"(?<![\w.-])torque(s?)(?![\w]|[.-]\w)")


@dataclass(frozen=True)
class Parameter:
    """One number the joint is described by.

    Attributes
    ----------
    name
        ``element.quantity``, for example ``motor.inertia``.
    quantity
        The part behind the dot; defaults and priors are chosen by it.
    unit
        Unit as printed, in SI.
    symbol
        LaTeX symbol without dollar signs, the paper's where it has one.
    lower, upper
        Support; no prior may reach outside.
    meaning
        One line for people.
    default
        Value the quantity has where it is not part of the model.
    circular
        Whether values a turn apart are the same, so that no value is at an end.
    """

    name: str
    quantity: str
    unit: str
    symbol: str
    lower: float
    upper: float
    meaning: str
    default: float = 0.0
    circular: bool = False


@dataclass(frozen=True)
class _Quantity:
    units: tuple[str, str]  # rotary, linear
    symbol: str
    lower: float
    upper: float
    meaning: str
    default: float = 0.0
    circular: bool = False


_INF = float("inf")
_QUANTITIES: dict[str, _Quantity] = {
    "inertia": _Quantity(("kg m²", "kg"), "J_{{{}}}", 0.0, _INF, "inertia at the element's input"),
    "viscous": _Quantity(
        ("N m s", "N s/m"), "f_{{{}}}", 0.0, _INF, "loss growing in proportion to speed"
    ),
    "coulomb": _Quantity(
        ("N m", "N"), "C_{{{}}}", 0.0, _INF, "constant loss, same in both directions"
    ),
    "coulomb_positive": _Quantity(
        ("N m", "N"), "C_{{{}1}}", 0.0, _INF, "constant loss at positive speed"
    ),
    "coulomb_negative": _Quantity(
        ("N m", "N"), "C_{{{}2}}", 0.0, _INF, "constant loss at negative speed"
    ),
    "quadratic": _Quantity(
        ("N m s²", "N s²/m²"), "f_{{3,{}}}", 0.0, _INF, "loss growing with the square of speed"
    ),
    "stribeck_ratio": _Quantity(
        ("", ""), "c_{{{}}}", 0.0, _INF, "relative rise of constant and load loss at low speed"
    ),
    "stribeck_velocity": _Quantity(
        ("rad/s", "m/s"),
        r"\dot q_{{0,{}}}",
        0.0,
        _INF,
        "speed at which the low-speed rise has fallen to 37 %",
        default=1.0,
    ),
    "load": _Quantity(
        ("", ""), r"\mu_{{{}}}", 0.0, _INF, "loss per transmitted torque, both directions of power"
    ),
    "load_drive": _Quantity(
        ("", ""), r"\mu_{{{}1}}", 0.0, _INF, "loss per transmitted torque when the motor drives"
    ),
    "load_back": _Quantity(
        ("", ""), r"\mu_{{{}2}}", 0.0, _INF, "loss per transmitted torque when the load drives"
    ),
    "first_moment": _Quantity(("kg m", ""), "ml", 0.0, _INF, "mass times distance to its centre"),
    "gravity_angle": _Quantity(
        ("rad", ""), "q_g", -_INF, _INF, "angle added to q in gravity", circular=True
    ),
    "offset": _Quantity(
        ("N m", "N"), r"\Gamma_0", -_INF, _INF, "constant torque in the measured motor torque"
    ),
    "gain": _Quantity(
        ("", ""),
        "k",
        0.0,
        _INF,
        "true motor torque over the torque computed from current or voltage",
        default=1.0,
    ),
}


def parameter(element: str, quantity: str, motion: Motion, subscript: str) -> Parameter:
    """Describe one quantity of one element.

    Parameters
    ----------
    element
        Element name; empty for the quantities of the whole chain (``offset``).
    quantity
        A key of the table above.
    motion
        Whether the element's input turns or slides; it sets the unit.
    subscript
        LaTeX subscript that tells this element's symbols from another's.
    """
    entry = _QUANTITIES[quantity]
    return Parameter(
        name=f"{element}.{quantity}" if element else quantity,
        quantity=quantity,
        unit=entry.units[0 if motion == "rotary" else 1],
        symbol=entry.symbol.format(subscript),
        lower=entry.lower,
        upper=entry.upper,
        meaning=effort_words(entry.meaning, motion),
        default=entry.default,
        circular=entry.circular,
    )


def entry_of(table: Mapping[str, Entry], quantity: str, form: str) -> Entry:
    """Look a quantity up in a table that must know them all: one it drops would count as zero.

    Parameters
    ----------
    table
        By quantity.
    quantity
        What to look up.
    form
        What the table is of, for the complaint.

    Raises
    ------
    KeyError
        If the table does not know the quantity.
    """
    if quantity not in table:
        raise KeyError(f"{form} does not know the quantity {quantity!r}")
    return table[quantity]


def turned(value: Angle, towards: float) -> Angle:
    """Add whole turns to an angle until it lies at most half a turn from another one."""
    out: Angle = value + TURN * np.round((towards - value) / TURN)
    return out


def effort_words(words: str, motion: Motion) -> str:
    """Say force in place of torque of what slides.

    Parameters
    ----------
    words
        Worded for what turns.
    motion
        Of what is spoken of.
    """
    return words if motion == "rotary" else _TORQUE.sub(r"force\1", words)
