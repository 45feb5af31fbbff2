"""Joints as simulators and controllers read them: URDF, SDF, Isaac, ros2_control.

URDF is plain, for Drake, or for Pinocchio with what its dynamics leave out.

Isaac Lab's names and units: ``isaaclab/actuators/actuator_base_cfg.py`` of isaac-sim/IsaacLab
(efforts in N m, viscous friction in N m s/rad); Isaac Sim's: the Physx Joint Schema of NVIDIA's
Omni Physics documentation, ``PhysxJointAxisAPI:angular``, whose viscousFrictionCoefficient is per
degree of what turns (its parser multiplies by 57.2958), as of Isaac Sim 5.0.

``gains.<joint>.ff_velocity_scale`` of the joint_trajectory_controller (control.ros.org, "Details
about parameters") is effort per wanted speed where it commands an effort: viscous friction. It has
no place for more; what a controller of one's own wants beside it stands under ``friction``, and the
whole law beside it in C.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from bayesfric.export.format import Content, Files, Format
from bayesfric.export.formats.feedforward import c_files

# What all of them have: the link, and the way from the motor's torque to the joint's.
_AROUND = {
    "inertia about the joint": "link_inertia",
    "mass times distance": "link_moment",
    "angle of the centre": "link_gravity_angle",
    "joint torque per motor torque": "gain",
    "joint torque, less": "torque_offset",
}
_DYNAMICS = {"dynamics damping": "damping", "dynamics friction": "friction"}


def _urdf(content: Content, rotor: tuple[float, float] | None = None) -> Files:
    text = content.filled("joint.urdf.j2", body=content.body, rotor=rotor)
    return {f"{content.stem}.urdf": text}


def _drake(content: Content) -> Files:
    ratio = content.found.joint.ratio
    return _urdf(content, (content.body.armature / ratio**2, ratio))


def _pinocchio(content: Content) -> Files:
    given = {"file": f"{content.stem}.urdf", "armature": content.body.armature}
    loader = content.filled("pinocchio.py.j2", **given)
    return {**_urdf(content), f"{content.stem}_pinocchio.py": loader}


def _sdf(content: Content) -> Files:
    return {f"{content.stem}.sdf": content.filled("joint.sdf.j2", body=content.body)}


def _isaac(content: Content) -> Files:
    per_degree = math.pi / 180.0 if content.rotary else 1.0
    given = {
        "stem": content.stem,
        "viscous": per_degree * content.numbers["damping"],
    }
    files = {
        f"{content.stem}_isaac_lab.py": "isaac_lab.py.j2",
        f"{content.stem}.usda": "joint.usda.j2",
    }
    return {name: content.filled(template, **given) for name, template in files.items()}


def _ros2_control(content: Content) -> Files:
    text = content.filled("ros2_control.yaml.j2", stem=content.stem)
    return {f"{content.stem}_ros2_control.yaml": text, **c_files(content)}


def _format(
    name: str, meaning: str, own: Mapping[str, str], write: Callable[[Content], Files], *notes: str
) -> Format:
    """Declare a format; with the note ``body`` it has the link, and the way to the motor."""
    names = {**own, **(_AROUND if "body" in notes else {})}
    return Format(name, meaning, names, write, notes=frozenset({"joint torque", *notes}))


FORMATS = (
    _format("urdf", "URDF", _DYNAMICS, _urdf, "body", "ignored", "gravity"),
    _format(
        "sdf",
        "SDF",
        _DYNAMICS | {"dynamics spring_stiffness": "stiffness"},
        _sdf,
        "body",
        "gravity",
    ),
    _format(
        "drake",
        "Drake",
        {"rotor_inertia gear_ratio²": "armature", "dynamics damping": "damping"},
        _drake,
        "body",
        "drake",
        "gravity",
    ),
    _format(
        "pinocchio",
        "Pinocchio",
        {
            "model.armature": "armature",
            "DAMPING": "damping",
            "QUADRATIC": "quadratic",
            "FRICTION": "friction",
            "STIFFNESS": "stiffness",
            "STIFFNESS_CUBIC": "stiffness_cubic",
        },
        _pinocchio,
        "body",
        "pinocchio",
    ),
    _format(
        "isaac",
        "Isaac Lab and Isaac Sim",
        {
            "armature": "armature",
            "friction": "static_friction",
            "dynamic_friction": "friction",
            "viscous_friction": "damping",
        },
        _isaac,
        "isaac",
    ),
    _format(
        "ros2-control",
        "ros2_control, and its feed-forward in C99",
        {
            "ff_velocity_scale": "damping",
            "friction.coulomb": "friction",
            "friction.static": "static_friction",
            "friction.quadratic": "quadratic",
            "friction.armature": "armature",
        },
        _ros2_control,
    ),
)
