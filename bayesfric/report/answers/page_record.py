"""What ``page.json`` holds: numbers that only the page shows, checked when they are read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, FiniteFloat

from bayesfric.errors import BadInput
from bayesfric.mechanism.quantities import Motion
from bayesfric.opened import read_json
from bayesfric.report.summary.part import NotNegative, Pair, Part

FILE = "page.json"
# Of a few hundred draws; anything larger is some other file.
_LARGEST = 2_000_000


class GroupRow(Part):
    """Terms that are told together: what they are called, and whether they lose energy."""

    words: str
    loss: bool


class TermRow(Part):
    """A term of the torque: its parameter times its formula."""

    # of its element; the load is the number of elements, and one more what comes on top
    place: int
    parameter: int  # index of its coefficient
    shape: int = -1  # index of the parameter that shapes it; -1 where none does
    rises: bool = False  # whether the rise at low speed multiplies it
    group: int
    formula: Any  # see bayesfric.report.answers.formula
    weight: bool = False  # whether it is of the load torque that `Seen` tells the range of


class ElementRow(Part):
    """An element: its ratio, its input's speed over the joint's, and parameters by slot."""

    ratio: FiniteFloat
    reach: FiniteFloat
    forms: dict[str, int] = Field(default_factory=dict)


class Seen(Part):
    """Where the outputs of the fitted recordings were: of the joint, the load at the motor."""

    speed: Pair
    slowest: NotNegative  # speed, whichever way
    position: Pair
    acceleration: Pair
    load: Pair
    outside: NotNegative  # load torque at the joint that is worth trying
    # position, speed and acceleration of an output in their midst; of older runs none
    typical: Annotated[list[FiniteFloat], Field(min_length=3, max_length=3)] | None = None


class Calculator(Part):
    """The joint's law with draws of its parameters, for the page's script to work out.

    ``values`` has a column of draws for each of ``names``, or a number where it does not vary.
    ``open_scale`` is whether the scale between load and load losses is open. Where the law has a
    term that cannot be written down, ``missing`` names it, and the rest is empty.
    """

    missing: str = ""
    level: FiniteFloat = 0.9
    names: list[str] = Field(default_factory=list)
    values: list[FiniteFloat | list[FiniteFloat]] = Field(default_factory=list)
    elements: list[ElementRow] = Field(default_factory=list)
    gravity: FiniteFloat = 0.0
    load_forms: dict[str, int] = Field(default_factory=dict)
    terms: list[TermRow] = Field(default_factory=list)
    groups: list[GroupRow] = Field(default_factory=list)
    inputs: list[Literal["position", "acceleration"]] = Field(default_factory=list)
    lossy: bool = False
    open_scale: bool = False
    own_offsets: bool = False
    # whether there are terms of temperature or time, which are those of 20 degC and of a beginning
    begins: bool = False
    scaled: bool = False  # whether the torque is one that `drive.gain` is the factor of
    motion: Motion = "rotary"
    motor_motion: Motion = "rotary"
    seen: Seen | None = None


def calculator_json(found: Calculator) -> str:
    """Write ``page.json``."""
    told = {"calculator": found.as_dict()}
    return json.dumps(told, ensure_ascii=False, allow_nan=False) + "\n"


def read_calculator(run: Path) -> Calculator | None:
    """Read what a run directory holds for its page; nothing where it holds none that is whole."""
    try:
        return Calculator.model_validate(read_json(run / FILE, largest=_LARGEST)["calculator"])
    except (BadInput, ValueError, KeyError, TypeError):
        return None
