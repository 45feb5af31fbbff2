"""Exports of a fitted arm: URDF, MJCF, parameters of ros2_control, feed-forward in Python.

MJCF is what MuJoCo's own reader makes of the URDF. It writes six digits, a microradian of an axis;
they are replaced by the compiled numbers in full.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Comment, Element, SubElement, fromstring, tostring

import numpy as np

from bayesfric.arm.arm_options import NUMBERS, Vector
from bayesfric.arm.fitted_arm import FittedArm
from bayesfric.arm.inertial_prior import (
    PER_BODY,
    inertia_of,
    parsed_urdf,
    tensor,
    urdf_text,
    with_second_order,
)
from bayesfric.base import __version__
from bayesfric.base.errors import BadInput
from bayesfric.base.templates import environment
from bayesfric.recordings.arrays import Array
from bayesfric.report.words import listed

_GRAVITY: Vector = (0.0, 0.0, -9.80665)
# A link of less mass, kg, is a frame.
_FRAME_MASS = 1e-9
# Smallest mass, kg, and inertia, kg m², of a moving body in MuJoCo.
_MUJOCO_BOUNDS = (1e-9, 1e-12)
# Rounding of an inertia that is moved to the centre of mass, relative to what it was.
_ROUNDING = 1e-9
# Attributes of a URDF's dynamics, and keys in parameters of ROS.
_DYNAMICS = {"viscous": "damping", "coulomb": "friction"}
_ROS_KEYS = {key: "load_loss" if key == "load" else key for key in NUMBERS}
# Arrays of MuJoCo's compiled model by element and attribute. A joint is one degree of freedom.
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
    """Numbers of an arm that are exported: of joints, referred to the joint, and of bodies.

    A joint has the keys of :data:`NUMBERS`, in SI; a missing one is not known. Bodies have mass,
    first moment, and inertia about the origin of the link's frame: xx, xy, xz, yy, yz, zz.
    """

    joints: Mapping[str, Mapping[str, float]]  # by name, as in the URDF
    bodies: Mapping[str, Array]  # (10,) by name of the link
    remarks: Sequence[str]  # comments at the top, a line each


def files_of(arm: FittedArm) -> dict[str, str]:
    """Write a fitted arm for simulators and controllers: texts by file name.

    The URDF, ``ros2_control.yaml``, ``feedforward.py``, and ``robot.xml`` where MuJoCo is
    installed, which makes it.
    """
    identified, name = _identified(arm), f"identified-{arm.urdf.name}"
    gravity = arm.bodies.gravity
    files = {
        name: written_urdf(arm.urdf, identified),
        "ros2_control.yaml": written_ros2_control(identified),
        "feedforward.py": written_python(identified, name, gravity=gravity),
    }
    if find_spec("mujoco"):
        typical = {name: x.urdf["torque_rms"] for name, x in arm.joints.items() if x.urdf}
        files["robot.xml"] = written_mjcf(arm.urdf, identified, typical=typical, gravity=gravity)
    return files


def _identified(arm: FittedArm) -> Identified:
    """Collect reported numbers, and inertial parameters at their posterior mean.

    A mean of physical bodies is physical. Where no joint agrees, bodies are the URDF's.
    """
    prior, remarks = arm.prior, [f"Made by bayesfric {__version__} of {arm.urdf.name}."]
    bodies = prior.nominal
    if arm.consistency.agreed:
        mean = prior.nominal + prior.spread @ arm.consistency.draws.mean(axis=0)
        bodies = with_second_order(mean, prior.nominal)
    for name, joint in arm.joints.items():
        texts = []
        for key in NUMBERS:
            for row in joint.number_rows(key):
                low, high = row.reported.interval
                interval = f"[{low:.3g}, {high:.3g}] {row.unit}".strip()
                texts.append(f"{key} {row.value:.3g} {interval}, {row.reported.status}")
        remarks.append(f"{name}: {'; '.join(texts) or 'not fitted'}")
        if joint.result is not None and (terms := joint.result.summary.taken):
            remarks.append(f"{name}: not written here: {listed([t.kind for t in terms])}")
    links = dict(zip(arm.bodies.links, bodies.reshape(-1, PER_BODY), strict=True))
    return Identified({name: x.numbers for name, x in arm.joints.items()}, links, remarks)


def written_urdf(path: Path, arm: Identified) -> str:
    """Write the URDF with identified friction and bodies; everything else stays, comments too.

    Numbers that a URDF has no attribute for are in a comment of the joint.
    """
    text = urdf_text(path)
    builder = ElementTree.TreeBuilder(insert_comments=True, insert_pis=True)
    root = parsed_urdf(path, text, ElementTree.XMLParser(target=builder))
    for joint in root.findall("joint"):
        _write_joint(joint, arm.joints.get(joint.get("name", ""), {}))
    for link in root.findall("link"):
        body = arm.bodies.get(link.get("name", ""))
        if body is not None and abs(body[0]) > _FRAME_MASS:
            _write_body(link, body)
    # ElementTree keeps nothing before the root, and nothing behind
    head = re.match(r"(?:\s|<\?.*?\?>|<!--.*?-->)*", text, re.DOTALL)
    assert head is not None
    return f"{head[0]}{_comments(arm)}{tostring(root, 'unicode')}{text.rpartition('</robot>')[2]}"


def _write_joint(joint: Element, numbers: Mapping[str, float]) -> None:
    """Set the friction of a joint, and add a comment with its other numbers."""
    for key, attribute in _DYNAMICS.items():
        if key in numbers:
            _child(joint, "dynamics").set(attribute, _number(numbers[key]))
    linear = joint.get("type") == "prismatic"
    others = [
        f"{number.word} {_number(numbers[key])} {number.units[linear]}".rstrip()
        for key, number in NUMBERS.items()
        if key in numbers and key not in _DYNAMICS
    ]
    if others:
        _append(joint, Comment(f" {', '.join(others)} "))


def _write_body(link: Element, body: Array) -> None:
    """Set the inertial of a link: about its centre of mass, along the axes of the link."""
    mass, centre, size = body[0], body[1:4] / body[0], body[[4, 7, 9]].sum()
    about = tensor(body[4:] - mass * inertia_of(np.outer(centre, centre)))
    a, b, c = np.linalg.eigvalsh(about)
    # the triangle inequality implies that none is negative
    if mass < 0.0 or not a + b - c >= -_ROUNDING * size:
        numbers = f"mass {mass:.3g} kg, central inertias {a:.3g}, {b:.3g}, {c:.3g} kg m²"
        raise ValueError(f"link {link.get('name')}: there is no body with {numbers}")
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

    MuJoCo's friction does not depend on the load: it is that at the ``typical`` size of the load
    torque, N m or N by joint. ``gravity`` is in the frame of the root, m/s².
    """
    try:
        mujoco: Any = import_module("mujoco")
    except ImportError as error:
        problem = "MJCF is written by MuJoCo's own reader of URDFs"
        raise BadInput(str(path), problem, "pip install mujoco") from error
    loaded = {
        name: {**x, "coulomb": x["coulomb"] + x.get("load", 0.0) * typical.get(name, 0.0)}
        for name, x in arm.joints.items()
        if "coulomb" in x
    }
    root = fromstring(written_urdf(path, replace(arm, joints={**arm.joints, **loaded})))
    # it would look for the files of meshes and textures
    root[:] = [element for element in root if element.tag in ("link", "joint")]
    for link in root.findall("link"):
        link[:] = link.findall("inertial")
    unchanged = {"fusestatic": "false", "inertiafromgeom": "false", "balanceinertia": "false"}
    SubElement(SubElement(root, "mujoco"), "compiler", unchanged)
    try:
        spec = mujoco.MjSpec.from_string(tostring(root, "unicode"))
        spec.option.gravity = gravity
        mimics = {equality.name1 for equality in spec.equalities}
        for joint in spec.joints:
            joint.armature = arm.joints.get(joint.name, {}).get("armature", 0.0)
            # with the default, sticking joints creep
            joint.solref_friction = (2.0 * spec.option.timestep, 1.0)
            joint.solimp_friction = (0.9999, 0.9999, 0.001, 0.5, 2.0)
            if joint.name not in mimics:
                motor = spec.add_actuator(name=joint.name, target=joint.name)
                motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        try:
            model = spec.compile()
        except ValueError:  # a frame moves
            spec.compiler.boundmass, spec.compiler.boundinertia = _MUJOCO_BOUNDS
            model = spec.compile()
        text = spec.to_xml()
    except ValueError as error:
        raise BadInput(str(path), f"MuJoCo refuses it: {error}", "correct its links") from None
    remarks = [*arm.remarks]
    if any(x.get("load") for x in loaded.values()) and typical:
        remarks.append("frictionloss includes load-dependent friction at the typical load")
    return f"{_comments(replace(arm, remarks=remarks))}{_in_full(text, model)}\n"


def _in_full(text: str, model: Any) -> str:
    """Replace numbers by those of a compiled model, in full."""
    root = fromstring(text)

    def put(element: Element, k: int) -> None:
        for key, array in _COMPILED[element.tag].items():
            if key in element.attrib:
                element.set(key, _number(*np.ravel(getattr(model, array)[k])))

    for body in root.iter("body"):
        k = model.body(body.get("name")).id
        for element in (body, *body.findall("inertial")):
            put(element, k)
        for joint in body.findall("joint"):
            put(joint, model.joint(joint.get("name")).id)
    for k, mimics in enumerate(root.findall("equality/joint")):
        mimics.set("polycoef", _number(*model.eq_data[k, :5]))
    for motor in root.findall("actuator/general"):
        motor.tag = "motor"  # an actuator with this gain is one
    for option in root.findall("option"):
        option.set("gravity", _number(*model.opt.gravity))
    return tostring(root, "unicode")


def written_ros2_control(arm: Identified) -> str:
    """Write parameters of the trajectory controller that commands efforts, and friction.

    Its ``ff_velocity_scale`` is effort per reference speed.
    """
    joints = f"    joints: {json.dumps([*arm.joints])}"
    gains = [*_rows(arm, {"viscous": "ff_velocity_scale"}, "      ")]
    lines = [
        *(f"# {_line(remark)}" for remark in arm.remarks),
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
        *_rows(arm, _ROS_KEYS, "    "),
    ]
    return "\n".join(lines) + "\n"


def _rows(arm: Identified, words: Mapping[str, str], margin: str) -> Iterator[str]:
    """Write a YAML mapping for each joint that has any of some numbers."""
    for name, x in arm.joints.items():
        if pairs := [f"{word}: {_number(x[k])}" for k, word in words.items() if k in x]:
            yield f"{margin}{json.dumps(name)}: {{{', '.join(pairs)}}}"


def written_python(arm: Identified, urdf_name: str, *, gravity: Vector = _GRAVITY) -> str:
    """Write a module that computes the torque of all joints, by iDynTree and the written URDF.

    ``urdf_name`` is that of the URDF, in the folder of the module.
    """
    jinja = environment("bayesfric.arm")
    jinja.filters["n"] = _number
    template, remarks = jinja.get_template("feedforward.py.j2"), [*map(_line, arm.remarks)]
    text = template.render(joints=arm.joints, remarks=remarks, urdf=urdf_name, gravity=gravity)
    return f"{text}\n"


def _child(parent: Element, tag: str) -> Element:
    """Return the first child of a tag, or append one."""
    child = parent.find(tag)
    return _append(parent, Element(tag)) if child is None else child


def _append(parent: Element, child: Any) -> Element:
    """Append an element, on a separate line where the others are."""
    if len(parent):
        child.tail, parent[-1].tail = parent[-1].tail, parent.text
    parent.append(child)
    return parent[-1]


def _number(*x: float) -> str:
    """Write numbers in full; YAML 1.1 reads 1e-05, without a point, as a text."""
    texts = [repr(float(number)) for number in x]
    return " ".join(text if "." in text else text.replace("e", ".0e") for text in texts)


def _line(text: str) -> str:
    return " ".join(text.split())


def _comments(arm: Identified) -> str:
    """Write the remarks as XML comments, which must not contain two hyphens in a row."""
    lines = [re.sub("-(?=-)", "- ", _line(remark)) for remark in arm.remarks]
    return "".join(f"<!-- {line} -->\n" for line in lines)
