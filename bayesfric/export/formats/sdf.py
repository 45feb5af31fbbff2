"""SDF, of Gazebo and Drake."""

from __future__ import annotations

from collections.abc import Sequence

from bayesfric.export.at_joint import NUMBERS
from bayesfric.export.carried import DRIVE, LINK
from bayesfric.export.format import Attribute, Content, Files, Format, Options, filled
from bayesfric.export.formats.urdf import plain_name
from bayesfric.export.pendulum import pendulum
from bayesfric.mechanism.quantities import Motion

_NAMES = {
    "dynamics damping": "damping",
    "dynamics friction": "friction",
    "dynamics spring_stiffness": "stiffness",
    "inertia about the joint": "link_inertia",
    "mass times distance": "link_moment",
    "angle of the centre": "link_gravity_angle",
    "joint torque per motor torque": "gain",
    "joint torque, less": "torque_offset",
}


def _attributes(_: Options, rotary: bool) -> Sequence[Attribute]:
    motion: Motion = "rotary" if rotary else "linear"
    return [Attribute(k, v, NUMBERS[v].unit(motion)) for k, v in _NAMES.items()]


def _write(content: Content) -> Files:
    text = filled(
        "joint.sdf.j2",
        remarks=content.remarks,
        name=content.options.joint,
        numbers=content.numbers,
        body=pendulum(content.numbers, content.rotary),
        rotary=content.rotary,
    )
    return {f"{plain_name(content.options.joint)}.sdf": text}


FORMATS = (
    Format(
        name="sdf",
        meaning="SDF",
        carries=lambda _: frozenset({"damping", "friction", "stiffness", *LINK}),
        supplied=frozenset(DRIVE),
        attributes=_attributes,
        write=_write,
        notes=lambda *_: ("joint torque", "rotor in link", "gravity", "body"),
    ),
)
