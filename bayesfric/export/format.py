"""Declaration of export formats, and the templates that they fill."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.templates import environment
from bayesfric.export.joint_model import Trajectory
from bayesfric.export.written_law import Language
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array

Files = dict[str, str | bytes]


@dataclass(frozen=True)
class Options:
    """Options of an export; ``None`` where left out."""

    joint: str = "joint"  # name of the joint in the simulator's model
    at_load: float | None = None  # torque at the joint where load-dependent friction is exact
    into: Path | None = None  # model whose joint is changed
    draws: int | None = None


@dataclass(frozen=True)
class Format:
    """A format of files for a simulator, a controller or a table."""

    name: str
    meaning: str  # in a sentence
    names: Mapping[str, str]  # its names of bayesfric.export.joint_model.NUMBERS that it has
    templates: Mapping[str, str] = field(default_factory=dict)  # by file name with {stem}
    write: Callable[[Mapping[str, Any]], Files] | None = None  # in place of templates
    language: Language | None = None  # in which the model has the law
    options: frozenset[str] = frozenset()  # of Options, in addition to joint and at_load
    notes: frozenset[str] = frozenset()  # words that templates/notes.txt.j2 tests
    complete: bool = False  # whether it carries the law itself instead of numbers
    keeps: frozenset[str] = frozenset()  # quantities that it has in addition to numbers
    # motor torque along the recordings by its own law, of the fitted joint and its vector
    torque: Callable[[Joint, Array, Sequence[Trajectory]], Array] | None = None


@cache
def formats() -> dict[str, Format]:
    """Collect ``FORMATS`` of every module in ``bayesfric/export/formats``, by name."""
    package = import_module("bayesfric.export.formats")
    names = sorted(m.name for m in iter_modules(package.__path__))
    modules = [import_module(f"{package.__name__}.{name}") for name in names]
    return {form.name: form for m in modules for form in getattr(m, "FORMATS", ())}


def format_of(name: str) -> Format:
    """Look up a format."""
    if name not in formats():
        raise BadInput("--to", f"there is no format {name!r}", nearest(name, formats()))
    return formats()[name]


def filled(template: str, **values: Any) -> str:
    """Fill a template of this folder."""
    return str(_environment().get_template(template).render(**values))


@cache
def _environment() -> Any:
    jinja = environment("bayesfric.export")
    # the shortest text that is read back as the same number
    jinja.filters["n"] = lambda x: repr(float(x))
    jinja.globals["degree"] = math.pi / 180.0
    return jinja


# Share of a link's inertia that is that of its mass at its distance.
_AT_DISTANCE = 0.5
# The same, and the link's share of all inertia, where the link has weight but its inertia cannot be
# distinguished from the rotor's. Of a first moment ml and inertia I the lightest pendulum is
# (ml)²/I, and smaller shares make it heavier.
_WEIGHTED = 0.9
# A link without inertia and weight, as simulators want both: share of the rotor's inertia, and kg.
_PLACEHOLDER_SHARE, _PLACEHOLDER_MASS = 1e-3, 0.1
# Mass of a link of which only the inertia is identified, kg.
_UNKNOWN_MASS = 1.0


@dataclass(frozen=True)
class Pendulum:
    """A rigid body at the joint, turning about y with gravity along -z; or sliding along x.

    Torque identifies inertia and first moment about the joint, not mass and distance: these are
    chosen so that half of the inertia is that of the mass at its distance. Where the inertia is
    identified only together with the rotor's, a link with weight is given nearly all of it, and one
    without is a placeholder.
    """

    mass: float  # kg
    com: tuple[float, float, float]  # centre of mass where the joint is at zero, m
    about_axis: float  # inertia about the joint's axis through the centre of mass, kg m²
    across: float  # about the other two, kg m²
    armature: float  # left for the joint, kg m² or kg
    inertia: float  # of the body about the joint, kg m² or kg


def pendulum(numbers: Mapping[str, float], rotary: bool) -> Pendulum:
    """Choose a body for a joint's numbers."""
    inertia, armature = numbers["link_inertia"], numbers["armature"]
    moment, angle = numbers["link_moment"], numbers["link_gravity_angle"]
    weighted, separate = rotary and moment != 0.0, inertia > 0.0
    at_distance = _AT_DISTANCE if separate else _WEIGHTED
    if not separate:
        share = _WEIGHTED if weighted else _PLACEHOLDER_SHARE
        inertia, armature = share * armature, (1.0 - share) * armature
    centre = (0.0, 0.0, 0.0)
    if not rotary:
        cube = inertia / 600.0  # of 0.1 m; it has no effect
        return Pendulum(inertia, centre, cube, cube, armature, inertia)
    if not weighted:
        mass = _UNKNOWN_MASS if separate else _PLACEHOLDER_MASS
        return Pendulum(mass, centre, inertia, inertia, armature, inertia)
    distance = at_distance * inertia / moment
    com = (-distance * math.sin(angle), 0.0, -distance * math.cos(angle))
    about = (1.0 - at_distance) * inertia
    return Pendulum(moment / distance, com, about, about, armature, inertia)
