"""One element of the transmission, and the load at its end (section 2.2)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
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


def _once(state: State) -> Any:
    """Give a torque of one, that a signal is multiplied by."""
    return 1.0 + 0.0 * state.speed


def _by_signal(name: str) -> tuple[Quantity]:
    """Describe a torque by a further column of the recording, known up to its coefficient."""
    label = name.replace("_", r"\_")
    row = Quantity(
        name,
        QUANTITIES["offset"].units,
        rf"k_{{{{\mathrm{{{{{label}}}}}}}}}",
        f"torque by the column {name}, for a value of one there",
        option="signals",
        choice=name,
        column=_once,
        signal=name,
        slots=(),
        lower=-math.inf,
        stores=True,
    )
    return (row,)


# Options that list something, and the quantities that each entry brings.
LISTED: Mapping[str, Callable[[Any], tuple[Quantity, ...]]] = {**CYCLES, "signals": _by_signal}


class _Bearer:
    """What bears quantities, each brought by a choice of an option."""

    motion: Motion
    subscript: str
    quantities: tuple[Quantity, ...]
    _options: ClassVar[Mapping[str, Mapping[str | bool, str]]]  # options and their choices

    def _set(
        self, choices: Mapping[str, Any], quantities: tuple[Quantity, ...], **given: Any
    ) -> None:
        given["quantities"] = _chosen(self._options, choices, quantities)
        for key, value in given.items():
            object.__setattr__(self, key, value)

    @property
    def choices(self) -> dict[str, Any]:
        """What is chosen of every option that is not left out."""
        found: dict[str, Any] = {}
        for option in dict.fromkeys(q.option for q in self.quantities if q.option):
            rows = [q for q in self.quantities if q.option == option]
            if option in LISTED:
                found[option] = tuple(dict.fromkeys(q.choice for q in rows))
            else:
                known = self._options[option]
                # all of the rows, and no row that is missing
                found[option] = next(
                    c for c in known
                    if [q for q in QUANTITIES.values() if q.option == option and q.brought_by(c)]
                    == rows
                )  # fmt: skip
        return found

    def has(self, *names: str) -> bool:
        """Whether it has one of these quantities."""
        return any(q.name in names for q in self.quantities)


@dataclass(frozen=True, init=False)
class Element(_Bearer):
    """Motor, belt, gearbox, bearing: every one obeys the same equation.

    With ``T`` the torque at its output brought to its input side, ``T =
    torque_out / ratio``, and ``v``, ``a`` speed and acceleration of its input,

    ``torque_in = T + J a + (Fr + mu |T|)(1 + c exp(-(v/v0)²)) sign(v) + f v + f3 v|v|``

    which is section 2.2 of the paper with the friction law of eq. (2); eq. (1)
    is its ``mu = 0`` case. ``mu`` is ``mu_1`` while ``T v > 0`` (the motor side
    drives) and ``mu_2`` while ``T v < 0`` (the load drives). Terms of one's own
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
    quantities
        Rows of the table, where no choice says otherwise.
    **choices
        Options of :data:`bayesfric.mechanism.quantities.CHOICES`: ``inertia=True``,
        ``coulomb="by-direction"``, ``viscous=True``, ``load_loss="two"`` and so on.

    Raises
    ------
    ValueError
        If there is no such option, or no such choice of one.
    """

    _options = CHOICES
    name: str
    ratio: float
    motion: Motion
    subscript: str
    quantities: tuple[Quantity, ...]

    def __init__(
        self,
        name: str,
        ratio: float = 1.0,
        *,
        motion: Motion = "rotary",
        subscript: str = "",
        quantities: tuple[Quantity, ...] = (),
        **choices: str | bool,
    ) -> None:
        self._set(choices, quantities, name=name, ratio=ratio, motion=motion, subscript=subscript)

    @property
    def load_loss(self) -> str:
        """How many losses per transmitted torque it has, ``none``, ``one`` or ``two``."""
        return str(self.choices.get("load_loss", "none"))


@dataclass(frozen=True, init=False)
class Load(_Bearer):
    """What the last element moves: ``Gamma = Jc qdd + g ml sin(q + q_g)``, eq. (3).

    The printed paper leaves out ``g`` (see the notes on errata); ``ml`` is in kg m.

    Parameters
    ----------
    gravity
        m/s².
    motion
        Whether the load turns or slides, ``rotary`` or ``linear``.
    subscript
        For the LaTeX symbols.
    quantities
        Rows of the table, where no choice says otherwise.
    **choices
        ``inertia``, ``first_moment``, ``gravity_angle``: whether the load has the term. Real
        arms do not hang at ``q = 0``: that is what ``gravity_angle`` is for. ``signals``: names
        of further columns of the recording, torques that are known up to a coefficient.

    Raises
    ------
    ValueError
        If there is no such option.
    """

    _options = LOAD_CHOICES
    name: ClassVar[str] = "load"
    gravity: float
    motion: Motion
    subscript: str
    quantities: tuple[Quantity, ...]

    def __init__(
        self,
        *,
        gravity: float = STANDARD_GRAVITY,
        motion: Motion = "rotary",
        subscript: str = "c",
        quantities: tuple[Quantity, ...] = (),
        **choices: str | bool,
    ) -> None:
        self._set(choices, quantities, gravity=gravity, motion=motion, subscript=subscript)


def _chosen(
    options: Mapping[str, Mapping[str | bool, str]],
    choices: Mapping[str, Any],
    given: tuple[Quantity, ...],
) -> tuple[Quantity, ...]:
    """Rows that choices bring and those given, in the order of the table; choices come first."""
    repeated: list[Quantity] = []
    for option, choice in choices.items():
        if option in LISTED:
            repeated += [q for one in choice for q in LISTED[option](_listed(option, one))]
            continue
        if option not in options:
            raise ValueError(f"there is no option {option!r}; {nearest(option, options)}")
        if choice not in (*options[option], False, "none"):
            known = ", ".join(map(repr, options[option]))
            raise ValueError(f"{option} = {choice!r} is no choice; there is {known}")
    table = [q for q in QUANTITIES.values() if q.option in options]
    chosen = (
        q for q in table if (q.brought_by(choices[q.option]) if q.option in choices else q in given)
    )
    kept = (q for q in given if q not in table and not (q.option in LISTED and q.option in choices))
    return tuple(dict.fromkeys((*chosen, *kept, *repeated)))


def _listed(option: str, one: Any) -> int | str:
    if option not in CYCLES:
        if not (isinstance(one, str) and one.isidentifier() and one not in QUANTITIES):
            what = "is no name of a column that a parameter can have"
            raise ValueError(f"{option} = {one!r} {what}; write letters, digits and _")
        return one
    if isinstance(one, bool) or not isinstance(one, int) or one < 1:
        raise ValueError(f"{option} = {one!r} is no number of cycles a turn; write 1, 2, ...")
    return one
