"""URDF: plain, for Drake, and for Pinocchio with what its dynamics leave out."""

from __future__ import annotations

import re
from collections.abc import Sequence

from bayesfric.export.at_joint import NUMBERS
from bayesfric.export.carried import DRIVE, LINK
from bayesfric.export.format import Attribute, Content, Files, Format, Options, filled
from bayesfric.export.pendulum import pendulum
from bayesfric.mechanism.quantities import Motion

_PLAIN = frozenset({"damping", "friction", *LINK})
_DRAKE = frozenset({"armature", "damping", *LINK})
_PINOCCHIO = frozenset(NUMBERS) - {"static_friction", *DRIVE}

_BODY = {
    "inertia about the joint": "link_inertia",
    "mass times distance": "link_moment",
    "angle of the centre": "link_gravity_angle",
}
_TORQUE = {"joint torque per motor torque": "gain", "joint torque, less": "torque_offset"}


def _named(names: dict[str, str], rotary: bool) -> Sequence[Attribute]:
    motion: Motion = "rotary" if rotary else "linear"
    return [Attribute(k, v, NUMBERS[v].unit(motion)) for k, v in names.items()]


def _plain_attributes(_: Options, rotary: bool) -> Sequence[Attribute]:
    dynamics = {"dynamics damping": "damping", "dynamics friction": "friction"}
    return _named({**dynamics, **_BODY, **_TORQUE}, rotary)


def _drake_attributes(_: Options, rotary: bool) -> Sequence[Attribute]:
    dynamics = {"rotor_inertia gear_ratio²": "armature", "dynamics damping": "damping"}
    return _named({**dynamics, **_BODY, **_TORQUE}, rotary)


def _pinocchio_attributes(_: Options, rotary: bool) -> Sequence[Attribute]:
    dynamics = {
        "model.armature": "armature",
        "DAMPING": "damping",
        "QUADRATIC": "quadratic",
        "FRICTION": "friction",
        "STIFFNESS": "stiffness",
        "STIFFNESS_CUBIC": "stiffness_cubic",
    }
    return _named({**dynamics, **_BODY, **_TORQUE}, rotary)


def plain_name(name: str) -> str:
    """Make a file's name, or a variable's, of a joint's."""
    return re.sub(r"\W", "_", name)


def _urdf(content: Content, **more: object) -> str:
    return filled(
        "joint.urdf.j2",
        remarks=content.remarks,
        name=content.options.joint,
        numbers=content.numbers,
        body=pendulum(content.numbers, content.rotary),
        rotary=content.rotary,
        **{"rotor": None, **more},
    )


def _write_plain(content: Content) -> Files:
    return {f"{plain_name(content.options.joint)}.urdf": _urdf(content)}


def _write_drake(content: Content) -> Files:
    ratio = content.found.joint.ratio
    left = pendulum(content.numbers, content.rotary).armature
    text = _urdf(content, rotor=(left / ratio**2, ratio))
    return {f"{plain_name(content.options.joint)}.urdf": text}


def _write_pinocchio(content: Content) -> Files:
    name = plain_name(content.options.joint)
    loader = filled(
        "pinocchio.py.j2",
        remarks=content.remarks,
        file=f"{name}.urdf",
        numbers=content.numbers,
        armature=pendulum(content.numbers, content.rotary).armature,
        gravity=content.found.joint.load.gravity,
    )
    return {f"{name}.urdf": _urdf(content), f"{name}_pinocchio.py": loader}


FORMATS = (
    Format(
        name="urdf",
        meaning="URDF",
        carries=lambda _: _PLAIN,
        supplied=frozenset(DRIVE),
        attributes=_plain_attributes,
        write=_write_plain,
        notes=lambda *_: ("joint torque", "urdf ignored", "rotor in link", "gravity", "body"),
    ),
    Format(
        name="drake",
        meaning="Drake",
        carries=lambda _: _DRAKE,
        supplied=frozenset(DRIVE),
        attributes=_drake_attributes,
        write=_write_drake,
        notes=lambda *_: ("joint torque", "drake friction", "gravity", "body"),
    ),
    Format(
        name="pinocchio",
        meaning="Pinocchio",
        carries=lambda _: _PINOCCHIO,
        supplied=frozenset(DRIVE),
        attributes=_pinocchio_attributes,
        write=_write_pinocchio,
        notes=lambda *_: ("joint torque", "pinocchio losses", "body"),
    ),
)
