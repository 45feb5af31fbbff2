"""Roll-outs of an arm: measured efforts drive all its joints at once, and their motion is compared.

Bodies' dynamics are iDynTree's. Friction that does not depend on speed acts by impulses, as in time
stepping [1]_: the speed at the end of a step minimises ``(v - v0)' M (v - v0) / 2 + h sum(c |v|)``,
``v0`` what it would be without. So a joint that sticks stays where it is, and a step may be long.

References
----------
.. [1] J. J. Moreau, "Unilateral contact and dry friction in finite freedom dynamics", Nonsmooth
   Mechanics and Applications (1988) 1-82.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from bayesfric.arm.arm_log import ArmLog
from bayesfric.arm.fitted_arm import FittedArm, FittedJoint
from bayesfric.arm.joint_numbers import NUMBERS
from bayesfric.base.errors import BadInput
from bayesfric.base.progress import Progress, Shown, silent
from bayesfric.recordings.arrays import Array, Flags, Index
from bayesfric.report.words import listed

# Longest step, s, by which a swing of a radian is 0.6 mrad off after a second; and where a joint
# turns, as friction jumps there. When the speeds at its end are found, and how often that is tried.
_STEP, _TURN, _FOUND, _SWEEPS = 5e-3, 1e-3, 1e-10, 200
_BAND = (0.05, 0.5, 0.95)


@dataclass(frozen=True, eq=False)
class ArmRollOut:
    """Positions as measured and as played, ``(n_joints, n)`` rad or m.

    Attributes
    ----------
    log, seconds
        Whose efforts drove the arm, and after which time it began anew.
    joints, units
        Of those that were driven; others moved as measured.
    time, begins
        ``(n,)`` s, and whether the arm began anew there in the measured state.
    measured, low, middle, high
        Positions, and ends and median of the 90 % bands.
    """

    log: str
    seconds: float
    joints: tuple[str, ...]
    units: tuple[str, ...]
    time: Array
    begins: Flags
    measured: Array
    low: Array
    middle: Array
    high: Array

    @property
    def rms(self) -> dict[str, float]:
        """Root mean square, by joint, of how far the median is off."""
        off = np.sqrt(np.mean((self.middle - self.measured) ** 2, axis=1))
        return dict(zip(self.joints, off.tolist(), strict=True))

    @property
    def held(self) -> dict[str, float]:
        """Share of samples, by joint, that the 90 % bands hold; where it begins is not counted."""
        inside = (self.low <= self.measured) & (self.measured <= self.high)
        held = inside[:, ~self.begins].mean(axis=1).tolist()
        return dict(zip(self.joints, held, strict=True))

    def text(self) -> str:
        """Say both of each joint."""
        each = [
            f"{name} {rms:.2g} {unit} off, bands hold {held:.0%}"
            for (name, rms), unit, held in zip(
                self.rms.items(), self.units, self.held.values(), strict=True
            )
        ]
        return f"roll-out of {self.log}, anew every {self.seconds:g} s: {listed(each)}"

    def as_json(self) -> dict[str, Any]:
        """Give what :meth:`text` says."""
        told = {"log": self.log, "seconds": self.seconds, "rms": self.rms, "held": self.held}
        return {**told, "units": dict(zip(self.joints, self.units, strict=True))}

    def as_csv(self) -> str:
        """Write a row a sample: time, whether it begins anew, and all positions of each joint."""
        import pandas as pd

        columns = {"time [s]": self.time, "begins": self.begins}
        for j, name in enumerate(self.joints):
            for word in ("measured", "low", "middle", "high"):
                columns[f"{word}[{name}]"] = getattr(self, word)[j]
        return str(pd.DataFrame(columns).to_csv(index=False, float_format="%.9g"))


def rollout(
    arm: FittedArm,
    *,
    seconds: float = 1.0,
    draws: int = 40,
    seed: int | None = None,
    tell: Shown = silent,
) -> ArmRollOut:
    """Play the efforts of the last log, the one to be predicted if there is one.

    Parameters
    ----------
    arm
        What came of it.
    seconds
        After which it begins anew in the measured state.
    draws
        Of bodies and friction, each with the torque that the first log leaves unexplained, from
        another moment on: of all joints at once, as they share it.
    seed
        Decides all.
    tell
        Called as work goes on.

    Raises
    ------
    BadInput
        If ``seconds`` is less than a step of the log, or a joint's friction has more than armature,
        Coulomb, viscous and load loss.
    """
    rng, bodies = np.random.default_rng(seed), arm.bodies
    first, log = arm.logs[0], arm.logs[-1]
    step = float(np.median(np.diff(log.time)))
    if not step < seconds < np.inf:
        what = f"is {seconds:g}, a sample is {step:.3g} s"
        raise BadInput("seconds of a roll-out", what, "take more")
    fitted = {name: one for name, one in arm.joints.items() if one.result is not None}
    on = np.array([list(bodies.joints).index(name) for name in fitted])
    z, values = arm.drawn(draws, rng)
    friction = [_friction(one, values[name]) for name, one in fitted.items()]
    inertial = _inertial(arm, log, z)
    left = _unexplained(arm, first, fitted, on, z, friction)
    effort = np.stack([log.effort(bodies.joints[name]) for name in fitted])
    begins = np.append(True, np.diff(log.time) > 1.5 * step)
    since = log.time - np.maximum.accumulate(np.where(begins, log.time, -np.inf))
    begins |= np.append(False, np.diff(np.floor(since / seconds + 1e-6)) > 0)
    played, round_trip = np.empty((draws, len(fitted), log.time.size)), float(np.ptp(first.time))
    for k in range(draws):
        tell(Progress(f"roll-out {k + 1} of {draws}"))
        at = log.time + rng.uniform(0.0, round_trip)
        unexplained = [np.interp(at, *one, period=round_trip) for one in left]
        own = {key: np.stack([one[key][k] for one in friction], axis=-1) for key in NUMBERS}
        # when within a sample it was taken, and where it jumps, nobody tells
        then = log.time + step * rng.uniform(-0.5, 0.5)
        driven = [np.interp(then, log.time, one) for one in effort] - np.array(unexplained)
        played[k] = play(
            bodies.dynamics(inertial[k]), own, log.time, log.motion, driven, on, begins
        )
    low, middle, high = np.quantile(played, _BAND, axis=0)
    measured = log.motion[0, on]
    units = tuple("m" if bodies.joints[n].motion == "linear" else "rad" for n in fitted)
    out = log.name, seconds, (*fitted,), units, log.time, begins
    return ArmRollOut(*out, measured, low, middle, high)


def _inertial(arm: FittedArm, log: ArmLog, z: Array) -> Array:
    """Give the bodies' parameters ``(n, 10 n_links)`` in a log, for causes ``(n, n_causes)``."""
    columns = arm.doubt.columns(loaded=log.loaded)
    return np.asarray(columns[:, 0] + z @ columns[:, 1:].T)


def _friction(one: FittedJoint, values: Array) -> dict[str, Array]:
    """Lay out numbers ``(n, 2)`` by key, where the joint moves forwards and backwards.

    Of load losses the first is where the motor drives. ``values`` are ``(n, n_parameters)``.
    """
    assert one.result is not None
    names = one.result.fit.chain.names
    known = {name for number in NUMBERS.values() for name in number.parameters}
    if more := [n for n in names if n not in known and not n.startswith("load.urdf_")]:
        what = f"has {listed(more)}, which roll-outs of an arm do not"
        raise BadInput(f"joint {one.joint.name!r}", what, "fit it without, or leave the roll-out")
    found = {}
    for key, number in NUMBERS.items():
        own = [values[:, names.index(name)] for name in number.parameters if name in names]
        own = own or [np.zeros(len(values))]
        found[key] = np.stack([own[0], own[-1]], axis=1)
    return found


def _unexplained(
    arm: FittedArm,
    log: ArmLog,
    fitted: Mapping[str, FittedJoint],
    on: Index,
    z: Array,
    friction: Sequence[Mapping[str, Array]],
) -> list[tuple[Array, Array]]:
    """Give times and what is left of the effort there, of each joint while it moves."""
    mean = _inertial(arm, log, z.mean(axis=0, keepdims=True)).T
    carried = arm.bodies.torques(log.motion, np.repeat(mean[None], len(arm.bodies.joints), axis=0))
    found = []
    for one, j, own in zip(fitted.values(), on, friction, strict=True):
        assert one.result is not None
        o = one.result.model.observations[0]
        load = np.interp(o.stamps, log.time, carried[j, 0])
        c = {key: x.mean(axis=0) for key, x in own.items()}
        way, drives = (o.qd < 0.0).astype(int), (load * o.qd < 0.0).astype(int)
        torque = load + c["armature"][0] * o.qdd + c["offset"][0] + c["viscous"][way] * o.qd
        torque += (c["coulomb"][way] + c["load"][drives] * np.abs(load)) * np.sign(o.qd)
        moves = np.abs(o.qd) > float(o.settings["dead_zone"])
        found.append((o.stamps[moves], (o.compared - torque)[moves]))
    return found


def play(
    dynamics: Callable[[Array, Array], tuple[Array, Array]],
    friction: Mapping[str, Array],
    time: Array,
    motion: Array,
    effort: Array,
    on: Index,
    begins: Flags,
) -> Array:
    """Move driven joints by their efforts; gives their positions ``(n_on, n)``.

    Parameters
    ----------
    dynamics
        Of :meth:`~bayesfric.arm.inertial_prior.Bodies.dynamics`.
    friction
        ``(2, n_on)`` by the key of a number, see :func:`_friction`.
    time, motion
        ``(n,)`` s, and ``(3, n_joints, n)`` as measured.
    effort
        ``(n_on, n)`` N m or N.
    on
        ``(n_on,)`` which joints are driven.
    begins
        ``(n,)`` where the arm is put into the measured state.
    """
    q, qd, qdd = (x.T for x in motion)
    others, each = np.setdiff1d(np.arange(q.shape[1]), on), np.arange(on.size)
    own, held = np.ix_(on, on), np.ix_(on, others)
    out, c, armature = q[:, on].copy(), friction, np.diag(friction["armature"][0])
    v, a = qd[0, on], qdd[0, on]
    turns = (qd[:-1, on] * qd[1:, on] < 0.0).any(axis=1)
    most = np.ceil(np.diff(time) / np.where(turns, _TURN, _STEP) - 1e-6).astype(int)
    for i, step in enumerate(np.diff(time)):
        if begins[i + 1]:
            continue
        if begins[i]:
            v, a = qd[i, on], qdd[i, on]
        x, parts = out[i], most[i]
        h = step / parts
        for part in range(parts):
            # forces of the middle of the step, where the joint will be about
            share = (part + 0.5) / parts
            here, speed, push = (s[i] + share * (s[i + 1] - s[i]) for s in (q, qd, qdd))
            here[on], speed[on] = x + 0.5 * h * v, v + 0.5 * h * a
            mass, bias = dynamics(here, speed)
            still = bias[on] + mass[held] @ push[others]
            carried = still + mass[own] @ a
            way, drives = (v < 0.0).astype(int), (carried * v < 0.0).astype(int)
            rigid = mass[own] + armature
            drag = 0.5 * h * np.diag(c["viscous"][way, each])  # of the mean speed
            driven = effort[:, i] + share * (effort[:, i + 1] - effort[:, i])
            impulse = (rigid - drag) @ v + h * (driven - still - c["offset"][0])
            free = np.linalg.solve(rigid + drag, impulse)
            lost = c["coulomb"] + c["load"][drives, each] * np.abs(carried)
            after = _rubbed(rigid + drag, free, h * lost, v.copy())
            x, a, v = x + 0.5 * h * (v + after), (after - v) / h, after
        out[i + 1] = x
    return np.asarray(out.T)


@njit(cache=True)
def _rubbed(mass, free, lost, v):  # type: ignore[no-untyped-def]
    """Find the speed ``(n,)`` that impulses of at most ``lost`` ``(2, n)`` leave, from ``v`` on.

    By coordinate descent, which for this convex function ends at its minimum.
    """
    for _ in range(_SWEEPS):
        changed = 0.0
        for i in range(v.size):
            push = mass[i, i] * v[i]
            for j in range(v.size):
                push += mass[i, j] * (free[j] - v[j])
            new = (max(push - lost[0, i], 0.0) + min(push + lost[1, i], 0.0)) / mass[i, i]
            changed = max(changed, abs(new - v[i]))
            v[i] = new
        if changed < _FOUND:
            break
    return v
