"""What a format declares of itself, and how formats are found: one file each."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

from bayesfric.errors import BadInput, nearest
from bayesfric.export.at_joint import Moved
from bayesfric.export.central import Vectors
from bayesfric.export.pendulum import Pendulum, pendulum
from bayesfric.finished_run import Finished
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.templates import environment

Files = dict[str, str | bytes]


@dataclass(frozen=True)
class Options:
    """What a user may ask of an export; ``None`` where left out."""

    joint: str = "joint"  # name of the joint in the simulator's model
    at_load: float | None = None  # torque at the joint at which load losses are met, N m or N
    into: Path | None = None  # model whose joint is to be changed
    draws: int | None = None  # how many draws


@dataclass(frozen=True, eq=False)
class Content:
    """All that a format writes its files from."""

    found: Finished
    options: Options
    vectors: Vectors
    numbers: Mapping[str, float]  # of the joint, as the format carries them
    draws: Mapping[str, Array]  # the same for each draw
    motions: Sequence[Moved]
    remarks: Sequence[str]  # what every file says of itself, one line each

    @property
    def stem(self) -> str:
        """The joint's name as that of a file or variable."""
        return re.sub(r"\W", "_", self.options.joint)

    @property
    def rotary(self) -> bool:
        """Whether the joint turns."""
        return self.found.joint.load.motion == "rotary"

    @property
    def body(self) -> Pendulum:
        """A link for models that want a whole one."""
        return pendulum(self.numbers, self.rotary)

    def filled(self, template: str, **more: Any) -> str:
        """Fill a template of this folder."""
        given = {
            "remarks": self.remarks,
            "name": self.options.joint,
            "numbers": self.numbers,
            "rotary": self.rotary,
            "gravity": self.found.joint.load.gravity,
        }
        return filled(template, **given | more)


@dataclass(frozen=True)
class Format:
    """A format of files for a simulator, or for anything that wants the numbers."""

    name: str
    meaning: str  # what it is for, as it stands in a sentence
    # what it calls each of bayesfric.export.at_joint.NUMBERS that it has
    names: Mapping[str, str]
    write: Callable[[Content], Files]  # the main file first
    options: frozenset[str] = frozenset()  # of Options it knows, beside joint and at_load
    notes: frozenset[str] = frozenset()  # words that templates/notes.txt.j2 asks for
    whole: bool = False  # whether it carries the law itself, and no number in its place
    keeps: frozenset[str] = frozenset()  # quantities that it has in its own way
    # motor torque along the recordings by a law of its own, of the fitted joint and its vector
    torque: Callable[[Joint, Array, Sequence[Moved]], Array] | None = None


@cache
def formats() -> dict[str, Format]:
    """Find the formats: what every module of the folder calls ``FORMATS``, by name."""
    package = import_module("bayesfric.export.formats")
    names = sorted(m.name for m in iter_modules(package.__path__))
    modules = [import_module(f"{package.__name__}.{name}") for name in names]
    return {one.name: one for m in modules for one in getattr(m, "FORMATS", ())}


def format_of(name: str) -> Format:
    """Look a format up, or say which there are."""
    if name not in formats():
        raise BadInput("--to", f"there is no format {name!r}", nearest(name, formats()))
    return formats()[name]


def filled(template: str, **values: Any) -> str:
    """Fill a template of this folder."""
    return str(_environment().get_template(template).render(**values))


@cache
def _environment() -> Any:
    made = environment("bayesfric.export")
    # the shortest text that is read back as the same number
    made.filters["n"] = lambda x: repr(float(x))
    return made
