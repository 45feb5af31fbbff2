"""Custom terms, and others that the compiled kernels do not write out: compiled columns.

The forward model calls a compiled column at every step; the inverse model does so where a
parameter shapes it, and else multiplies a column that is computed once for a recording.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import cfunc, njit, types
from numba.core.errors import NumbaError
from numba.extending import intrinsic

from bayesfric.mechanism.quantities import QUANTITIES, Column, Quantity, State
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Inputs, Signal

_SIGNATURE = types.float64(*[types.float64] * 5)


@dataclass(frozen=True)
class Term:
    """A custom term that is linear in its coefficient.

    Parameters
    ----------
    name
        ``element.quantity``, for example ``motor.cogging``; the element is one of the joint's
        or ``load``.
    column
        Torque at the element's input for a coefficient of one: a function of a
        :class:`bayesfric.mechanism.quantities.State` of that element (``position``, ``speed``,
        ``direction``, ``time``), in operations that numba compiles, such as
        ``lambda m: np.sin(6 * m.position)``.
    unit
        Of the coefficient.
    symbol
        LaTeX without dollar signs.
    meaning
        One line for people.
    positive
        Whether the coefficient cannot be negative, as a loss; its default prior then is
        half-normal, else normal.

    Raises
    ------
    ValueError
        If the name is none, or taken.
    TypeError
        If the column cannot be compiled, as where it depends on acceleration or
        transmitted torque.
    """

    name: str
    column: Column
    unit: str = ""
    symbol: str = ""
    meaning: str = "a custom term"
    positive: bool = False

    def __post_init__(self) -> None:
        owner, dot, quantity = self.name.partition(".")
        if not (owner and dot and quantity.isidentifier()):
            raise ValueError(f"{self.name!r} is no name of a term; write element.quantity")
        if quantity in QUANTITIES:
            raise ValueError(f"{quantity!r} is a quantity of every element; choose another name")
        compiled(self.column, shaped=False)

    @property
    def owner(self) -> str:
        """Name of its element."""
        return self.name.partition(".")[0]

    @property
    def row(self) -> Quantity:
        """The term as a row of the table; without a symbol it is ``k`` with its name."""
        name = self.name.partition(".")[2]
        label = r"\mathrm{" + name.replace("_", r"\_") + "}"
        symbol = self.symbol or f"k_{{{label}}}"
        return Quantity(
            name,
            (self.unit, self.unit),
            symbol.replace("{", "{{").replace("}", "}}"),
            self.meaning,
            column=self.column,
            slots=(),
            lower=0.0 if self.positive else -np.inf,
            measurand="law" if self.positive else "constant",
        )


# An external torque on the load reduces that of the motor.
PUSH = Quantity(
    "load_torque", ("N m", "N"), "", "measured torque on the load", signal="load_torque",
    column=lambda m: -1.0 + 0.0 * m.speed, slots=(),
)  # fmt: skip


@dataclass(frozen=True)
class CarriedTerm:
    """A term of a joint that the kernels do not write out."""

    index: int  # of its parameter in the joint; -1 for a coefficient of one
    place: int  # index of its element; n_elements for the load, one more for the measurement
    reach: float  # speed of its element's input over the joint's
    row: Quantity
    shape: int = -1  # index of the parameter that shapes its column; -1 where none does

    @property
    def address(self) -> int:
        """Address of the compiled column, for the kernels."""
        assert self.row.column is not None
        return int(compiled(self.row.column, shaped=bool(self.row.shape)).address)


def signal_of(row: Quantity, inputs: Inputs) -> Signal:
    """Return the signal that a term is, or is multiplied by."""
    signal = inputs.signal(row.signal)
    if signal is None:
        raise ValueError(f"{row.name}: the inputs hold no {row.signal}")
    return signal


def along(
    row: Quantity, reach: float, position: Array, speed: Array, time: Array, inputs: Inputs
) -> Array:
    """Return the torque ``(N,)`` of a term for a coefficient of one along a joint's motion."""
    factor: Any = signal_of(row, inputs).at(time) - row.zero if row.signal else 1.0
    if row.column is None:
        return np.asarray(factor)
    position, speed = reach * position, reach * speed
    if row.option or row.signal:
        # columns of the table take arrays, and need no compilation
        at = State(position, speed, 0.0, np.sign(speed), time, 0.0, 0.0)
        shape = (QUANTITIES[row.shape].start,) if row.shape else ()
        return np.asarray(factor * row.column(at, *shape))
    address = int(compiled(row.column, shaped=False).address)
    return np.asarray(_along(address, position, speed, np.sign(speed), time))


class _Motion(NamedTuple):
    """The part of a :class:`State` that a carried term may depend on."""

    position: float
    speed: float
    direction: float
    time: float


@lru_cache(maxsize=256)
def compiled(column: Column, *, shaped: bool) -> Any:
    """Compile a column of position, speed, direction, time and, if ``shaped``, a parameter."""
    inner: Any = njit(column)

    def of_state(q: float, qd: float, sign: float, time: float, _: float) -> float:
        return float(inner(_Motion(q, qd, sign, time)))

    def of_state_and_shape(q: float, qd: float, sign: float, time: float, shape: float) -> float:
        return float(inner(_Motion(q, qd, sign, time), shape))

    try:
        return cfunc(_SIGNATURE)(of_state_and_shape if shaped else of_state)
    except NumbaError as error:
        reason = str(error).strip().splitlines()[-1]
        raise TypeError(
            f"the column cannot be compiled ({reason}): use numbers, numpy and math functions of "
            "position, speed, direction and time"
        ) from None


def _call(typing_context, address, position, speed, direction, time, shape):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """Call a compiled column by its address, so that one compiled kernel serves all terms."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]  # noqa: ARG001
        kind = ir.FunctionType(ir.DoubleType(), [ir.DoubleType()] * 5)
        function = builder.inttoptr(arguments[0], kind.as_pointer())
        return builder.call(function, arguments[1:])

    return types.float64(types.int64, *[types.float64] * 5), generate


call: Any = intrinsic(_call)


@njit(cache=True)
def _along(address: int, position: Array, speed: Array, direction: Array, time: Array) -> Array:
    out = np.empty(position.shape[0])
    for i in range(position.shape[0]):
        out[i] = call(address, position[i], speed[i], direction[i], time[i], 0.0)
    return out
