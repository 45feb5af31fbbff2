"""Formats of files (``formats.toml``), and the body that a joint gets in a simulator."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.safe_read import read_text
from bayesfric.base.templates import environment
from bayesfric.export.joint_model import (
    LINK_AND_DRIVE,
    NUMBERS,
    OF_BAM,
    Numbers,
    Trajectory,
    simulated_torque,
    torque_along,
)
from bayesfric.export.written_law import Language
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import Quantity
from bayesfric.recordings.arrays import Array


@dataclass(frozen=True)
class Format:
    """A format of files for a simulator, a controller or a table: a row of ``formats.toml``."""

    name: str
    meaning: str
    names: Mapping[str, str]
    files: Mapping[str, str] = field(default_factory=dict)
    law: Mapping[str, str] = field(default_factory=dict)
    language: Language = "python"
    body: bool = False

    @property
    def complete(self) -> bool:
        """Whether it is the law itself, and numbers are only about it."""
        return not self.files

    @property
    def carried(self) -> set[str]:
        """Numbers that it has, or leaves to the surrounding model."""
        return {*self.names.values(), *(() if self.body else LINK_AND_DRIVE)}

    def without(self, numbers: Collection[str]) -> Format:
        """Leave numbers out; others are fitted in their place."""
        return replace(self, names={k: x for k, x in self.names.items() if x not in numbers})

    def torque(
        self, joint: Joint, values: Array, numbers: Numbers, motions: Sequence[Trajectory]
    ) -> Array:
        """Compute the measured motor torque ``(n, M)`` by its own law along the motions."""
        if not self.complete:
            return simulated_torque(joint, numbers, motions)
        written = [not omitted(p.row) for p in joint.parameters]
        return torque_along(joint, np.where(written, values, 0.0), motions)


def omitted(row: Quantity) -> bool:
    """Whether a term is zero at 20 degC at the start of a recording, so that a law omits it."""
    return bool(row.signal) or row.shape == "warming_time"


@cache
def formats() -> Mapping[str, Format]:
    """Read the formats by name."""
    rows = tomllib.loads((files(__package__) / "formats.toml").read_text(encoding="utf-8"))
    body, known = rows.pop("transmission"), {}
    for name, row in rows.items():
        prefix = "" if "files" in row else "about: "
        names = row.pop("names", {f"{prefix}{x}": x for x in NUMBERS if x not in OF_BAM})
        if row.get("body") and "gain" not in names.values():
            names |= body
        known[name] = Format(name, names=names, **row)
    return known


_TEMPLATES = environment("bayesfric.export")
# the shortest text that is read back as the same number
_TEMPLATES.filters["n"] = lambda x: repr(float(x))


def filled(template: str, **values: Any) -> str:
    """Fill a template of this folder."""
    return _TEMPLATES.get_template(template).render(**values)


def body_of(numbers: Mapping[str, float], rotary: bool) -> dict[str, Any]:
    """Choose a rigid body for a joint: it turns about y with gravity along -z, or slides along x.

    Torque identifies inertia and first moment ``ml`` about the joint, not mass and distance: half
    of the inertia ``I`` is that of the mass at its distance. Where the inertia is identified only
    together with the rotor's, a link with weight is given nearly all of it, as the lightest
    pendulum weighs ``(ml)²/I`` and smaller shares make it heavier; one without is a placeholder of
    0.1 kg, as simulators want a mass.

    ``com`` is the centre where the joint is at zero, ``about_axis`` and ``across`` are inertias
    through it, ``inertia`` is about the joint, ``armature`` what is left for the joint.
    """
    inertia, armature = numbers["link_inertia"], numbers["armature"]
    moment, angle = numbers["link_moment"], numbers["link_gravity_angle"]
    weighted, separate = rotary and moment != 0.0, inertia > 0.0
    if not separate:
        share = 0.9 if weighted else 1e-3
        inertia, armature = share * armature, (1.0 - share) * armature
    mass, com, about, across = 1.0 if separate else 0.1, (0.0, 0.0, 0.0), inertia, inertia
    if not rotary:
        mass, about, across = inertia, inertia / 600.0, inertia / 600.0  # a cube of 0.1 m
    elif weighted:
        at_distance = 0.5 if separate else 0.9
        distance = at_distance * inertia / moment
        com = (-distance * math.sin(angle), 0.0, -distance * math.cos(angle))
        mass = moment / distance
        about = across = (1.0 - at_distance) * inertia
    body = {"mass": mass, "com": com, "about_axis": about, "across": across}
    return body | {"armature": armature, "inertia": inertia}


_ATTRIBUTE = r"([\w.:-]+)(\s*=\s*)(\"[^\"]*\"|'[^']*')"


def put_into(path: Path, name: str, model: str) -> str:
    """Give a named joint of an MJCF file the attributes of ``model``'s; every other byte stays."""
    text, where = read_text(path, "name an MJCF file with --into"), f"--into {path}"
    try:
        ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise BadInput(where, f"is no XML ({error})", "name an MJCF file") from None
    own = next(ElementTree.fromstring(model).iter("joint")).attrib
    uncommented = re.sub(r"<!--.*?-->", lambda x: " " * len(x[0]), text, flags=re.DOTALL)
    joints: dict[str, list[tuple[int, int]]] = {}  # positions of tags by name
    for tag in re.finditer(rf"<joint(\s+{_ATTRIBUTE})*\s*/?>", uncommented):
        attributes = {key: x[1:-1] for key, _, x in re.findall(_ATTRIBUTE, tag[0])}
        if "name" in attributes and "joint1" not in attributes:  # of a body, not an equality
            joints.setdefault(attributes["name"], []).append(tag.span())
    if len(joints.get(name, ())) != 1:
        problem = f"has {'several joints' if name in joints else 'no joint'} {name!r}"
        raise BadInput(where, problem, nearest(name, sorted(joints)))
    ((start, end),) = joints[name]
    wanted = ("armature", "damping", "frictionloss", "stiffness")
    left = {key: own[key] for key in wanted if key in own}

    def changed(x: re.Match[str]) -> str:
        return f'{x[1]}{x[2]}"{left.pop(x[1])}"' if x[1] in left else x[0]

    tag_text = re.sub(_ATTRIBUTE, changed, text[start:end])
    added = "".join(f' {key}="{x}"' for key, x in left.items())
    return text[:start] + re.sub(r"\s*/?>\Z", lambda x: added + x[0], tag_text) + text[end:]
