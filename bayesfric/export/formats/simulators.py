"""Formats that are templates: URDF, SDF, Drake, Pinocchio, Isaac, ros2_control, C99 and Python.

Isaac Lab's names and units: ``isaaclab/actuators/actuator_base_cfg.py`` of isaac-sim/IsaacLab
(efforts in N m, viscous friction in N m s/rad); Isaac Sim's: the Physx Joint Schema of NVIDIA's
Omni Physics documentation, ``PhysxJointAxisAPI:angular``, whose viscousFrictionCoefficient is per
degree of what turns (its parser multiplies by 57.2958), as of Isaac Sim 5.0.

``gains.<joint>.ff_velocity_scale`` of the joint_trajectory_controller (control.ros.org, "Details
about parameters") is effort per reference speed where it commands an effort: viscous friction. It
has no other friction; numbers for a custom controller are under ``friction``, and the law is in C.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.export.extra_terms import omitted
from bayesfric.export.format import Files, Format
from bayesfric.export.joint_model import NUMBERS, Trajectory, torque_along
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array

# Formats with a body have the link, and the transmission from the motor's torque to the joint's.
_BODY = {
    "inertia about the joint": "link_inertia",
    "mass times distance": "link_moment",
    "angle of the centre": "link_gravity_angle",
    "joint torque per motor torque": "gain",
    "joint torque, less": "torque_offset",
}
_URDF = {"{stem}.urdf": "joint.urdf.j2"}
_C_FILES = {"{stem}_feedforward.c": "feedforward.c.j2", "{stem}_feedforward.h": "feedforward.h.j2"}
_ABOUT = {f"about: {number}": number for number in NUMBERS}
_DYNAMICS = {"dynamics damping": "damping", "dynamics friction": "friction"}


def _law_torque(chain: Joint, vector: Array, motions: Sequence[Trajectory]) -> Array:
    """Compute the motor torque of the written law along the motions."""
    written = [not omitted(p.row) for p in chain.parameters]
    return np.asarray(torque_along(chain, np.where(written, vector, 0.0)[None], motions)[0])


def _write_draws(content: Mapping[str, Any]) -> Files:
    """Write draws of numbers and parameters, a row each, to randomise simulations."""
    import pandas as pd

    chain, vectors = content["run"].joint, content["vectors"].draws
    count = content["options"].draws
    if count is not None and count > len(vectors):
        problem = f"is {count}, and the run has {len(vectors)}"
        raise BadInput("--draws", problem, "reduce it, or fit with more steps")
    columns = {(name, NUMBERS[name].unit(chain)): x for name, x in content["draws"].items()}
    columns |= {(p.name, p.unit): x for p, x in zip(chain.parameters, vectors.T, strict=True)}
    # remarks are in export.json only: many readers do not accept comments
    titled = {f"{name} [{unit}]" if unit else name: x for (name, unit), x in columns.items()}
    return {"draws.csv": pd.DataFrame(titled).to_csv(index=False).encode()}


FORMATS = (
    Format(
        "urdf",
        "URDF",
        _DYNAMICS | _BODY,
        _URDF,
        notes=frozenset({"joint torque", "body", "ignored", "gravity"}),
    ),
    Format(
        "sdf",
        "SDF",
        _DYNAMICS | {"dynamics spring_stiffness": "stiffness"} | _BODY,
        {"{stem}.sdf": "joint.sdf.j2"},
        notes=frozenset({"joint torque", "body", "gravity"}),
    ),
    Format(
        "drake",
        "Drake",
        {"rotor_inertia gear_ratio²": "armature", "dynamics damping": "damping"} | _BODY,
        _URDF,
        notes=frozenset({"joint torque", "body", "drake", "gravity"}),
    ),
    Format(
        "pinocchio",
        "Pinocchio",
        {
            "model.armature": "armature",
            "DAMPING": "damping",
            "QUADRATIC": "quadratic",
            "FRICTION": "friction",
            "STIFFNESS": "stiffness",
            "STIFFNESS_CUBIC": "stiffness_cubic",
        }
        | _BODY,
        _URDF | {"{stem}_pinocchio.py": "pinocchio.py.j2"},
        notes=frozenset({"joint torque", "body", "pinocchio"}),
    ),
    Format(
        "isaac",
        "Isaac Lab and Isaac Sim",
        {
            "armature": "armature",
            "friction": "static_friction",
            "dynamic_friction": "friction",
            "viscous_friction": "damping",
        },
        {"{stem}_isaac_lab.py": "isaac_lab.py.j2", "{stem}.usda": "joint.usda.j2"},
        notes=frozenset({"joint torque", "isaac"}),
    ),
    Format(
        "ros2-control",
        "ros2_control, and its feed-forward in C99",
        {
            "ff_velocity_scale": "damping",
            "friction.coulomb": "friction",
            "friction.static": "static_friction",
            "friction.quadratic": "quadratic",
            "friction.armature": "armature",
        },
        {"{stem}_ros2_control.yaml": "ros2_control.yaml.j2"} | _C_FILES,
        language="c",
        notes=frozenset({"joint torque"}),
    ),
    Format(
        "c",
        "feed-forward in C99",
        _ABOUT,
        _C_FILES,
        language="c",
        complete=True,
        torque=_law_torque,
    ),
    Format(
        "python",
        "feed-forward in Python",
        _ABOUT,
        {"{stem}_feedforward.py": "feedforward.py.j2"},
        language="python",
        complete=True,
        torque=_law_torque,
    ),
    Format(
        "csv",
        "a CSV table of draws",
        {name: name for name in NUMBERS},
        write=_write_draws,
        options=frozenset({"draws"}),
    ),
)
