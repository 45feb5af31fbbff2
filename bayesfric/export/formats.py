"""Formats of files for simulators, controllers and tables, and the body that a joint gets there.

Isaac Lab's names and units: ``isaaclab/actuators/actuator_base_cfg.py`` of isaac-sim/IsaacLab
(efforts in N m, viscous friction in N m s/rad); Isaac Sim's: the Physx Joint Schema of NVIDIA's
Omni Physics documentation, ``PhysxJointAxisAPI:angular``, whose viscousFrictionCoefficient is per
degree of what turns (its parser multiplies by 57.2958), as of Isaac Sim 5.0.

``gains.<joint>.ff_velocity_scale`` of the joint_trajectory_controller (control.ros.org, "Details
about parameters") is effort per reference speed where it commands an effort: viscous friction. It
has no other friction; numbers for a custom controller are under ``friction``, and the law is in C.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal
from xml.parsers import expat

import numpy as np

from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.safe_read import read_text
from bayesfric.base.templates import environment
from bayesfric.export.bam import BAM_NAMES, BAM_NUMBERS, bam_numbers, bam_torque
from bayesfric.export.joint_model import (
    LINK_AND_DRIVE,
    NUMBERS,
    Numbers,
    Trajectory,
    simulated_torque,
    simulator_numbers,
    static_friction,
    torque_along,
    unit_of,
)
from bayesfric.export.programs import Program
from bayesfric.export.written_law import Language
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import Quantity
from bayesfric.recordings.arrays import Array

Files = dict[str, str | bytes]


@dataclass(frozen=True)
class Options:
    """Options of an export; ``None`` where left out."""

    joint: str = "joint"  # name of the joint in the simulator's model
    into: Path | None = None  # model whose joint is changed
    draws: int | None = None
    program: Program | None = None  # that the files are for


@dataclass(frozen=True)
class Format:
    """A format of files for a simulator, a controller or a table."""

    name: str
    meaning: str  # in a sentence
    names: Mapping[str, str]  # its names of numbers that it has
    templates: Mapping[str, str] = field(default_factory=dict)  # by file name with {stem}
    write: Callable[[Mapping[str, Any]], Files] | None = None  # in place of templates
    language: Language | None = None  # in which the model has the law
    options: frozenset[str] = frozenset()  # of Options, in addition to joint
    # its numbers, the law itself in addition to numbers about it, or BAM's
    law: Literal["joint", "complete", "bam"] = "joint"
    dropped: frozenset[str] = frozenset()  # numbers that its program does not take

    @property
    def numbers(self) -> Mapping[str, tuple[str, str, str]]:
        """Units and meaning of all numbers that it may have."""
        return {**NUMBERS, **BAM_NUMBERS} if self.law == "bam" else NUMBERS

    @property
    def carried(self) -> frozenset[str]:
        """Numbers that it has, or leaves to the surrounding model."""
        numbers = NUMBERS if self.law == "complete" else {*self.names.values(), *LINK_AND_DRIVE}
        return frozenset(numbers) - self.dropped

    def without(self, numbers: Collection[str]) -> Format:
        """Leave numbers out; others are fitted in their place."""
        names = {k: x for k, x in self.names.items() if x not in numbers}
        return replace(self, names=names, dropped=frozenset(numbers))

    def fit(
        self, joint: Joint, values: Array, motions: Sequence[Trajectory], load: float
    ) -> Numbers:
        """Compute its numbers for vectors ``(n, d)``; ``load`` is that of static friction."""
        if self.law == "bam":
            return bam_numbers(joint, values, motions)
        numbers = simulator_numbers(joint, values, motions, self.carried)
        numbers |= {name: np.zeros(len(values)) for name in self.dropped}
        if "static_friction" in self.carried:
            # simulators want no less than what slides
            static = static_friction(joint, values, load)
            numbers["static_friction"] = np.maximum(static, numbers["friction"])
        return numbers

    def torque(
        self, joint: Joint, values: Array, numbers: Numbers, motions: Sequence[Trajectory]
    ) -> Array:
        """Compute the measured motor torque ``(n, M)`` by its own law along the motions."""
        if self.law == "complete":
            written = [not omitted(p.row) for p in joint.parameters]
            return torque_along(joint, np.where(written, values, 0.0), motions)
        torque = bam_torque if self.law == "bam" else simulated_torque
        return torque(joint, numbers, motions)


def omitted(row: Quantity) -> bool:
    """Whether a term is zero at 20 degC at the start of a recording, so that a law omits it."""
    return bool(row.signal) or row.shape == "warming_time"


def format_of(name: str) -> Format:
    """Look up a format."""
    if name not in FORMATS:
        raise BadInput("--to", f"there is no format {name!r}", nearest(name, FORMATS))
    return FORMATS[name]


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


def body_of(numbers: Mapping[str, float], rotary: bool) -> dict[str, Any]:
    """Choose a rigid body for a joint: it turns about y with gravity along -z, or slides along x.

    Its ``mass``, centre ``com`` where the joint is at zero, inertia ``about_axis`` of the joint
    through that centre and ``across``; the ``armature`` left for the joint; its ``inertia`` about
    the joint. Torque identifies inertia and first moment ``ml`` about the joint, not mass and
    distance: half of the inertia ``I`` is that of the mass at its distance. Where the inertia is
    identified only together with the rotor's, a link with weight is given nearly all of it, as the
    lightest pendulum weighs ``(ml)²/I`` and smaller shares make it heavier; one without is a
    placeholder of 0.1 kg, as simulators want a mass.
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


# Time step of the MuJoCo model, s. With a friction constraint as stiff as two steps allow, its
# motion is that of the fitted joint to a tenth of a milliradian.
_STEP = 5e-4


def _write_mujoco(content: Mapping[str, Any]) -> Files:
    """Write a whole model of the joint, or a joint of a model changed in place."""
    options, numbers, stem = content["options"], content["numbers"], content["stem"]
    files: Files = {}
    if content["law"] and (options.program is None or options.program.name == "mujoco"):
        files = {f"{stem}_friction.py": filled("mujoco_friction.py.j2", **content)}
    if (path := options.into) is not None:
        text = read_text(path, "name an MJCF file with --into")
        changed = patched(text, options.joint, _mujoco_attributes(numbers), str(path))
        return {path.name: changed, **files}
    joint = _mujoco_attributes({**numbers, "armature": content["body"]["armature"]})
    return {f"{stem}.xml": filled("mujoco.xml.j2", joint=joint, step=_STEP, **content), **files}


def _mujoco_attributes(numbers: Mapping[str, float]) -> dict[str, str]:
    """Format the attributes of the joint."""
    damping, quadratic = numbers["damping"], numbers["quadratic"]
    stiffness, cubic = numbers["stiffness"], numbers["stiffness_cubic"]
    attributes = {
        "armature": repr(numbers["armature"]),
        "damping": f"{damping!r} {quadratic!r} 0" if quadratic else repr(damping),
        "frictionloss": repr(numbers["friction"]),
    }
    if stiffness or cubic:
        attributes["stiffness"] = f"{stiffness!r} 0 {cubic!r}" if cubic else repr(stiffness)
    return attributes


def patched(text: str, name: str, attributes: Mapping[str, str], where: str) -> str:
    """Set attributes of a named joint of a body in an MJCF text; every other byte stays."""
    parser, parents = expat.ParserCreate("utf-8"), [""]
    joints: list[tuple[str, int]] = []  # name, and position of the tag

    def begin(tag: str, tag_attributes: dict[str, str]) -> None:
        if (parents[-1], tag) == ("body", "joint") and "name" in tag_attributes:
            joints.append((tag_attributes["name"], parser.CurrentByteIndex))
        parents.append(tag)

    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda _: parents.pop()
    data = text.encode()
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise BadInput(f"--into {where}", f"is no XML ({error})", "name an MJCF file") from None
    positions = [position for joint, position in joints if joint == name]
    if len(positions) != 1:
        problem = f"has {'several joints' if positions else 'no joint'} {name!r}"
        raise BadInput(f"--into {where}", problem, nearest(name, sorted(dict(joints))))
    before, after = data[: positions[0]].decode(), data[positions[0] :].decode()
    for key, value in attributes.items():
        # of this tag: up to the first > that is not quoted
        tag = r"\A((?:[^>\"']|\"[^\"]*\"|'[^']*')*?)"
        changed, count = re.subn(
            rf"{tag}(\s{key}\s*=\s*)(?:\"[^\"]*\"|'[^']*')", rf'\g<1>\g<2>"{value}"', after
        )
        after = (
            changed if count else re.sub(rf"{tag}(\s*/?>)", rf'\g<1> {key}="{value}"\g<2>', after)
        )
    return before + after


# Actuators that better-actuator-models 1.0.2 knows, that of most users first.
_BAM_ACTUATORS = ("mx106", "mx64", "xl320", "xl330", "xl330i", "erob80_100", "erob80_50",
                  "sts3215", "unitree_go1")  # fmt: skip


def _write_bam(content: Mapping[str, Any]) -> Files:
    """Write the parameters that BAM's ``load_model`` reads; it wants the name of one of its own.

    The joint's, or that of an actuator whose drive the user replaces.
    """
    numbers = content["numbers"]
    # the simplest of BAM's models that has these numbers
    model = f"m{1 + 2 * bool(numbers['load_friction']) + bool(numbers['rise_exponent'])}"
    names = [name for name, number in BAM_NAMES.items() if numbers[number] or number == "friction"]
    parameters = {name: numbers[BAM_NAMES[name]] for name in names}
    name = content["name"] if content["name"] in _BAM_ACTUATORS else _BAM_ACTUATORS[0]
    record = {"model": model, "actuator": name, **parameters}
    return {"params.json": json.dumps(record, indent=1) + "\n"}


def _write_draws(content: Mapping[str, Any]) -> Files:
    """Write draws of numbers and parameters, a row each, to randomise simulations."""
    import pandas as pd

    joint, vectors = content["run"].joint, content["vectors"].draws
    count = content["options"].draws
    if count is not None and count > len(vectors):
        problem = f"is {count}, and the run has {len(vectors)}"
        raise BadInput("--draws", problem, "reduce it, or fit with more steps")
    columns = {(name, unit_of(NUMBERS[name], joint)): x for name, x in content["draws"].items()}
    columns |= {(p.name, p.unit): x for p, x in zip(joint.parameters, vectors.T, strict=True)}
    # remarks are in export.json only: many readers do not accept comments
    titled = {f"{name} [{unit}]" if unit else name: x for (name, unit), x in columns.items()}
    return {"draws.csv": pd.DataFrame(titled).to_csv(index=False).encode()}


# Formats with a body have the link, and the transmission from the motor's torque to the joint's.
_BODY = {
    "inertia about the joint": "link_inertia",
    "mass times distance": "link_moment",
    "angle of the centre": "link_gravity_angle",
    "joint torque per motor torque": "gain",
    "joint torque, less": "torque_offset",
}
_MUJOCO = {
    "joint armature": "armature",
    "joint damping": "damping",
    "joint damping, second number": "quadratic",
    "joint frictionloss": "friction",
    "joint stiffness": "stiffness",
    "joint stiffness, third number": "stiffness_cubic",
    "body inertia about the joint": "link_inertia",
    "body mass times distance": "link_moment",
    "body angle of its centre": "link_gravity_angle",
    "actuator gear": "gain",
    "actuator bias, negative": "torque_offset",
}
_PINOCCHIO = {
    "model.armature": "armature",
    "DAMPING": "damping",
    "QUADRATIC": "quadratic",
    "FRICTION": "friction",
    "STIFFNESS": "stiffness",
    "STIFFNESS_CUBIC": "stiffness_cubic",
}
_ISAAC = {
    "armature": "armature",
    "friction": "static_friction",
    "dynamic_friction": "friction",
    "viscous_friction": "damping",
}
_ROS2 = {
    "ff_velocity_scale": "damping",
    "friction.coulomb": "friction",
    "friction.static": "static_friction",
    "friction.quadratic": "quadratic",
    "friction.armature": "armature",
}
_URDF = {"{stem}.urdf": "joint.urdf.j2"}
_C_FILES = {"{stem}_feedforward.c": "feedforward.c.j2", "{stem}_feedforward.h": "feedforward.h.j2"}
_ABOUT = {f"about: {number}": number for number in NUMBERS}
_DYNAMICS = {"dynamics damping": "damping", "dynamics friction": "friction"}

_INTO, _DRAWS = frozenset({"into"}), frozenset({"draws"})
_SPRING = {"dynamics spring_stiffness": "stiffness"}
_DRAKE = {"rotor_inertia gear_ratio²": "armature", "dynamics damping": "damping"}
_PINOCCHIO_FILES = _URDF | {"{stem}_pinocchio.py": "pinocchio.py.j2"}
_ISAAC_FILES = {"{stem}_isaac_lab.py": "isaac_lab.py.j2", "{stem}.usda": "joint.usda.j2"}
_ROS2_FILES = {"{stem}_ros2_control.yaml": "ros2_control.yaml.j2"} | _C_FILES
_PYTHON_FILES = {"{stem}_feedforward.py": "feedforward.py.j2"}
_ROS2_MEANING = "ros2_control, and its feed-forward in C99"
_PLAIN = {name: name for name in NUMBERS}

FORMATS: Mapping[str, Format] = {
    form.name: form
    for form in (
        Format("mujoco", "MuJoCo", _MUJOCO, write=_write_mujoco, language="python", options=_INTO),
        Format("urdf", "URDF", _DYNAMICS | _BODY, _URDF),
        Format("sdf", "SDF", _DYNAMICS | _SPRING | _BODY, {"{stem}.sdf": "joint.sdf.j2"}),
        Format("drake", "Drake", _DRAKE | _BODY, _URDF),
        Format("pinocchio", "Pinocchio", _PINOCCHIO | _BODY, _PINOCCHIO_FILES),
        Format("isaac", "Isaac Lab and Isaac Sim", _ISAAC, _ISAAC_FILES),
        Format("bam", "BAM", BAM_NAMES, write=_write_bam, law="bam"),
        Format("ros2-control", _ROS2_MEANING, _ROS2, _ROS2_FILES, language="c"),
        Format("c", "feed-forward in C99", _ABOUT, _C_FILES, language="c", law="complete"),
        Format(
            "python", "feed-forward in Python", _ABOUT, _PYTHON_FILES, language="python",
            law="complete",
        ),
        Format("csv", "a CSV table of draws", _PLAIN, write=_write_draws, options=_DRAWS),
    )
}  # fmt: skip
