"""BAM: a friction model M1 to M4 of Rhoban/bam (``bam/model.py``), fitted to a joint's law.

With ``external`` the load's and ``motor`` the motor's torque at the joint, BAM's friction is
``friction_base + friction_viscous |v| + load_friction_base |external - motor|``, and with a rise at
low speed the first and the last have another part times ``exp(-(|v|/dtheta_stribeck)^alpha)``. The
motor's torque in it holds the motor's own friction, so that no coefficient is one of the law: all
are fitted to the law's torque along the recorded motion, none below zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.export.joint_model import (
    LOSSES,
    Numbers,
    Trajectory,
    exact_numbers,
    nonnegative_fit,
    simulated_torque,
    stacked,
    thinned,
    torque_along,
    undelayed,
)
from bayesfric.mechanism import kernels
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array

BAM_NUMBERS = {
    "load_friction": ("", "", "loss per difference of external and motor torque"),
    "rise": ("N m", "N", "constant loss at standstill in addition"),
    "load_rise": ("", "", "loss per torque at standstill in addition"),
    "rise_speed": ("rad/s", "m/s", "speed at which the rise has fallen to 1/e"),
    "rise_exponent": ("", "", "exponent of speed in the rise"),
}
# Names of BAM, in the order in which the fit has their columns, then those that it does not fit.
BAM_NAMES = {
    "friction_base": "friction",
    "friction_viscous": "damping",
    "load_friction_base": "load_friction",
    "friction_stribeck": "rise",
    "load_friction_stribeck": "load_rise",
    "armature": "armature",
    "dtheta_stribeck": "rise_speed",
    "alpha": "rise_exponent",
}
_FITTED = tuple(BAM_NAMES.values())[:5]
# Samples along the recorded motion that coefficients are fitted to, and fixed-point iterations of
# the torque, as friction depends on the motor's torque.
_SAMPLES, _ITERATIONS = 2000, 60


def bam_numbers(joint: Joint, values: Array, motions: Sequence[Trajectory]) -> Numbers:
    """Fit BAM's numbers to the law of vectors ``(n, d)`` along recorded motions, ``(n,)`` each."""
    if joint.load.motion != "rotary":
        raise BadInput("--to bam", "supports joints that turn", "export another format")
    numbers = exact_numbers(joint, values) | {name: np.zeros(len(values)) for name in BAM_NUMBERS}
    elements = joint.tables(values).elements
    slot = {name: elements[..., k] for k, name in enumerate(kernels.ELEMENT_SLOTS)}
    size = np.abs(slot["stribeck_ratio"]) + np.abs(slot["stribeck_load_ratio"])
    loads, rises = bool((slot["load_drive"] + slot["load_back"]).any()), bool(size.any())
    if rises:
        k = int(np.argmax(size.max(axis=0)))
        reach = joint.reaches[joint.elements[k].name]
        numbers["rise_speed"] = slot["stribeck_velocity"][:, k] / reach
        numbers["rise_exponent"] = slot["stribeck_exponent"][:, k]
    fitted = [True, True, loads, rises, loads and rises]
    motions = thinned(motions, _SAMPLES)
    speed = stacked(motions)[1]
    free, external = _without_losses(joint, numbers, motions)
    gain, offset = (numbers[name][:, None] for name in ("gain", "torque_offset"))
    torque = gain * torque_along(joint, undelayed(joint, values), motions) - offset
    losses = np.sign(speed) * (torque - free)
    amounts = np.zeros((len(values), len(_FITTED)))
    for i, loss in enumerate(losses):
        columns = _loss_columns(numbers, i, speed, external[i] - torque[i])
        amounts[i, fitted] = nonnegative_fit(columns[fitted].T, loss[None])
    return numbers | dict(zip(_FITTED, amounts.T, strict=True))


def bam_torque(joint: Joint, numbers: Numbers, motions: Sequence[Trajectory]) -> Array:
    """Compute the measured motor torque of BAM's law along the motions, ``(n, M)``."""
    speed = stacked(motions)[1]
    free, external = _without_losses(joint, numbers, motions)
    torque = free.copy()
    for i in range(len(torque)):
        amounts = np.array([numbers[name][i] for name in _FITTED])
        for _ in range(_ITERATIONS):
            losses = amounts @ _loss_columns(numbers, i, speed, external[i] - torque[i])
            torque[i] = free[i] + np.sign(speed) * losses
    return np.asarray((torque + numbers["torque_offset"][:, None]) / numbers["gain"][:, None])


def _without_losses(
    joint: Joint, numbers: Numbers, motions: Sequence[Trajectory]
) -> tuple[Array, Array]:
    """Torque at the joint that motions take without losses, and the load's own, ``(n, M)``."""
    bare = numbers | {name: np.zeros_like(numbers["gain"]) for name in LOSSES}
    still = [replace(m, qd=0.0 * m.qd, qdd=0.0 * m.qdd) for m in motions]
    gain, offset = (numbers[name][:, None] for name in ("gain", "torque_offset"))
    free, held = (gain * simulated_torque(joint, bare, at) - offset for at in (motions, still))
    return free, -held


def _loss_columns(numbers: Numbers, i: int, speed: Array, load: Array) -> Array:
    """Loss of BAM's coefficients of one, in the order of ``_FITTED``, ``(5, M)``."""
    low = np.zeros_like(speed)
    if numbers["rise_exponent"][i]:
        low = np.exp(-(np.abs(speed / numbers["rise_speed"][i]) ** numbers["rise_exponent"][i]))
    moving = np.abs(np.sign(speed))
    return np.stack([moving, np.abs(speed), np.abs(load), low * moving, low * np.abs(load)])
