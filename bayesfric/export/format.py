"""What a format declares of itself, and how formats are found: one file each."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.templates import environment
from bayesfric.export.joint_model import Moved
from bayesfric.export.point_estimate import Vectors
from bayesfric.fit.finished_run import Finished
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array

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
    # what it calls each of bayesfric.export.joint_model.NUMBERS that it has
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


# Share of a link's inertia that is that of its mass at its distance.
_AT_DISTANCE = 0.5
# Shares, of the inertia and of what is at a distance, of a link that weighs something and whose
# inertia is not told apart from the rotor's. The fit has no room for a lighter pendulum: of a
# first moment ml and all of an inertia I it is (ml)²/I, and any share less makes it heavier.
_WEIGHING = 0.9
# What a link without inertia or weight is given, as simulators want both: a share of the rotor's
# inertia, and kg.
_LITTLE, _PLACEHOLDER = 1e-3, 0.1
# Mass of a link of which torque tells the inertia alone, kg.
_ANY = 1.0


@dataclass(frozen=True)
class Pendulum:
    """A rigid body at the joint, turning about y with gravity along -z; or sliding along x.

    Torque tells inertia and first moment about the joint, not mass and distance apart: these are
    chosen so that half of the inertia is that of the mass at its distance. Where it tells inertia
    only together with the rotor's, a link that weighs something is given nearly all of it, and one
    that does not is a placeholder.
    """

    mass: float  # kg
    com: tuple[float, float, float]  # of the centre of mass where the joint is at zero, m
    about_axis: float  # inertia about the joint's axis through the centre of mass, kg m²
    across: float  # about the other two, kg m²
    armature: float  # what is left for the joint, kg m² or kg
    inertia: float  # of the body about the joint, kg m² or kg


def pendulum(numbers: Mapping[str, float], rotary: bool) -> Pendulum:
    """Choose a body for a joint's numbers."""
    inertia, armature = numbers["link_inertia"], numbers["armature"]
    moment, angle = numbers["link_moment"], numbers["link_gravity_angle"]
    weighs, own = rotary and moment != 0.0, inertia > 0.0
    held = _AT_DISTANCE if own else _WEIGHING
    if not own:
        share = _WEIGHING if weighs else _LITTLE
        inertia, armature = share * armature, (1.0 - share) * armature
    centre = (0.0, 0.0, 0.0)
    if not rotary:
        cube = inertia / 600.0  # of 0.1 m, which says nothing
        return Pendulum(inertia, centre, cube, cube, armature, inertia)
    if not weighs:
        mass = _ANY if own else _PLACEHOLDER
        return Pendulum(mass, centre, inertia, inertia, armature, inertia)
    distance = held * inertia / moment
    com = (-distance * math.sin(angle), 0.0, -distance * math.cos(angle))
    about = (1.0 - held) * inertia
    return Pendulum(moment / distance, com, about, about, armature, inertia)
