"""BAM: the JSON of a friction model M1 to M5, as of Rhoban/bam, bam/model.py and bam/params.

With ``T`` the load's and ``m`` the motor's torque, BAM's friction budget in steady motion is
``friction_base + c |T + m|``: the difference of motor and external torque is about ``2 T``. Of
``m = T + F`` and of ``m = T - F``, with our ``F = mu T``, follows ``c = mu / (2 + mu)`` while
the motor drives and ``mu / (2 - mu)`` while the load does; the mean of both is written. Different
losses in driving and back-driving (M5) are ``c_m m + c_e T``, with
``c_m = (mu_1 - mu_2)/(mu_1 + mu_2)`` and ``c_e = mu_1 (1 - c_m) - c_m``, where both are positive.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.export.format import Files, Format
from bayesfric.export.joint_model import (
    Trajectory,
    joint_model,
    simulated_torque,
    stacked,
    without_load_friction,
)
from bayesfric.mechanism import kernels
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array

# Fixed-point iterations of the torque, as BAM's friction depends on the motor's torque.
_ITERATIONS = 60


def parameters(
    chain: Joint, vector: Array, motions: Sequence[Trajectory]
) -> dict[str, float | str]:
    """Compute BAM's parameters of a joint that turns, with one load-dependent element at most."""
    if chain.load.motion != "rotary":
        raise BadInput("--to bam", "supports joints that turn", "export another format")
    elements = chain.tables(vector[None]).elements[0]
    at = {slot: elements[:, k] for k, slot in enumerate(kernels.ELEMENT_SLOTS)}
    lossy = np.flatnonzero((at["load_drive"] != 0.0) | (at["load_back"] != 0.0))
    if lossy.size > 1:
        raise BadInput(
            "--to bam", "supports one load-dependent element, not several", "use another format"
        )
    bare = _without_load(chain, vector, motions)
    bam: dict[str, float | str] = {
        "armature": bare["armature"],
        "friction_base": bare["friction"],
        "friction_viscous": bare["damping"],
    }
    drive, back = (float(at[f"load_{side}"].max(initial=0.0)) for side in ("drive", "back"))
    k = int(np.argmax(np.abs(at["stribeck_ratio"]) + np.abs(at["stribeck_load_ratio"])))
    stribeck = bool(at["stribeck_ratio"][k] or at["stribeck_load_ratio"][k])
    different = drive + back > 0.0 and not np.isclose(drive, back, rtol=1e-6)
    motor = (drive - back) / (drive + back) if different else 0.0
    external = drive * (1.0 - motor) - motor
    directional = different and motor > 0.0 and external > 0.0
    mean = 0.5 * (drive / (2.0 + drive) + back / (2.0 - back))
    load_ratio = float(at["stribeck_load_ratio"][lossy[0]]) if lossy.size else 0.0
    if directional:
        bam |= {"load_friction_motor": motor, "load_friction_external": external}
        bam |= {"load_friction_motor_stribeck": load_ratio * motor}
        bam |= {"load_friction_external_stribeck": load_ratio * external}
    elif lossy.size:
        bam["load_friction_base"] = mean
        bam |= {"load_friction_stribeck": load_ratio * mean} if stribeck else {}
    if stribeck or directional:
        bam["friction_stribeck"] = bare["static_friction"] - bare["friction"]
        reach = chain.reaches[chain.elements[k].name]
        bam["dtheta_stribeck"] = float(at["stribeck_velocity"][k]) / reach
        bam["alpha"] = float(at["stribeck_exponent"][k])
    bam["model"] = "m5" if directional else f"m{1 + 2 * bool(lossy.size) + stribeck}"
    return bam


def _without_load(chain: Joint, vector: Array, motions: Sequence[Trajectory]) -> dict[str, float]:
    """Compute the numbers of a joint without load-dependent friction."""
    values = without_load_friction(chain, vector[None])
    model = joint_model(chain, values, motions, 0.0)
    return {name: float(x[0]) for name, x in model.values.items()}


def _torque(chain: Joint, vector: Array, motions: Sequence[Trajectory]) -> Array:
    """Compute the measured motor torque of BAM's law along the motions."""
    bare = _without_load(chain, vector, motions)
    gain, offset = bare["gain"], bare["torque_offset"]
    bare |= dict.fromkeys(("friction", "damping", "quadratic"), 0.0)
    free: Array = gain * simulated_torque(chain, bare, motions) - offset
    still = [Trajectory(m.q, 0.0 * m.qd, 0.0 * m.qdd, m.time, m.inputs) for m in motions]
    external = offset - gain * simulated_torque(chain, bare, still)
    speed, bam = stacked(motions)[1], parameters(chain, vector, motions)
    p = {name: float(x) for name, x in bam.items() if name != "model"}
    stribeck = np.zeros_like(speed)
    if "alpha" in p:
        stribeck = np.exp(-(np.abs(speed / p["dtheta_stribeck"]) ** p["alpha"]))

    def coefficient(name: str, suffix: str = "") -> Array:
        rise = stribeck * p.get(f"{name}_stribeck", 0.0)
        return np.asarray(p.get(f"{name}{suffix}", 0.0) + rise)

    unloaded = coefficient("friction", "_base") + p["friction_viscous"] * np.abs(speed)
    torque = free
    for _ in range(_ITERATIONS):
        loss = unloaded + coefficient("load_friction", "_base") * np.abs(external - torque)
        by_load = external * coefficient("load_friction_external")
        loss = loss + np.abs(by_load - torque * coefficient("load_friction_motor"))
        torque = free + np.sign(speed) * loss
    return np.asarray((torque + offset) / gain)


def _write(content: Mapping[str, Any]) -> Files:
    bam = parameters(content["run"].joint, content["vectors"].point, content["motions"])
    bam["actuator"] = ""  # its name in BAM
    return {"params.json": json.dumps(bam, indent=1) + "\n"}


FORMATS = (
    Format(
        name="bam",
        meaning="BAM",
        names={
            "armature": "armature",
            "friction_base": "friction",
            "friction_viscous": "damping",
        },
        write=_write,
        notes=frozenset({"joint torque", "bam"}),
        torque=_torque,
        keeps=frozenset(
            ("load", "load_drive", "stribeck_ratio", "stribeck_change", "stribeck_constant",
             "stribeck_load")
        ),
    ),
)  # fmt: skip
