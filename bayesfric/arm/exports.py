"""What is done with a fitted arm: files for simulators and controllers, and the next motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.util import find_spec

import numpy as np

from bayesfric.arm.arm_files import (
    Identified,
    written_mjcf,
    written_python,
    written_ros2_control,
    written_urdf,
)
from bayesfric.arm.excitation import Excited, exciting, limits_of
from bayesfric.arm.fitted_arm import FittedArm, FittedJoint
from bayesfric.arm.inertia import OF_ONE, completed
from bayesfric.arm.joint_numbers import NUMBERS
from bayesfric.base import __version__
from bayesfric.base.progress import Shown, silent
from bayesfric.estimates.information import long_run_variance
from bayesfric.estimates.torque import places
from bayesfric.recordings.arrays import Array
from bayesfric.report.summary.rows import PosteriorRow
from bayesfric.report.words import listed


def numbers_of(one: FittedJoint) -> dict[str, float]:
    """Give the numbers of a joint as reported, SI, referred to the joint."""
    found = {key: [*_rows(one, key)] for key in NUMBERS}
    return {key: float(np.mean([row.value for row in rows])) for key, rows in found.items() if rows}


def _rows(one: FittedJoint, key: str) -> Iterator[PosteriorRow]:
    return (one.rows[name] for name in NUMBERS[key].parameters if name in one.rows)


def identified(arm: FittedArm) -> Identified:
    """Gather what files are written of: values as reported, bodies at the mean of what they may be.

    A mean of bodies that can be is one that can be, completed. Of which no joint says anything they
    are the URDF's.
    """
    doubt, remarks = arm.doubt, [f"Made by bayesfric {__version__} of {arm.urdf.name}."]
    bodies = doubt.nominal
    if arm.together.agreed:
        mean = doubt.nominal + doubt.spread @ arm.together.draws.mean(axis=0)
        bodies = completed(mean, doubt.nominal)
    for name, one in arm.joints.items():
        told = []
        for key in NUMBERS:
            for row in _rows(one, key):
                if row.reported is not None:
                    low, high = row.reported.interval
                    ends = f"[{low:.3g}, {high:.3g}] {row.unit}".strip()
                    told.append(f"{key} {row.value:.3g} {ends}, {row.reported.status}")
        remarks.append(f"{name}: {'; '.join(told) or 'not fitted'}")
        if one.result is not None and (taken := one.result.summary.taken):
            remarks.append(f"{name}: not written here: {listed([t.kind for t in taken])}")
    links = dict(zip(arm.bodies.links, bodies.reshape(-1, OF_ONE), strict=True))
    joints = {name: numbers_of(one) for name, one in arm.joints.items()}
    return Identified(joints, links, remarks)


def files_of(arm: FittedArm) -> dict[str, str]:
    """Write a fitted arm for simulators and controllers.

    Parameters
    ----------
    arm
        What came of it.

    Returns
    -------
    dict of str
        Content by name: the URDF, ``ros2_control.yaml``, ``feedforward.py``, and ``robot.xml``
        where MuJoCo is installed, which makes it.
    """
    known, name, gravity = identified(arm), f"identified-{arm.urdf.name}", arm.bodies.gravity
    files = {
        name: written_urdf(arm.urdf, known),
        "ros2_control.yaml": written_ros2_control(known),
        "feedforward.py": written_python(known, name, gravity=gravity),
    }
    if find_spec("mujoco"):
        typical = {joint: one.urdf["torque_rms"] for joint, one in arm.joints.items() if one.urdf}
        files["robot.xml"] = written_mjcf(arm.urdf, known, typical=typical, gravity=gravity)
    return files


def next_motion(
    arm: FittedArm,
    wanted: Sequence[str] | None = None,
    *,
    seconds: float = 20.0,
    seed: int | None = None,
    tell: Shown = silent,
) -> Excited:
    """Find the motion whose recording tells most beside the one there is.

    It stays between positions where the arm has been, and within the URDF's limits.

    Parameters
    ----------
    arm
        What came of it.
    wanted
        Numbers such as ``"elbow_joint.load"``; all if left out.
    seconds
        How long it may be.
    seed
        Decides all.
    tell
        Called with each stage before it begins.

    Raises
    ------
    BadInput
        If a number is none of the arm's, or limits leave no room.
    """
    z, doubt = arm.together.draws, arm.doubt
    now = replace(
        doubt,
        nominal=doubt.nominal + doubt.spread @ z.mean(axis=0),
        spread=doubt.spread @ np.linalg.cholesky(np.cov(z.T)),
    )
    fitted = {name: one for name, one in arm.joints.items() if one.result is not None}
    return exciting(
        arm.bodies,
        now,
        {name: numbers_of(one) for name, one in fitted.items()},
        {name: _density(one) for name, one in fitted.items()},
        limits_of(arm.bodies, visited=arm.visited),
        wanted=wanted,
        known={name: _precision(one) for name, one in fitted.items()},
        seconds=seconds,
        seed=seed,
        tell=tell,
    )


def _density(one: FittedJoint) -> float:
    """Density of the effort's residual at low frequency, (N m)² s or N² s."""
    assert one.result is not None
    target, posterior = one.result.fit.target, one.result.fit.posterior
    o, *_ = one.result.model.observations
    torque, *_ = target.likelihood.predict(target.chain_values(posterior.median[None]))
    left = o.measured - torque[0]
    found = long_run_variance(left - left.mean(), places([o]))
    return float(found / left.size * o.period)


def _precision(one: FittedJoint) -> Array:
    """Precision ``(5, 5)`` of a joint's friction; of what it does not have none."""
    sd = np.full(len(NUMBERS), np.inf)
    for k, key in enumerate(NUMBERS):
        told = [row.reported.sd for row in _rows(one, key) if row.reported is not None]
        if told:
            sd[k] = np.mean(told)
    return np.diag(sd**-2.0)
