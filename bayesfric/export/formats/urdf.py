"""URDF: plain, for Drake, and for Pinocchio with what its dynamics leave out; and SDF."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from bayesfric.export.format import Content, Files, Format

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


def _format(
    name: str, meaning: str, own: Mapping[str, str], write: Callable[[Content], Files], *notes: str
) -> Format:
    told = frozenset({"joint torque", "body", *notes})
    return Format(name=name, meaning=meaning, names={**own, **_AROUND}, write=write, notes=told)


FORMATS = (
    _format("urdf", "URDF", _DYNAMICS, _urdf, "ignored", "gravity"),
    _format("sdf", "SDF", _DYNAMICS | {"dynamics spring_stiffness": "stiffness"}, _sdf, "gravity"),
    _format(
        "drake",
        "Drake",
        {"rotor_inertia gear_ratio²": "armature", "dynamics damping": "damping"},
        _drake,
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
        "pinocchio",
    ),
)
