"""An identified arm as files: URDF, MJCF, parameters of ros2_control, feed-forward in Python.

MJCF is what MuJoCo's own reader makes of the URDF. It writes six digits, a microradian of an axis;
what it has compiled is put in their place in full.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Comment, Element, SubElement, fromstring, tostring

import numpy as np

from bayesfric.arm.arm_options import Vector
from bayesfric.arm.inertial_prior import parsed_urdf, urdf_text
from bayesfric.arm.inertia import inertia_of, tensor
from bayesfric.arm.joint_numbers import NUMBERS
from bayesfric.base.errors import BadInput
from bayesfric.base.templates import environment
from bayesfric.recordings.arrays import Array

_GRAVITY: Vector = (0.0, 0.0, -9.80665)
# A link of less mass, kg, is a frame. One that moves has to have some in MuJoCo: kg, and kg m².
_FRAME, _LEAST = 1e-9, (1e-9, 1e-12)
# Rounding of an inertia that is moved to the centre of mass, relative to what it was.
_ROUNDED = 1e-9
# What a URDF has a place for, and what keys are called in parameters of ROS.
_DYNAMICS = {"viscous": "damping", "coulomb": "friction"}
_OF_ROS = {key: "load_loss" if key == "load" else key for key in NUMBERS}
# Where MuJoCo has compiled what stands in an attribute. A joint is one degree of freedom.
_COMPILED = {
    "body": {"pos": "body_pos", "quat": "body_quat"},
    "inertial": {
        "pos": "body_ipos", "quat": "body_iquat", "mass": "body_mass", "diaginertia": "body_inertia"
    },
    "joint": {
        "pos": "jnt_pos", "axis": "jnt_axis", "range": "jnt_range",
        "actuatorfrcrange": "jnt_actfrcrange", "armature": "dof_armature",
        "damping": "dof_damping", "frictionloss": "dof_frictionloss",
    },
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Identified:
    """What is written of an arm: numbers of joints, referred to the joint, and of bodies.

    A joint has ``armature``, ``coulomb``, ``viscous``, ``load`` (friction per load torque) and
    ``offset``, in SI; one that is missing is not known. Bodies have mass, first moment, and inertia
    about the origin of the link's frame: xx, xy, xz, yy, yz, zz.
    """

    joints: Mapping[str, Mapping[str, float]]  # by name, as in the URDF
    bodies: Mapping[str, Array]  # (10,) by name of the link
    remarks: Sequence[str]  # a line each, as comments at the top


def written_urdf(path: Path, arm: Identified) -> str:
    """Write the URDF with friction and bodies of the arm; all else stays, comments too.

    What a URDF has no place for is in a comment of its joint.

    Raises
    ------
    BadInput
        If it cannot be read.
    ValueError
        If no rigid body has the numbers of a link.
    """
    text = urdf_text(path)
    kept = ElementTree.TreeBuilder(insert_comments=True, insert_pis=True)
    root = parsed_urdf(path, text, ElementTree.XMLParser(target=kept))
    for joint in root.findall("joint"):
        _write_joint(joint, arm.joints.get(joint.get("name", ""), {}))
    for link in root.findall("link"):
        body = arm.bodies.get(link.get("name", ""))
        if body is not None and abs(body[0]) > _FRAME:
            _write_body(link, body)
    # ElementTree keeps nothing before the root, and nothing behind
    head = re.match(r"(?:\s|<\?.*?\?>|<!--.*?-->)*", text, re.DOTALL)
    assert head is not None
    return f"{head[0]}{_said(arm)}{tostring(root, 'unicode')}{text.rpartition('</robot>')[2]}"


def _write_joint(joint: Element, own: Mapping[str, float]) -> None:
    """Set the friction of a joint, and say what else it has."""
    for key, attribute in _DYNAMICS.items():
        if key in own:
            _child(joint, "dynamics").set(attribute, _number(own[key]))
    linear = joint.get("type") == "prismatic"
    told = [
        f"{one.word} {_number(own[key])} {one.units[linear]}".rstrip()
        for key, one in NUMBERS.items()
        if key in own and key not in _DYNAMICS
    ]
    if told:
        _append(joint, Comment(f" {', '.join(told)} "))


def _write_body(link: Element, body: Array) -> None:
    """Set the inertial of a link: about its centre of mass, along the axes of the link."""
    mass, centre, size = body[0], body[1:4] / body[0], body[[4, 7, 9]].sum()
    about = tensor(body[4:] - mass * inertia_of(np.outer(centre, centre)))
    a, b, c = np.linalg.eigvalsh(about)
    # where two are as large as the third, none is negative
    if mass < 0.0 or not a + b - c >= -_ROUNDED * size:
        what = f"of mass {mass:.3g} kg and central inertias {a:.3g}, {b:.3g}, {c:.3g} kg m²"
        raise ValueError(f"link {link.get('name')}: there is no body {what}")
    inertial = _child(link, "inertial")
    origin, inertia = _child(inertial, "origin"), _child(inertial, "inertia")
    origin.set("xyz", _number(*centre))
    origin.set("rpy", "0 0 0")
    _child(inertial, "mass").set("value", _number(mass))
    for i, j in zip(*np.triu_indices(3), strict=True):
        inertia.set(f"i{'xyz'[i]}{'xyz'[j]}", _number(about[i, j]))


def written_mjcf(
    path: Path, arm: Identified, *, typical: Mapping[str, float] = {}, gravity: Vector = _GRAVITY
) -> str:
    """Write the arm for MuJoCo, without shapes, with a motor for each joint that mimics none.

    Parameters
    ----------
    path
        The URDF.
    arm
        What is known of it.
    typical
        Size of the load torque on joints, N m or N: friction is what it is at that, as MuJoCo's
        does not depend on the load.
    gravity
        In the frame of the root, m/s².

    Raises
    ------
    BadInput
        If MuJoCo is missing, or refuses the URDF.
    """
    try:
        mujoco: Any = import_module("mujoco")
    except ImportError as error:
        what = "MJCF is written by MuJoCo's own reader of URDFs"
        raise BadInput(str(path), what, "pip install mujoco") from error
    lossy = {
        name: {**own, "coulomb": own["coulomb"] + own.get("load", 0.0) * typical.get(name, 0.0)}
        for name, own in arm.joints.items()
        if "coulomb" in own
    }
    root = fromstring(written_urdf(path, replace(arm, joints={**arm.joints, **lossy})))
    # of all else, it would look for meshes and textures
    root[:] = [one for one in root if one.tag in ("link", "joint")]
    for link in root.findall("link"):
        link[:] = link.findall("inertial")
    as_is = {"fusestatic": "false", "inertiafromgeom": "false", "balanceinertia": "false"}
    SubElement(SubElement(root, "mujoco"), "compiler", as_is)
    try:
        spec = mujoco.MjSpec.from_string(tostring(root, "unicode"))
        spec.option.gravity = gravity
        mimics = {one.name1 for one in spec.equalities}
        for joint in spec.joints:
            joint.armature = arm.joints.get(joint.name, {}).get("armature", 0.0)
            # else joints that stick creep
            joint.solref_friction = (2.0 * spec.option.timestep, 1.0)
            joint.solimp_friction = (0.9999, 0.9999, 0.001, 0.5, 2.0)
            if joint.name not in mimics:
                motor = spec.add_actuator(name=joint.name, target=joint.name)
                motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        try:
            model = spec.compile()
        except ValueError:  # a frame moves
            spec.compiler.boundmass, spec.compiler.boundinertia = _LEAST
            model = spec.compile()
        text = spec.to_xml()
    except ValueError as error:
        raise BadInput(str(path), f"MuJoCo refuses it: {error}", "see to its links") from None
    remarks = [*arm.remarks]
    if any(own.get("load") for own in lossy.values()) and typical:
        remarks.append("frictionloss has the friction of the load at its typical size, too")
    return f"{_said(replace(arm, remarks=remarks))}{_in_full(text, model)}\n"


def _in_full(text: str, model: Any) -> str:
    """Write the numbers of a compiled model in full."""
    root = fromstring(text)

    def put(element: Element, k: int) -> None:
        for key, where in _COMPILED[element.tag].items():
            if key in element.attrib:
                element.set(key, _number(*np.ravel(getattr(model, where)[k])))

    for body in root.iter("body"):
        k = model.body(body.get("name")).id
        for element in (body, *body.findall("inertial")):
            put(element, k)
        for joint in body.findall("joint"):
            put(joint, model.joint(joint.get("name")).id)
    for k, mimics in enumerate(root.findall("equality/joint")):
        mimics.set("polycoef", _number(*model.eq_data[k, :5]))
    for motor in root.findall("actuator/general"):
        motor.tag = "motor"  # which is what such a one is
    for option in root.findall("option"):
        option.set("gravity", _number(*model.opt.gravity))
    return tostring(root, "unicode")


def written_ros2_control(arm: Identified) -> str:
    """Write parameters of the trajectory controller that commands efforts, and friction beside it.

    Its ``ff_velocity_scale`` is effort per wanted speed.
    """
    joints = f"    joints: {json.dumps([*arm.joints])}"
    gains = [*_rows(arm, {"viscous": "ff_velocity_scale"}, "      ")]
    lines = [
        *(f"# {_line(one)}" for one in arm.remarks),
        "# Efforts at the joints; load_loss is friction per load torque.",
        "joint_trajectory_controller:",
        "  ros__parameters:",
        joints,
        '    command_interfaces: ["effort"]',
        '    state_interfaces: ["position", "velocity"]',
        *(["    gains:", *gains] if gains else []),
        "friction_compensation:",
        "  ros__parameters:",
        joints,
        *_rows(arm, _OF_ROS, "    "),
    ]
    return "\n".join(lines) + "\n"


def _rows(arm: Identified, words: Mapping[str, str], margin: str) -> Iterator[str]:
    """Write a mapping of YAML for each joint that has any of some numbers."""
    for name, own in arm.joints.items():
        if told := [f"{word}: {_number(own[k])}" for k, word in words.items() if k in own]:
            yield f"{margin}{json.dumps(name)}: {{{', '.join(told)}}}"


def written_python(arm: Identified, urdf_name: str, *, gravity: Vector = _GRAVITY) -> str:
    """Write a module that gives the torque of all joints, by iDynTree and the URDF beside it.

    ``urdf_name`` is that of the written URDF, in the folder of the module.
    """
    made = environment("bayesfric.arm")
    made.filters["n"] = _number
    template, remarks = made.get_template("feedforward.py.j2"), [*map(_line, arm.remarks)]
    text = template.render(joints=arm.joints, remarks=remarks, urdf=urdf_name, gravity=gravity)
    return f"{text}\n"


def _child(parent: Element, tag: str) -> Element:
    """Find an element, or put it behind the others."""
    found = parent.find(tag)
    return _append(parent, Element(tag)) if found is None else found


def _append(parent: Element, child: Any) -> Element:
    """Put an element behind the others, on a line of its own where these are."""
    if len(parent):
        child.tail, parent[-1].tail = parent[-1].tail, parent.text
    parent.append(child)
    return parent[-1]


def _number(*x: float) -> str:
    """Write numbers in full; to YAML 1.1 one without a point is a text."""
    texts = [repr(float(one)) for one in x]
    return " ".join(one if "." in one else one.replace("e", ".0e") for one in texts)


def _line(text: str) -> str:
    return " ".join(text.split())


def _said(arm: Identified) -> str:
    """Write the remarks as comments of XML, in which no two hyphens are neighbours."""
    lines = [re.sub("-(?=-)", "- ", _line(one)) for one in arm.remarks]
    return "".join(f"<!-- {one} -->\n" for one in lines)
