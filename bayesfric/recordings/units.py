"""Conversion of units to SI."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from bayesfric.base.errors import BadInput, Unfit

if TYPE_CHECKING:
    import pint

# fmt: off
Kind = Literal[
    "time", "angle", "length", "angular_speed", "speed", "torque", "force", "current", "voltage",
    "resistance", "frequency", "mass", "torque_constant", "force_constant", "share",
]
# fmt: on


# The SI unit of a kind of quantity, and an example for messages.
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

# Kinds of a sliding joint in place of those of a turning one.
_SLIDING: dict[Kind, Kind] = {"angle": "length", "angular_speed": "speed", "torque": "force"}

# What data sheets write, and what pint would read as another quantity, as none, or, by its version,
# as either: "Nm", "N.m", "Nmm", "oz-in", "lbs-ft", "kg cm", "RPM", "1/min", "DEG/S", "Arms".
_SPELLINGS = [
    (re.compile(rf"(?<![A-Za-zµμ])(?:{pattern})(?![A-Za-z])"), replacement)
    for pattern, replacement in (
        (r"(?i:newton)[-_ ]?(?i:met(?:er|re)s?)", "(N*m)"),
        (r"((?:da|[munµμkcdhM])?)N[-*]?([cm]?m)", r"(\1N*\2)"),
        (r"ozf?[-* ]?in|in[-* ]?ozf?", "(ozf*inch)"),
        (r"lb[fs]?[-* ]?(in|ft)", r"(lbf*\1)"),
        (r"(in|ft)[-* ]?lb[fs]?", r"(lbf*\1)"),
        (r"(k?g)f?[-* ]?([cm]m)", r"(\1f*\2)"),
        (r"kgf?-?m", "(kgf*m)"),
        (r"(?:rev |r )?min\^-1|(?<![\d.])1/min|[rU]/min|(?i:rpm)", "rpm"),
        (r"[kK](?i:rpm)|(?<=/)1000 ?(?i:rpm)", "krpm"),
        (r"(?i:dps)", "(deg/s)"),
        (r"(?i:radps)", "(rad/s)"),
        (r"(?i:deg(?:rees?)?)", "deg"),
        (r"(?i:rad(?:ians?)?)", "rad"),
        (r"(?i:turns?|rev(?:s|olutions?)?|rotations?)", "turn"),
        (r"(?i:rps)", "(turn/s)"),
        (r"(?<=/)(?i:s(?:ec(?:ond)?)?)", "s"),
        (r"(?i:sec(?:ond)?s?)", "s"),
        (r"(?i:amp(?:ere)?s?)", "A"),
        (r"([mµμu]?[AV]) ?rms", r"\1"),
        (r"(?i:volts?)", "V"),
    )
]
# Written by ``bayesfric init --from`` for what a log does not give.
OPEN = "?"


@cache
def _registry() -> pint.UnitRegistry[Any]:
    # pint takes half a second to set up
    import pint

    registry: pint.UnitRegistry[Any] = pint.UnitRegistry()
    registry.define("@alias turn = rev")
    registry.define("@alias ohm = Ohm = Ohms")
    return registry


@cache
def _base(text: str) -> tuple[float, dict[str, float]]:
    """Return the SI factor of a unit text and the powers of its base units."""
    if not text.strip():
        return 1.0, {}
    # powers without a sign, "rad s-1", and products by a dot, of which versions of pint differ
    prepared = re.sub(r"(?<=[a-z])(?<![\d.]e)-(?=\d)", "^-", text)
    prepared = re.sub(r"(?<=[A-Za-zµμ])[.·⋅](?=[A-Za-zµμ])", "*", prepared)
    for pattern, replacement in _SPELLINGS:
        prepared = pattern.sub(replacement, prepared)
    # pint takes a number before a bracket for a call
    prepared = re.sub(r"(?<=[\d.])\s*\((?=\D)", " * (", prepared)
    try:
        value: Any = _registry().Quantity(prepared).to_base_units()
        factor = float(value.magnitude)
        powers = {str(name): float(power) for name, power in value.unit_items() if power}
    except Exception as error:  # pint and its tokenizer raise a dozen unrelated types
        raise ValueError(f"'{text}' is not a known unit") from error
    if not math.isfinite(factor):
        raise ValueError(f"'{text}' is not a finite quantity")
    return factor, powers


def known(text: str) -> str:
    """Refuse a unit that ``init --from`` left open."""
    if OPEN in text:
        raise Unfit("what is right", f"'{text}' was left open by init")
    return text


def quantity(text: str, *kinds: Kind) -> float:
    """Read a scalar with its unit, of one of some kinds, in SI and Hz, or raise `Unfit`."""
    known(text)
    return product([text], kinds)


def scale(units: Sequence[str], kind: Kind, where: str = "unit", *, positive: bool = True) -> float:
    """Return the SI value of a channel's unit, or of a constant, times whatever multiplies it."""
    try:
        factor = product(units, [kind])
    except Unfit as error:
        hint = f"{'give' if len(units) == 1 else 'their product has to be'} {error.wanted}"
        with suppress(ValueError):
            if kind == "angle" and not any(_base(text)[1] for text in units):
                hint = "an angle needs its unit: write 'turn/4096', not '1/4096'"
        raise BadInput(where, str(error), hint) from error
    if positive and not factor > 0:
        problem = f"{' times '.join(units)} is {factor:g}, not positive"
        raise BadInput(where, problem, "give a positive value; use sign = -1")
    return factor


def product(texts: Sequence[str], kinds: Sequence[Kind]) -> float:
    """Read a product of scalars with their units, of one of some kinds, in SI, or raise `Unfit`."""
    # recordings are mostly in SI units, and then need no pint
    if any(list(texts) == [_KINDS[kind][0]] for kind in kinds):
        return 1.0
    expected = " or ".join(_KINDS[kind][1] for kind in kinds)
    factor = 1.0
    powers = Counter[str]()
    for text in texts:
        try:
            part, unit_powers = _base(text)
        except ValueError as error:
            raise Unfit(expected, str(error)) from error
        factor *= part
        powers.update(unit_powers)
    if any(_of(powers, kind) for kind in kinds):
        return factor
    got = "got " + " times ".join(map(repr, texts))
    if any(kind in kinds and _of(powers, other) for kind, other in _SLIDING.items()):
        got += '; of a joint that slides say motion = "linear" under [mechanism]'
    raise Unfit(expected, got)


def _of(powers: Counter[str], kind: Kind) -> bool:
    """Whether powers of base units are those of a kind."""
    # a torque constant is also quoted as its reciprocal speed constant, V s/rad
    ignored = {"radian"} if kind == "torque_constant" else set[str]()
    dimension = {name: power for name, power in powers.items() if power and name not in ignored}
    return dimension == _base(_KINDS[kind][0])[1]


def si(kind: Kind) -> str:
    """Name the unit that a kind is counted in."""
    return _KINDS[kind][0]


def _number(plain: Any, *kinds: Kind, off: bool = False) -> BeforeValidator:
    """Return a validator that turns text with a unit into the SI number it is when ``plain``."""

    def read(value: Any) -> Any:
        if isinstance(value, bool):
            raise Unfit("a number or text with a unit", f"got {value}")
        if off and value == "off":
            return 0.0
        return quantity(value, *kinds) if isinstance(value, str) else value

    return BeforeValidator(read, json_schema_input_type=plain | str)


_Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
_Finite = Annotated[float, Field(allow_inf_nan=False)]
_NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Seconds = Annotated[_NotNegative, _number(_NotNegative, "time")]
Delay = Annotated[_Finite, _number(_Finite, "time", off=True)]
Hertz = Annotated[_Positive, _number(_Positive, "frequency")]
HertzOrOff = Annotated[_NotNegative, _number(_NotNegative, "frequency", off=True)]
Kilograms = Annotated[_NotNegative, _number(_NotNegative, "mass")]
Metres = Annotated[_NotNegative, _number(_NotNegative, "length")]
