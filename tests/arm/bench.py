"""A small arm: its URDF, and logs of it simulated by MuJoCo."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import mujoco
import numpy as np
import pandas as pd

from bayesfric.arm.exports import files_of
from bayesfric.arm.fitted_arm import FittedArm
from tests.conftest import imported

# Mass, centre and inertia of the links, in the frames of their joints.
LINKS = {
    "base": (4.0, (0.0, 0.0, 0.05), 0.02),
    "upper": (6.0, (0.02, 0.01, 0.2), 0.12),
    "lower": (3.0, (-0.01, 0.0, 0.15), 0.05),
    "tool": (1.0, (0.0, 0.03, 0.1), 0.005),
}
# How much heavier than in the URDF links are where it is not quite right.
FACTORS = MappingProxyType({"upper": 1.1, "lower": 0.92, "tool": 1.08})
GRAVITY = (0.0, 0.0, -9.80665)  # MuJoCo's default is 9.81
SHOULDER, ELBOW, SLIDE = "shoulder_joint", "elbow_joint", "slide_joint"


def link(name: str, factor: float = 1.0) -> str:
    mass, centre, inertia = LINKS[name]
    terms = f'ixx="{factor * inertia}" iyy="{factor * inertia}" izz="{0.3 * factor * inertia}"'
    return (
        f'<link name="{name}"><inertial><origin xyz="{" ".join(map(str, centre))}"/>'
        f'<mass value="{factor * mass}"/><inertia {terms} ixy="0" ixz="0" iyz="0"/>'
        f"</inertial></link>"
    )


def joint(name: str, parent: str, child: str, kind: str = "revolute", extra: str = "") -> str:
    limit = "" if kind == "fixed" else '<limit lower="-3" upper="3" effort="90" velocity="9"/>'
    axis = "0 0 1" if kind == "prismatic" else "0 1 0"
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.01 0.02 0.3"/><axis xyz="{axis}"/>{limit}{extra}</joint>'
    )


def robot(*parts: str) -> str:
    return f'<robot name="bench">{"".join(parts)}</robot>'


def urdf(factors: Mapping[str, float] = MappingProxyType({}), *, slides: bool = False) -> str:
    """Write the arm with masses and inertias times ``factors`` by link."""
    return robot(
        *(link(name, factors.get(name, 1.0)) for name in LINKS),
        joint(SHOULDER, "base", "upper", "continuous"),
        joint(ELBOW, "upper", "lower"),
        joint(SLIDE, "lower", "tool", "prismatic" if slides else "fixed"),
    )


def rigid_torque(
    text: str, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, gravity: tuple | None = None
) -> np.ndarray:
    """Inverse dynamics by MuJoCo, ``(n, n_joints)`` as its arguments."""
    model = mujoco.MjModel.from_xml_string(text)
    if gravity is not None:
        model.opt.gravity[:] = gravity
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data = mujoco.MjData(model)
    out = np.empty_like(q)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], qd[k], qdd[k]
        mujoco.mj_inverse(model, data)
        out[k] = data.qfrc_inverse
    return out


def motion(seconds: float, faster: float = 1.0, rate: float = 200.0) -> tuple[np.ndarray, ...]:
    """Sum of sines: time, and position, speed and acceleration of two joints ``(n, 2)``."""
    time = np.arange(0.0, seconds, 1.0 / rate)
    motion = np.zeros((3, time.size, 2))
    for k, waves in enumerate((((0.9, 0.23), (0.4, 0.71)), ((1.1, 0.31), (0.3, 0.93)))):
        for size, hertz in waves:
            w = 2.0 * np.pi * hertz * faster
            motion[0, :, k] += size * np.sin(w * time + k)
            motion[1, :, k] += size * w * np.cos(w * time + k)
            motion[2, :, k] -= size * w**2 * np.sin(w * time + k)
    return time, *motion


def log(
    text: str,
    truth: Mapping[str, Mapping[str, float]],
    seconds: float = 20.0,
    seed: int = 1,
    faster: float = 1.0,
    motors: np.ndarray | None = None,
) -> pd.DataFrame:
    """Record the arm of a URDF with friction, white encoder and torque noise.

    ``motors`` are their positions per positions of the joints; efforts and friction are theirs.
    """
    rng, motors = np.random.default_rng(seed), np.eye(2) if motors is None else motors
    time, joints, qd, qdd = motion(seconds, faster)
    rigid = rigid_torque(text, joints, qd, qdd, GRAVITY) @ np.linalg.inv(motors)
    qd, qdd = qd @ motors.T, qdd @ motors.T
    columns = {"time [s]": time}
    for k, (name, numbers) in enumerate(truth.items()):
        friction = numbers["motor.coulomb"] + numbers["motor.load"] * np.abs(rigid[:, k])
        effort = rigid[:, k] + numbers["motor.inertia"] * qdd[:, k]
        effort += friction * np.sign(qd[:, k]) + numbers["motor.viscous"] * qd[:, k]
        columns[f"position[{name}] [rad]"] = joints[:, k] + 2e-6 * rng.normal(size=time.size)
        columns[f"effort[{name}] [N m]"] = effort + 0.3 * rng.normal(size=time.size)
    return pd.DataFrame(columns)


def held_out_rms(arm: FittedArm, folder: Path) -> dict[str, tuple[float, float]]:
    """Residual rms on a held-out log: of the exported feed-forward, and as predicted, by joint."""
    for name, text in files_of(arm).items():
        (folder / name).write_text(text)
    feedforward, rms = imported(folder / "feedforward.py"), {}
    parts = {name: joint.fitted.model.held_out[0] for name, joint in arm.fitted.items()}
    signals = {name: part.observation for name, part in parts.items()}
    # along the motion that bodies' torques were computed along: that of a joint's own fit differs
    rows = [[*arm.bodies.joints].index(name) for name in signals]
    motion = arm.logs[-1].motion[:, rows]
    torque = np.array([feedforward.torque(*x) for x in np.moveaxis(motion, 2, 0)]).T
    for x, (name, s) in zip(torque, signals.items(), strict=True):
        error = s.measured - s.filter.apply(x[None])[0]
        predicted = arm.joints[name].validation["parts"][parts[name].name]["residual_rms"]
        rms[name] = float(np.sqrt(np.mean(error**2))), predicted
    return rms
