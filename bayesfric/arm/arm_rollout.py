"""Roll-outs of an arm: measured efforts drive all its joints at once, and motions are compared.

Rigid-body dynamics are iDynTree's. Friction that does not depend on speed acts by impulses, as in
time stepping [1]_: the speed at the end of a step minimises ``(v - v0)' M (v - v0) / 2
+ h sum(c |v|)``, with ``v0`` the speed without friction. So a joint that sticks stays in place, and
a step may be long.

References
----------
.. [1] J. J. Moreau, "Unilateral contact and dry friction in finite freedom dynamics", Nonsmooth
   Mechanics and Applications (1988) 1-82.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from bayesfric.arm.arm_closed_loop import followed
from bayesfric.arm.arm_options import NUMBERS
from bayesfric.arm.fitted_arm import FittedArm, FittedJoint
from bayesfric.base.errors import BadInput
from bayesfric.base.progress import Progress, ProgressCallback, no_progress
from bayesfric.recordings.arrays import Array, Flags, Index
from bayesfric.recordings.filters import interpolated
from bayesfric.report.words import listed

# Longest step, s: a swing of a radian is then wrong by 0.6 mrad after a second. It is shorter where
# a joint reverses, as friction jumps there.
_STEP, _REVERSAL_STEP = 5e-3, 1e-3


@dataclass(frozen=True, eq=False)
class ArmRollOut:
    """Measured and simulated positions of the driven joints, ``(n_joints, n)`` rad or m."""

    log: str  # whose efforts drive the arm
    seconds: float  # between restarts
    units: Mapping[str, str]  # by driven joint; others move as measured
    time: Array  # (n,) s
    restarts: Flags  # (n,) where the arm is set to the measured state
    measured: Array
    bands: Array  # (3, n_joints, n): lower end, median and upper end of the 90 % bands

    @property
    def rms(self) -> dict[str, float]:
        """Root mean square error of the median, by joint."""
        error = np.sqrt(np.mean((self.bands[1] - self.measured) ** 2, axis=1))
        return dict(zip(self.units, error.tolist(), strict=True))

    @property
    def coverage(self) -> dict[str, float]:
        """Share of samples inside the 90 % bands, by joint, restarts excluded."""
        inside = (self.bands[0] <= self.measured) & (self.measured <= self.bands[2])
        share = inside[:, ~self.restarts].mean(axis=1).tolist()
        return dict(zip(self.units, share, strict=True))

    def text(self) -> str:
        """Summarise error and coverage of each joint."""
        rms, coverage = self.rms, self.coverage
        parts = [
            f"{name} {rms[name]:.2g} {unit} off, bands hold {coverage[name]:.0%}"
            for name, unit in self.units.items()
        ]
        restarted = f", restarted every {self.seconds:g} s" * bool(np.isfinite(self.seconds))
        return f"roll-out of {self.log}{restarted}: {listed(parts)}"

    def as_json(self) -> dict[str, Any]:
        """Give what :meth:`text` summarises."""
        numbers = {"rms": self.rms, "held": self.coverage, "units": dict(self.units)}
        seconds = self.seconds if np.isfinite(self.seconds) else None
        return {"log": self.log, "seconds": seconds, **numbers}

    def as_csv(self) -> str:
        """Write a row for each sample: time, whether the arm restarts, positions by joint."""
        import pandas as pd

        columns = {"time [s]": self.time, "begins": self.restarts}
        for j, name in enumerate(self.units):
            columns[f"measured[{name}]"] = self.measured[j]
            columns |= {
                f"{word}[{name}]": band[j]
                for word, band in zip(("low", "middle", "high"), self.bands, strict=True)
            }
        return str(pd.DataFrame(columns).to_csv(index=False, float_format="%.9g"))


def rollout(
    arm: FittedArm,
    *,
    seconds: float = 1.0,
    draws: int = 40,
    seed: int | None = None,
    progress: ProgressCallback = no_progress,
) -> ArmRollOut:
    """Simulate the arm under the efforts of the last log, the held-out one if there is one.

    It is set to the measured state every ``seconds``. Each draw of inertial parameters and friction
    has the residual torque of the first log from a random time on, the same time for all joints.
    Joints of targets alone follow them, see :func:`bayesfric.arm.arm_closed_loop.followed`.
    """
    rng, bodies, fitted = np.random.default_rng(seed), arm.bodies, arm.fitted
    first, log = arm.logs[0], arm.logs[-1]
    step = float(np.median(np.diff(log.time)))
    if not step < seconds < np.inf and arm.timing is None:
        problem = f"is {seconds:g}, a sample is {step:.3g} s"
        raise BadInput("seconds of a roll-out", problem, "increase it")
    driven = np.array([list(bodies.joints).index(name) for name in fitted])
    z, values = arm.draw(draws, rng)
    columns = arm.prior.columns(loaded=log.loaded)
    inertial = columns[:, 0] + z @ columns[:, 1:].T
    measured = [log.measured(bodies.joints[name]) for name in fitted]
    restarts = np.append(True, np.diff(log.time) > 1.5 * step)
    since = log.time - np.maximum.accumulate(np.where(restarts, log.time, -np.inf))
    restarts |= np.append(False, np.diff(np.floor(since / seconds + 1e-6)) > 0)
    units = {
        name: "m" if joint.joint.motion == "linear" else "rad" for name, joint in fitted.items()
    }

    def played(simulated: Array) -> ArmRollOut:
        bands, positions = np.quantile(simulated, (0.05, 0.5, 0.95), axis=0), log.motion[0, driven]
        return ArmRollOut(log.name, seconds, units, log.time, restarts, positions, bands)

    if arm.timing is not None:
        fits = {name: joint.fitted.fit for name, joint in fitted.items()}
        laws = dict(zip(fitted, measured, strict=True))
        return played(followed(bodies, log, laws, fits, inertial, values, restarts, rng, progress))
    friction = [_friction(joint, values[name]) for name, joint in fitted.items()]
    # residual efforts of the first log
    columns = arm.prior.columns(loaded=first.loaded)
    mean = np.repeat((columns @ np.r_[1.0, z.mean(axis=0)])[None, :, None], len(bodies.joints), 0)
    rigid = bodies.torques(first.motion, mean)[:, 0]
    residuals = [
        _residual(joint, first.time, rigid[j], numbers)
        for joint, j, numbers in zip(fitted.values(), driven, friction, strict=True)
    ]
    simulated = np.empty((draws, len(fitted), log.time.size))
    period = float(np.ptp(first.time))
    for k in range(draws):
        progress(Progress(f"roll-out {k + 1} of {draws}"))
        shifted = log.time + rng.uniform(0.0, period)
        residual = [np.interp(shifted, *series, period=period) for series in residuals]
        draw = {key: np.stack([x[key][k] for x in friction], axis=-1) for key in NUMBERS}
        # the time within a sample at which the effort was measured, or jumps, is unknown
        sampled = log.time + log.period * rng.uniform(-0.5, 0.5)
        effort = np.array(
            [
                x["gain"][k, 0] * (np.interp(sampled - x["delay"][k, 0], m.time, m.torque) - r)
                for x, m, r in zip(friction, measured, residual, strict=True)
            ]
        )
        dynamics = bodies.dynamics(inertial[k])
        simulated[k] = simulate_arm(dynamics, draw, log.time, log.motion, effort, driven, restarts)
    return played(simulated)


def _friction(joint: FittedJoint, values: Array) -> dict[str, Array]:
    """Lay out numbers ``(n, 2)`` by key, where the joint moves forwards and backwards.

    Of load-dependent friction the first is where the motor drives. ``values`` are
    ``(n, n_parameters)``.
    """
    names = joint.fitted.fit.chain.names
    parameters = {key: number.parameters for key, number in NUMBERS.items()}
    parameters["delay"] = ("drive.delay",)
    known = {name for names_of_key in parameters.values() for name in names_of_key}
    if unknown := [n for n in names if n not in known and not n.startswith("load.urdf_")]:
        problem = f"has {listed(unknown)}, which roll-outs of an arm do not support"
        raise BadInput(f"joint {joint.joint.name!r}", problem, "fit it without, or skip roll-outs")
    numbers = {}
    for key, known_as in parameters.items():
        columns = [values[:, names.index(name)] for name in known_as if name in names]
        columns = columns or [np.full(len(values), float(key == "gain"))]
        numbers[key] = np.stack([columns[0], columns[-1]], axis=1)
    return numbers


def _residual(
    joint: FittedJoint, time: Array, rigid: Array, numbers: Mapping[str, Array]
) -> tuple[Array, Array]:
    """Give times and residual efforts of a joint while it moves.

    ``rigid`` ``(n,)`` is the rigid-body torque at ``time``, ``numbers`` are of :func:`_friction`.
    """
    o = joint.fitted.model.observations[0]
    load = interpolated(time, rigid, o.stamps)
    c = {key: x.mean(axis=0) for key, x in numbers.items()}
    backwards, back_driven = (o.qd < 0.0).astype(int), (load * o.qd < 0.0).astype(int)
    torque = load + c["armature"][0] * o.qdd + c["offset"][0] + c["viscous"][backwards] * o.qd
    constant = c["coulomb"][backwards] + c["load"][back_driven] * np.abs(load)
    torque += constant * np.sign(o.qd)
    moves = np.abs(o.qd) > float(o.settings["dead_zone"])
    return o.stamps[moves], (o.compared - torque / c["gain"][0])[moves]


def simulate_arm(
    dynamics: Callable[[Array, Array], tuple[Array, Array]],
    friction: Mapping[str, Array],
    time: Array,
    motion: Array,
    effort: Array,
    driven: Index,
    restarts: Flags,
) -> Array:
    """Simulate the driven joints under their efforts ``(n_driven, n)``; positions of that shape.

    ``dynamics`` is of :meth:`~bayesfric.arm.inertial_prior.Bodies.dynamics`, ``friction``
    ``(2, n_driven)`` by key as of :func:`_friction`, ``time`` ``(n,)`` s, ``motion``
    ``(3, n_joints, n)`` as measured, ``driven`` ``(n_driven,)``, ``restarts`` ``(n,)``.
    """
    q, qd, qdd = (x.T for x in motion)
    others, each = np.setdiff1d(np.arange(q.shape[1]), driven), np.arange(driven.size)
    among_driven, cross = np.ix_(driven, driven), np.ix_(driven, others)
    out, c, armature = q[:, driven].copy(), friction, np.diag(friction["armature"][0])
    v, a = qd[0, driven], qdd[0, driven]
    reverses = (qd[:-1, driven] * qd[1:, driven] < 0.0).any(axis=1)
    longest = np.where(reverses, _REVERSAL_STEP, _STEP)
    substeps = np.ceil(np.diff(time) / longest - 1e-6).astype(int)
    for i, step in enumerate(np.diff(time)):
        if restarts[i + 1]:
            continue
        if restarts[i]:
            v, a = qd[i, driven], qdd[i, driven]
        x, parts = out[i], substeps[i]
        h = step / parts
        for part in range(parts):
            # forces at the middle of the step, where the joint is predicted to be
            share = (part + 0.5) / parts
            position, speed, acceleration = (s[i] + share * (s[i + 1] - s[i]) for s in (q, qd, qdd))
            position[driven], speed[driven] = x + 0.5 * h * v, v + 0.5 * h * a
            mass, bias = dynamics(position, speed)
            still = bias[driven] + mass[cross] @ acceleration[others]
            load = still + mass[among_driven] @ a
            backwards, back_driven = (v < 0.0).astype(int), (load * v < 0.0).astype(int)
            rigid = mass[among_driven] + armature
            drag = 0.5 * h * np.diag(c["viscous"][backwards, each])  # of the mean speed
            torque = effort[:, i] + share * (effort[:, i + 1] - effort[:, i])
            impulse = (rigid - drag) @ v + h * (torque - still - c["offset"][0])
            free = np.linalg.solve(rigid + drag, impulse)
            loss = c["coulomb"] + c["load"][back_driven, each] * np.abs(load)
            after = _with_friction(rigid + drag, free, h * loss, v.copy())
            x, a, v = x + 0.5 * h * (v + after), (after - v) / h, after
        out[i + 1] = x
    return np.asarray(out.T)


@njit(cache=True)
def _with_friction(mass, free, loss, v, tolerance=1e-10):  # type: ignore[no-untyped-def]
    """Find the speed ``(n,)`` that impulses of at most ``loss`` ``(2, n)`` leave, from ``v`` on.

    By coordinate descent, which for this convex function ends at its minimum.
    """
    for _ in range(200):
        changed = 0.0
        for i in range(v.size):
            push = mass[i, i] * v[i]
            for j in range(v.size):
                push += mass[i, j] * (free[j] - v[j])
            new = (max(push - loss[0, i], 0.0) + min(push + loss[1, i], 0.0)) / mass[i, i]
            changed = max(changed, abs(new - v[i]))
            v[i] = new
        if changed < tolerance:
            break
    return v
