"""Search for joints whose motor turns with another joint, too, as in many wrists.

Friction and rotor inertia of such a motor follow ``q_i + s q_j``. With that speed in place of the
joint's own the model has as many parameters, and the ratio ``s``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesfric.arm.arm_log import ArmLog
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.signals import Signals

_RATIOS = (1.0, -1.0, 0.5, -0.5, 2.0, -2.0)


@dataclass(frozen=True)
class Coupled:
    """A motor that turns with another joint: ratio, and residual rms without and with that."""

    other: str
    ratio: float
    before: float
    after: float


def coupled_joint(
    o: Signals, log: ArmLog, joints: Sequence[str], name: str, torques: Array
) -> Coupled | None:
    """Find the joint whose motion a joint's effort follows in addition to its own, if any does.

    ``torques`` ``(k, n)`` are the nominal rigid-body torque and its deviations along the log. By
    the Bayesian information criterion, and as much again for each ratio and joint that is tried.
    """
    o, index = o.excerpt(), [*joints].index(name)
    load = np.stack([np.interp(o.stamps, log.time, x) for x in torques])
    nuisance = o.filter.apply(np.vstack([load, np.ones_like(o.stamps)])).T
    basis, _ = np.linalg.qr(nuisance)

    def rms(other: int, ratio: float) -> float:
        qd, qdd = (np.interp(o.stamps, log.time, x) for x in log.motion[1:, other])
        speed = o.qd + ratio * qd
        columns = o.filter.apply(np.stack([speed, np.sign(speed), o.qdd + ratio * qdd])).T
        columns, y = (x - basis @ (basis.T @ x) for x in (columns, o.measured))
        residual = y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]
        return float(np.sqrt(np.mean(residual**2)))

    moving = [j for j in range(len(joints)) if j != index and np.ptp(log.motion[0, j]) > 0.0]
    if not moving or o.measured.size < 2 * nuisance.shape[1]:
        return None
    before = rms(index, 0.0)
    after, other, ratio = min((rms(j, s), j, s) for j in moving for s in _RATIOS)
    after, ratio = min((rms(other, s), s) for s in ratio * np.linspace(0.7, 1.3, 25))
    evidence = 2.0 * o.measured.size * math.log(before / max(after, 1e-12 * before))
    if evidence < 6.0 + 3.0 * math.log(o.measured.size * len(_RATIOS) * len(moving)):
        return None
    return Coupled(joints[other], float(ratio), before, after)


def remark(name: str, coupled: Coupled, unit: str) -> str:
    """Say how to couple two joints."""
    other, ratio = coupled.other, coupled.ratio
    return (
        f"its effort is that of a motor that turns with {other}, too ({coupled.before:.3g} to "
        f'{coupled.after:.3g} {unit} rms): [coupling] joints = ["{other}", "{name}"], '
        f"matrix = [[1, 0], [{ratio:.2g}, 1]]"
    )
