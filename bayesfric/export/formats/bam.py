"""BAM: the JSON of a friction model M1 to M5, as of Rhoban/bam, bam/model.py and bam/params.

With ``T`` what the load takes and ``m`` the motor's torque, BAM's friction budget in steady motion
is ``friction_base + c |T + m|``: the difference of motor and external torque is about ``2 T``. Of
``m = T + F`` and of ``m = T - F``, where ``F = mu T`` is ours, follows ``c = mu / (2 + mu)`` while
the motor drives and ``mu / (2 - mu)`` while the load does; the mean of both is written. Driving
and back-driving apart (M5) are ``c_m m + c_e T``: ``c_m = (mu_1 - mu_2)/(mu_1 + mu_2)`` and
``c_e = mu_1 (1 - c_m) - c_m``, where both come out positive.
"""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.export.joint_model import (
    Moved,
    at_joint,
    moving,
    simulated_torque,
    without_load_losses,
)
from bayesfric.export.format import Content, Files, Format
from bayesfric.mechanism import kernels
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array

# BAM's Stribeck curvature is a parameter; its load is that of standstill.
_ROUNDS = 60


def parameters(chain: Joint, vector: Array, motions: Sequence[Moved]) -> dict[str, float | str]:
    """Work out BAM's parameters of a joint, by their names there.

    Raises
    ------
    BadInput
        If it slides, or several elements have a load loss, of which BAM knows one.
    """
    if chain.load.motion != "rotary":
        raise BadInput("--to bam", "knows joints that turn", "export another format")
    elements = chain.tables(vector[None]).elements[0]
    at = {slot: elements[:, k] for k, slot in enumerate(kernels.ELEMENT_SLOTS)}
    lossy = np.flatnonzero((at["load_drive"] != 0.0) | (at["load_back"] != 0.0))
    if lossy.size > 1:
        raise BadInput(
            "--to bam", "knows one load loss, and the joint has several", "export others"
        )
    plain = at_joint(chain, without_load_losses(chain, vector[None]), motions, 0.0).values
    bare = {k: float(v[0]) for k, v in plain.items()}
    found: dict[str, float | str] = {
        "armature": bare["armature"],
        "friction_base": bare["friction"],
        "friction_viscous": bare["damping"],
    }
    drive, back = (float(at[f"load_{side}"].max(initial=0.0)) for side in ("drive", "back"))
    rise = bare["static_friction"] - bare["friction"]
    low = int(np.argmax(np.abs(at["stribeck_ratio"]) + np.abs(at["stribeck_load_ratio"])))
    rises = bool(at["stribeck_ratio"][low] or at["stribeck_load_ratio"][low])
    apart = drive + back > 0.0 and not np.isclose(drive, back, rtol=1e-6)
    motor = (drive - back) / (drive + back) if apart else 0.0
    external = drive * (1.0 - motor) - motor
    directional = apart and motor > 0.0 and external > 0.0
    mean = 0.5 * (drive / (2.0 + drive) + back / (2.0 - back))
    grown = float(at["stribeck_load_ratio"][lossy[0]]) if lossy.size else 0.0
    rising = rises or directional
    if directional:
        found |= {"load_friction_motor": motor, "load_friction_external": external}
        found |= {"load_friction_motor_stribeck": grown * motor}
        found |= {"load_friction_external_stribeck": grown * external}
    elif lossy.size:
        found["load_friction_base"] = mean
        found |= {"load_friction_stribeck": grown * mean} if rising else {}
    if rising:
        reach = chain.reaches[chain.elements[low].name]
        found["friction_stribeck"] = rise
        found["dtheta_stribeck"] = float(at["stribeck_velocity"][low]) / reach
        found["alpha"] = float(at["stribeck_exponent"][low])
    found["model"] = "m5" if directional else f"m{1 + 2 * bool(lossy.size) + rises}"
    return found


def _torque(chain: Joint, vector: Array, motions: Sequence[Moved]) -> Array:
    """Motor torque that BAM's law takes along the motions, brought to the measured one."""
    given = parameters(chain, vector, motions)
    values = without_load_losses(chain, vector[None])
    bare = {k: float(v[0]) for k, v in at_joint(chain, values, motions, 0.0).values.items()}
    gain, offset = bare["gain"], bare["torque_offset"]
    bare |= dict.fromkeys(("friction", "damping", "quadratic"), 0.0)
    free: Array = gain * simulated_torque(chain, bare, motions) - offset
    still = [Moved(m.q, 0.0 * m.qd, 0.0 * m.qdd, m.time, m.inputs) for m in motions]
    external = offset - gain * simulated_torque(chain, bare, still)
    speed = moving(motions)[1]
    p = {name: float(x) for name, x in given.items() if name != "model"}
    low = np.zeros_like(speed)
    if "alpha" in p:
        low = np.exp(-(np.abs(speed / p["dtheta_stribeck"]) ** p["alpha"]))

    def risen(name: str, plain: str = "") -> Array:
        return np.asarray(p.get(f"{name}{plain}", 0.0) + low * p.get(f"{name}_stribeck", 0.0))

    own = risen("friction", "_base") + p["friction_viscous"] * np.abs(speed)
    torque = free
    for _ in range(_ROUNDS):
        loss = own + risen("load_friction", "_base") * np.abs(external - torque)
        outside = external * risen("load_friction_external")
        loss = loss + np.abs(outside - torque * risen("load_friction_motor"))
        torque = free + np.sign(speed) * loss
    return np.asarray((torque + offset) / gain)


def _write(content: Content) -> Files:
    found = parameters(content.found.joint, content.vectors.middle, content.motions)
    found["actuator"] = ""  # its name there
    return {"params.json": json.dumps(found, indent=1) + "\n"}


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
