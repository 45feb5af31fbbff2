"""One element of the transmission, and the load at its end (section 2.2).

Options choose the terms: each choice brings rows of the table of quantities, and so parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, ClassVar

from bayesfric.base.errors import nearest
from bayesfric.mechanism.quantities import (
    CHOICES,
    CYCLES,
    LOAD_CHOICES,
    QUANTITIES,
    Motion,
    Quantity,
    State,
)

STANDARD_GRAVITY = 9.80665  # m/s²


def _unit_torque(state: State) -> Any:
    return 1.0 + 0.0 * state.speed


def _by_signal(name: Any) -> tuple[Quantity, ...]:
    """Describe a torque by a further column of the recording, known up to its coefficient."""
    if not (isinstance(name, str) and name.isidentifier() and name not in QUANTITIES):
        problem = "is not a name of a column that a parameter can have"
        raise ValueError(f"signals = {name!r} {problem}; write letters, digits and _")
    label = name.replace("_", r"\_")
    row = Quantity(
        name, QUANTITIES["offset"].units, rf"k_{{{{\mathrm{{{{{label}}}}}}}}}",
        f"torque by the column {name}, for a value of one there",
        option="signals", choice=name, column=_unit_torque, signal=name, slots=(),
        lower=-math.inf, stores=True, measurand="constant",
    )  # fmt: skip
    return (row,)


# Options that list something, and the quantities that each entry brings.
LISTED: Mapping[str, Callable[[Any], tuple[Quantity, ...]]] = {**CYCLES, "signals": _by_signal}


class _Bearer:
    """Base of element and load: options bring quantities."""

    motion: Motion
    subscript: str
    choices: Mapping[str, Any]  # of the options that are set
    quantities: tuple[Quantity, ...]  # rows of the table that these bring, in its order
    _options: ClassVar[Mapping[str, tuple[tuple[str | bool, ...], str]]]

    def _set(self, choices: Mapping[str, Any], **fields: Any) -> None:
        rows = _brought(self._options, choices)
        fields |= {"quantities": rows, "choices": {q.option: choices[q.option] for q in rows}}
        for key, value in fields.items():
            object.__setattr__(self, key, value)

    def has(self, *names: str) -> bool:
        """Whether it has at least one of these quantities, by their names in the table."""
        return any(q.name in names for q in self.quantities)


@dataclass(frozen=True, init=False)
class Element(_Bearer):
    """Motor, belt, gearbox, bearing: every one obeys the same equation.

    With ``T`` the torque at its output brought to its input side, ``T =
    torque_out / ratio``, and ``v``, ``a`` speed and acceleration of its input,

    ``torque_in = T + J a + (Fr + mu |T|)(1 + c exp(-(v/v0)²)) sign(v) + f v + f3 v|v|``

    which is section 2.2 of the paper with the friction law of eq. (2); eq. (1)
    is its ``mu = 0`` case. ``mu`` is ``mu_1`` while ``T v > 0`` (the motor side
    drives) and ``mu_2`` while ``T v < 0`` (the load drives). Custom terms
    (:class:`bayesfric.Term`) are added to it.

    Parameters
    ----------
    name
        Used in parameter names.
    ratio
        Input speed over output speed, positive.
    motion
        Whether the element's input turns or slides, ``rotary`` or ``linear``.
    subscript
        For the LaTeX symbols; the name if left out.
    choices, **options
        Options of :data:`bayesfric.mechanism.quantities.CHOICES`: ``inertia=True``,
        ``coulomb="by-direction"``, ``viscous=True``, ``load_loss="two"`` and so on;
        what is written out replaces what the mapping has.

    Raises
    ------
    ValueError
        If there is no such option, or no such choice of one.

    Notes
    -----
    Further options add to this equation: viscous friction by direction, a power of speed,
    temperature, warming up, cogging, friction that depends on the angle, another exponent than 2 of
    the Stribeck effect, and ``mu`` by direction or growing with speed or torque.
    """

    _options = CHOICES
    name: str
    ratio: float
    motion: Motion
    subscript: str
    choices: Mapping[str, Any] = field(hash=False)

    def __init__(
        self,
        name: str,
        ratio: float = 1.0,
        *,
        motion: Motion = "rotary",
        subscript: str = "",
        choices: Mapping[str, Any] = MappingProxyType({}),
        **options: str | bool,
    ) -> None:
        self._set(
            {**choices, **options}, name=name, ratio=ratio, motion=motion, subscript=subscript
        )

    @property
    def load_loss(self) -> str:
        """Kind of load-dependent friction: ``none``, ``one`` (mu) or ``two`` (mu_1 and mu_2)."""
        return str(self.choices.get("load_loss", "none"))


@dataclass(frozen=True, init=False)
class Load(_Bearer):
    """What the last element moves: ``Gamma = Jc qdd + g ml sin(q + q_g)``, eq. (3).

    The printed paper leaves out ``g`` (see the notes on errata); ``ml`` is in kg m.

    Parameters
    ----------
    gravity
        ``g``, m/s²; negative for a joint mounted upside down.
    motion
        Whether the load turns or slides, ``rotary`` or ``linear``.
    subscript
        For the LaTeX symbols.
    choices, **options
        ``inertia``, ``first_moment``, ``gravity_angle``, ``spring``: whether the load has the term
        (``spring="stiffening"`` adds a cube of the position). Real arms do not hang at ``q = 0``:
        that is what ``gravity_angle`` is for. ``signals``: names of further columns of the
        recording, torques that are known up to a coefficient.

    Raises
    ------
    ValueError
        If there is no such option, or no such choice of one.
    """

    _options = LOAD_CHOICES
    name: ClassVar[str] = "load"
    gravity: float
    motion: Motion
    subscript: str
    choices: Mapping[str, Any] = field(hash=False)

    def __init__(
        self,
        *,
        gravity: float = STANDARD_GRAVITY,
        motion: Motion = "rotary",
        subscript: str = "c",
        choices: Mapping[str, Any] = MappingProxyType({}),
        **options: str | bool,
    ) -> None:
        self._set({**choices, **options}, gravity=gravity, motion=motion, subscript=subscript)


def _brought(
    options: Mapping[str, tuple[tuple[str | bool, ...], str]], choices: Mapping[str, Any]
) -> tuple[Quantity, ...]:
    """Rows that choices bring: those of the table, and behind them those of cycles."""
    listed: list[Quantity] = []
    for option, choice in choices.items():
        if option in LISTED:
            for entry in choice:
                listed += LISTED[option](entry)
        elif option not in options:
            raise ValueError(f"there is no option {option!r}; {nearest(option, options)}")
        elif choice not in (*options[option][0], False, "none"):
            known = ", ".join(map(repr, options[option][0]))
            raise ValueError(f"{option} = {choice!r} is not a choice; there is {known}")
    rows = (q for q in QUANTITIES.values() if q.option in choices)
    chosen = (q for q in rows if q.brought_by(choices[q.option]))
    return tuple(dict.fromkeys((*chosen, *listed)))
