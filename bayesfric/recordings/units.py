"""Units: every measured number becomes SI here, and nowhere else."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from bayesfric.errors import BadInput, Unfit

if TYPE_CHECKING:
    import pint

Kind = Literal[
    "time",
    "angle",
    "length",
    "angular_speed",
    "speed",
    "torque",
    "force",
    "current",
    "voltage",
    "resistance",
    "frequency",
    "mass",
    "torque_constant",
    "force_constant",
    "share",
]


# A unit of every kind, and how to tell a user about it.
_KINDS: dict[Kind, tuple[str, str]] = {
    "time": ("s", "a time like 's' or '5 ms'"),
    "angle": ("rad", "an angle like 'rad', 'deg' or 'turn/4096'"),
    "length": ("m", "a length like 'm' or '2.5 mm'"),
    "angular_speed": ("rad/s", "an angular speed like 'rad/s', 'deg/s' or 'rpm'"),
    "speed": ("m/s", "a speed like 'm/s' or 'mm/s'"),
    "torque": ("N m", "a torque like 'N m' or '9.84e-5 N m'"),
    "force": ("N", "a force like 'N'"),
    "current": ("A", "a current like 'A' or 'mA'"),
    "voltage": ("V", "a voltage like 'V' or 'V/885'"),
    "resistance": ("ohm", "a resistance like '3.4 ohm'"),
    "frequency": ("Hz", "a frequency like '100 Hz'"),
    "mass": ("kg", "a mass like '2 kg'"),
    "torque_constant": ("N m/A", "a torque constant like '0.32 N m/A'"),
    "force_constant": ("N/A", "a force constant like '35 N/A'"),
    "share": ("", "a plain number like '1' or '0.9'"),
}

# pint reads "Nm" as a number times a metre; everybody else means newton metre
_NEWTON_METRE = re.compile(r"(?<![A-Za-zµμ])([mkMcuµμ]?)N-?m(?![A-Za-z])")
_ALLOWED = re.compile(r"[\w\s*/^().+\-%µμΩ°·²³]*")
# pint's parser evaluates powers, and 9**9**9 would keep it busy for ever: of one digit only,
_LARGE_POWER = re.compile(r"(\*\*|\^)\s*(?!-?\d(?![\d.*^]))|[²³]{2}")
# and of floating-point numbers, which overflow at once where (9**9)**9 would grow for ever
_WHOLE_NUMBER = re.compile(r"(?<![\w.])(\d+\.\d*|\.?\d+)(?:[eE][+-]?\d+)?(?![\w.])")
_LONGEST = 80
# What ``bayesfric init --from`` puts behind what it guessed.
GUESSED = "?"


@cache
def _registry() -> pint.UnitRegistry[Any]:
    # pint takes half a second to set up, so only the first conversion pays for it
    import pint

    registry: pint.UnitRegistry[Any] = pint.UnitRegistry()
    registry.define("@alias turn = rev")
    registry.define("@alias ohm = Ohm = Ohms")
    return registry


@cache
def _base(text: str) -> tuple[float, tuple[tuple[str, float], ...]]:
    """Return the SI factor of a unit text and its base units' exponents."""
    if len(text) > _LONGEST or not _ALLOWED.fullmatch(text) or _LARGE_POWER.search(text):
        raise ValueError(f"'{text[:_LONGEST]}' is not a unit")
    if not text.strip():
        return 1.0, ()
    prepared = _WHOLE_NUMBER.sub(lambda m: m[0] + ".0" if m[0].isdigit() else m[0], text)
    prepared = _NEWTON_METRE.sub(r"(\1N*m)", prepared)
    prepared = re.sub(r"(?<=[\d.])\s*\((?=[mkMcuµμ]?N\*m\))", " * (", prepared)
    try:
        value: Any = _registry().Quantity(prepared).to_base_units()
        factor = float(value.magnitude)
        exponents = {
            str(name): float(power) for name, power in dict(value.unit_items()).items() if power
        }
    except Exception as error:  # pint and its tokenizer raise a dozen unrelated types
        raise ValueError(f"'{text}' is not a known unit") from error
    if not math.isfinite(factor):
        raise ValueError(f"'{text}' is not a finite quantity")
    return factor, tuple(sorted(exponents.items()))


def known(text: str) -> str:
    """Refuse what was guessed, and not looked at since."""
    if text.endswith(GUESSED):
        plain = text.removesuffix(GUESSED)
        raise Unfit(
            f"'{plain}' without the '{GUESSED}', or what is right, once you have looked at it",
            f"'{text}' is a guess of init",
        )
    return text


def quantity(text: str, *kinds: Kind) -> float:
    """Read a scalar with its unit, of one of some kinds, in SI and Hz, or raise `Unfit`."""
    known(text)
    return _product([text], kinds)


def quantity_of(texts: Sequence[str], kind: Kind) -> float:
    """Read a product of scalars with their units, in SI, or raise `Unfit`."""
    return _product(texts, [kind])


def scale(units: Sequence[str], kind: Kind, where: str = "unit") -> float:
    """Return the positive SI value of one count of a channel, or of a constant.

    ``units`` are its unit and whatever multiplies it: ``["V", "35.15 N/V"]``. What is of
    another kind is bad input at ``where``.
    """
    try:
        factor = _product(units, [kind])
    except Unfit as error:
        mend = f"give {error.wanted}"
        with suppress(ValueError):
            if kind == "angle" and not any(_base(text)[1] for text in units):
                mend = "an angle needs its unit: write 'turn/4096', not '1/4096'"
        raise BadInput(where, str(error), mend) from error
    if not factor > 0:
        raise BadInput(
            where,
            f"{_listed(units)} is {factor:g}, not positive",
            "give a positive value; use sign = -1",
        )
    return factor


def _product(texts: Sequence[str], kinds: Sequence[Kind]) -> float:
    """Return the SI factor of a product of units that is of one of some kinds."""
    expected = " or ".join(_KINDS[kind][1] for kind in kinds)
    factor = 1.0
    powers: dict[str, float] = {}
    for text in texts:
        try:
            part, exponents = _base(text)
        except ValueError as error:
            raise Unfit(expected, str(error)) from error
        factor *= part
        for name, power in exponents:
            powers[name] = powers.get(name, 0.0) + power
    powers = {name: power for name, power in powers.items() if power != 0}
    for kind in kinds:
        # a torque constant is also quoted as its reciprocal speed constant, V s/rad
        seen = {k: v for k, v in powers.items() if kind != "torque_constant" or k != "radian"}
        if seen == dict(_base(_KINDS[kind][0])[1]):
            return factor
    raise Unfit(expected, f"got {_listed(texts)}")


def _listed(texts: Sequence[str]) -> str:
    return " times ".join(f"'{text}'" for text in texts)


def _number(*kinds: Kind, off: bool = False) -> BeforeValidator:
    """Return a validator that turns text with a unit into an SI number."""

    def read(value: Any) -> Any:
        if isinstance(value, bool):
            raise Unfit("a number or text with a unit", f"got {value}")
        if off and value == "off":
            return 0.0
        return quantity(value, *kinds) if isinstance(value, str) else value

    return BeforeValidator(read)


Seconds = Annotated[float, _number("time"), Field(ge=0, allow_inf_nan=False)]
Hertz = Annotated[float, _number("frequency"), Field(gt=0, allow_inf_nan=False)]
HertzOrOff = Annotated[float, _number("frequency", off=True), Field(ge=0, allow_inf_nan=False)]
Kilograms = Annotated[float, _number("mass"), Field(ge=0, allow_inf_nan=False)]
Metres = Annotated[float, _number("length"), Field(ge=0, allow_inf_nan=False)]
