"""Exports of a fitted arm: URDF, MJCF, parameters of ros2_control, feed-forward in Python."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Comment, Element, SubElement, fromstring, tostring

import numpy as np

from bayesfric.arm.arm_log import signals
from bayesfric.arm.arm_options import NUMBERS, Vector
from bayesfric.arm.fitted_arm import FittedArm
from bayesfric.arm.inertial_prior import (
    PER_BODY,
    inertia_of,
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
# Smallest mass, kg, and inertia, kg m², of a moving body in MuJoCo; a link of less mass is a frame.
_MIN_MASS, _MIN_INERTIA = 1e-9, 1e-12
# Attributes of a URDF's dynamics.
_DYNAMICS = {"viscous": "damping", "coulomb": "friction"}


@dataclass(frozen=True, eq=False)
class Identified:
    """Numbers of an arm that are exported: of joints, referred to the joint, and of bodies.

    A joint has the keys of :data:`NUMBERS`, in SI; a missing one is not known. Bodies have mass,
    first moment, and inertia about the origin of the link's frame: xx, xy, xz, yy, yz, zz.
    """

    joints: Mapping[str, Mapping[str, float]]  # by name, as in the URDF
    bodies: Mapping[str, Array]  # (10,) by name of the link
    remarks: Sequence[str]  # comments at the top, a line each
    # (10 n_links,) by joint, of which its torque was fitted: linear, or of its separate fit
    linear: Mapping[str, Array] = field(default_factory=dict)


def files_of(arm: FittedArm) -> dict[str, str]:
    """Write a fitted arm for simulators and controllers: texts by file name.

    The URDF, ``ros2_control.yaml``, ``feedforward.py``, and ``robot.xml`` where MuJoCo is
    installed, which makes it.
    """
    identified, name, gravity = _identified(arm), f"identified-{arm.urdf.name}", arm.bodies.gravity
    # the torque of the posterior means is what is predicted
    numbers, remarks = {}, [*identified.remarks]
    for joint_name, joint in arm.fitted.items():
        numbers[joint_name], left, size = joint.feedforward()
        if left > 1e-6 * size:
            law = f"{size:.3g} {'N m' if joint.joint.motion == 'rotary' else 'N'} rms of its law"
            remarks.append(f"{joint_name}: leaves {left:.3g} of the {law} along the log")
    mean = replace(identified, joints=numbers, remarks=remarks)
    files = {
        name: written_urdf(arm.urdf, identified),
        "ros2_control.yaml": rendered("ros2_control.yaml", identified),
        "feedforward.py": rendered(
            "feedforward.py", mean, urdf=name, gravity=gravity, motors=arm.bodies.motors
        ),
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
    bodies, mean, linear = prior.nominal, arm.consistency.draws.mean(axis=0), {}
    if arm.consistency.agreed:
        bodies = with_second_order(prior.nominal + prior.spread @ mean, prior.nominal)
    for name, joint in arm.joints.items():
        texts = []
        for key in NUMBERS:
            for row in joint.number_rows(key):
                low, high = row.reported.interval
                interval = f"[{low:.3g}, {high:.3g}] {row.unit}".strip()
                texts.append(f"{key} {row.value:.3g} {interval}, {row.reported.status}")
        remarks.append(f"{name}: {'; '.join(texts) or 'not fitted'}")
        if joint.result is not None:
            posterior = joint.fitted.fit.posterior
            names = [f"load.{signal}" for signal in signals(joint.directions.shape[1])]
            separate = joint.directions @ [posterior[key].mean() for key in names]
            linear[name] = prior.nominal + prior.spread @ (mean if joint.by_all else separate)
        if joint.result is not None and not joint.by_all:
            remarks.append(f"{name}: of its separate fit, whose bodies feedforward.py alone has")
        if directional := [key for key in NUMBERS if len(joint.number_rows(key)) > 1]:
            remarks.append(f"{name}: mean of both directions: {listed(directional)}")
        if joint.result is not None and (terms := joint.result.summary.taken):
            remarks.append(f"{name}: not written here: {listed([t.kind for t in terms])}")
    if arm.bodies.motors is not None:
        remarks.append("Numbers of coupled joints are those of their motors: see feedforward.py.")
    links = dict(zip(arm.bodies.links, bodies.reshape(-1, PER_BODY), strict=True))
    joints = {name: x.numbers() for name, x in arm.joints.items()}
    return Identified(joints, links, remarks, linear)


def rendered(name: str, arm: Identified, **values: Any) -> str:
    """Fill the template of a file; ``feedforward.py`` needs ``urdf``, a file beside it."""
    jinja = environment("bayesfric.arm")
    jinja.filters |= {"n": lambda x: _number(*np.ravel(x)), "comment": _comment}
    return jinja.get_template(f"{name}.j2").render(
        joints=arm.joints,
        remarks=[" ".join(remark.split()) for remark in arm.remarks],
        linear=arm.linear,
        **{"gravity": _GRAVITY, "motors": None, **values},
    )


def written_urdf(path: Path, arm: Identified) -> str:
    """Write the URDF with identified friction and bodies; everything else stays, comments too.

    Numbers that a URDF has no attribute for are in a comment of the joint.
    """
    text = urdf_text(path)
    builder = ElementTree.TreeBuilder(insert_comments=True, insert_pis=True)
    root = fromstring(text, ElementTree.XMLParser(target=builder))
    for joint in root.findall("joint"):
        numbers = arm.joints.get(joint.get("name", ""), {})
        for key, attribute in _DYNAMICS.items():
            if key in numbers:
                _child(joint, "dynamics").set(attribute, _number(numbers[key]))
        slides = joint.get("type") == "prismatic"
        others = [
            f"{number.word} {_number(numbers[key])} {number.units[slides]}".rstrip()
            for key, number in NUMBERS.items()
            if key in numbers and key not in _DYNAMICS
        ]
        if others:
            _append(joint, Comment(f" {', '.join(others)} "))
    for link in root.findall("link"):
        body = arm.bodies.get(link.get("name", ""), np.zeros(PER_BODY))
        if body[0] > _MIN_MASS:
            _write_body(link, body)
    # ElementTree keeps nothing before the root, and nothing behind
    head = re.match(r"(?:\s|<\?.*?\?>|<!--.*?-->)*", text, re.DOTALL)
    assert head is not None
    remarks = "".join(f"<!-- {_comment(remark)} -->\n" for remark in arm.remarks)
    return f"{head[0]}{remarks}{tostring(root, 'unicode')}{text.rpartition('</robot>')[2]}"


def _write_body(link: Element, body: Array) -> None:
    """Set the inertial of a link: about its centre of mass, along the axes of the link."""
    mass, centre = body[0], body[1:4] / body[0]
    about = tensor(body[4:] - mass * inertia_of(np.outer(centre, centre)))
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

    It is what MuJoCo's own reader makes of the URDF. Its friction does not depend on the load: it
    is that at the ``typical`` size of the load torque, N m or N by joint. ``gravity`` is in the
    frame of the root, m/s².
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
        try:
            model = spec.compile()
        except ValueError:  # a frame moves
            spec.compiler.boundmass, spec.compiler.boundinertia = _MIN_MASS, _MIN_INERTIA
            model = spec.compile()
    except ValueError as error:
        raise BadInput(str(path), f"MuJoCo refuses it: {error}", "correct its links") from None
    remarks = [*arm.remarks]
    if any(x.get("load") for x in loaded.values()) and typical:
        remarks.append("frictionloss includes load-dependent friction at the typical load")
    arm, robot = replace(arm, remarks=remarks), root.get("name", "robot")
    return rendered("robot.xml", arm, robot=robot, model=model, gravity=gravity)


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


def _comment(text: str) -> str:
    """Write a line of an XML comment, which must not contain two hyphens in a row."""
    return re.sub("-(?=-)", "- ", " ".join(text.split()))
