"""What ``page.json`` holds: numbers that only the page shows, checked when they are read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, FiniteFloat

from bayesfric.complaints import read_text
from bayesfric.errors import BadInput
from bayesfric.mechanism.quantities import Motion
from bayesfric.report.answers.formula import Formula
from bayesfric.report.summary.part import NotNegative, Pair, Part

FILE = "page.json"
# Of a few hundred draws and a few seconds; anything larger is some other file.
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


class Gap(Part):
    """Where a recording has no outputs, and why.

    ``missing``: it has no samples there; ``rest``: too slow for friction to have a direction,
    or filtered together with what is; ``left-out``: by the configuration, or by a column that says
    that they do not count.
    """

    span: Pair  # s
    why: Literal["missing", "rest", "left-out"]


class Stretch(Part):
    """A few seconds of one recording, measured and predicted; gaps are between pieces."""

    recording: str
    quantity: str
    unit: str
    span: Pair  # s
    whole: NotNegative  # s, of the recording
    residual_rms: NotNegative
    level: FiniteFloat
    # each with time, measured, predicted and half the width of the band, of as many outputs
    pieces: list[Annotated[list[list[FiniteFloat]], Field(min_length=4, max_length=4)]]
    gaps: list[Gap] = Field(default_factory=list)  # between pieces; of older runs none


class Answers(Part):
    """All of ``page.json``."""

    calculator: Calculator | None = None
    stretch: Stretch | None = None


def read_answers(run: Path) -> Answers:
    """Read what a run directory holds for its page; nothing where it holds none that is whole."""
    try:
        text = read_text(run / FILE, _LARGEST, "page", "fit the run again", "fit the run again")
        return Answers.model_validate_json(text)
    except (OSError, ValueError, BadInput):
        return Answers()


__all__ = ["Answers", "Calculator", "Formula", "Seen", "Stretch", "read_answers"]
