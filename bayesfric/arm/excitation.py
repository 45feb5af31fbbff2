"""The next recording of an arm: a motion that narrows what is asked for, within limits.

All joints move at once along finite Fourier series [1]_: periodic, and here from rest to rest. The
torque is linear in friction and bodies, so the sds that a motion would leave follow from its Fisher
information and from what is known now, and no effort is simulated.

References
----------
.. [1] J. Swevers, C. Ganseman, D. B. Tükel, J. de Schutter, H. Van Brussel, "Optimal robot
   excitation and identification", IEEE Trans. Robotics and Automation 13 (1997) 730-740.
"""

from __future__ import annotations

import csv
import io
import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag, null_space
from scipy.optimize import minimize

from bayesfric.arm.inertial_prior import Bodies, Doubt
from bayesfric.arm.joint_numbers import NUMBERS
from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.progress import Progress, Shown, silent
from bayesfric.recordings.arrays import Array

# Numbers of a joint, and those that can be asked for.
_OWN = tuple(NUMBERS)
TERMS = tuple(key for key, one in NUMBERS.items() if one.title)
# Points a second of the arrays, and of what a controller interpolates; of these the fastest wave
# has at least so many that a spline is that wave.
_FINE, _PLAYED, _RESOLVED = 100, 20, 10
# Moments of the fastest wave at which motions are judged, to a percent of their sds, and at which
# their peaks are looked for.
_JUDGED, _PEAKS = 16, 40
# How wide a prior is, of the value.
_WIDE = 10.0
# Moments of largest effort for which a motion is made smaller, in so many halvings.
_WORST, _HALVINGS = 8, 6
# Motions tried, one in how many at random, and how many of the best are improved. From one start
# on a UR10, at 2500 motions, Powell's method came farthest, BFGS nearly as far, COBYQA too in twice
# the CPU time; L-BFGS-B, COBYLA, random steps and Nelder-Mead came less far.
_TRIES, _RANDOM, _IMPROVED = 4800, 10, 3


@dataclass(frozen=True)
class Limits:
    """Between what an arm has to stay, ``(n_joints,)`` each in the order of ``Bodies.joints``.

    Attributes
    ----------
    low, high
        Positions, rad or m; a joint is held still where they are the same.
    speed, acceleration, torque
        Magnitudes, may be infinite. Torque is what is expected: bodies as they are given, friction
        and armature.
    """

    low: Array
    high: Array
    speed: Array
    acceleration: Array
    torque: Array


@dataclass(frozen=True, eq=False)
class Excited:
    """A trajectory and what it is expected to bring.

    Attributes
    ----------
    joints, units
        Names, and ``"rad"`` or ``"m"``.
    time
        ``(n,)`` s, of one period with both its ends.
    motion
        ``(3, n_joints, n)`` position, speed and acceleration.
    torque
        ``(n_joints, n)`` expected effort, N m or N.
    sd_before, sd_after
        By ``"JOINT.armature"``, ``coulomb``, ``viscous`` and ``load``, as now known and with a
        recording of this motion besides; infinite where nothing is known.
    narrower
        How many times narrower, as a geometric mean, it leaves what is wanted than the median of
        the random motions that were tried.
    """

    joints: tuple[str, ...]
    units: tuple[str, ...]
    time: Array
    motion: Array
    torque: Array
    sd_before: Mapping[str, float]
    sd_after: Mapping[str, float]
    narrower: float

    def text(self, wanted: Sequence[str] | None = None) -> str:
        """Say how much narrower than now it will make what is wanted, all if left out."""
        found = [self.sd_before[name] / self.sd_after[name] for name in wanted or self.sd_after]
        mean = math.exp(float(np.mean(np.log([x for x in found if math.isfinite(x)] or [1.0]))))
        return (
            f"next motion: expected to make intervals {mean:.2g} times narrower than now, "
            f"{self.narrower:.2g} times narrower than a motion at random"
        )

    def as_json(self) -> dict[str, Any]:
        """Give what it is expected to bring; ``None`` where nothing is known."""
        sds = {"sd_before": self.sd_before, "sd_after": self.sd_after}
        told = {
            key: {name: sd if math.isfinite(sd) else None for name, sd in one.items()}
            for key, one in sds.items()
        }
        return {"seconds": float(self.time[-1]), **told, "narrower": self.narrower}

    def as_csv(self) -> str:
        """Write it as a log: time, then position, velocity, acceleration and effort by joint."""
        names, columns = ["time [s]"], [self.time]
        for j, (name, unit) in enumerate(zip(self.joints, self.units, strict=True)):
            names += [f"position[{name}] [{unit}]", f"velocity[{name}] [{unit}/s]"]
            names += [f"acceleration[{name}] [{unit}/s^2]"]
            names += [f"effort[{name}] [{'N' if unit == 'm' else 'N m'}]"]
            columns += [*self.motion[:, j], self.torque[j]]
        out = io.StringIO()
        csv.writer(out, lineterminator="\n").writerows([names, *np.stack(columns, 1).tolist()])
        return out.getvalue()

    def as_joint_trajectory(self) -> str:
        """Write it as YAML of a ``trajectory_msgs/msg/JointTrajectory``, 20 points a second.

        It begins at its first point: bring the arm there before.
        """
        lines = [f"joint_names: {json.dumps(self.joints)}", "points:"]
        step = _FINE // _PLAYED
        for at, point in zip(self.time[::step], self.motion.T[::step], strict=True):
            kinds = zip(("positions", "velocities", "accelerations"), point.T, strict=True)
            # in fixed point, as YAML 1.1 takes 1e-05 for a text
            rows = [f"{kind}: [{', '.join(f'{x:.9f}' for x in row)}]" for kind, row in kinds]
            sec, nanosec = divmod(round(float(at) * 1e9), 10**9)
            rows.append(f"time_from_start: {{sec: {sec}, nanosec: {nanosec}}}")
            lines.append("- " + "\n  ".join(rows))
        return "\n".join(lines) + "\n"


def limits_of(bodies: Bodies, *, visited: Array | None = None) -> Limits:
    """Take limits of position, speed and torque from a URDF.

    That of acceleration is what reaches the speed limit in half a second.

    **Nothing here knows where the arm hits itself, a table or a wall**: iDynTree has no collision
    check. With ``visited`` each joint stays where it has been, which is much safer but no warrant:
    joints meet in combinations that the log may not have. Look at the motion in a simulator first.

    Parameters
    ----------
    bodies
        Of the URDF.
    visited
        ``(n_joints, 2)`` lowest and highest positions of a log, between which to stay. Without,
        joints that turn without end get ±π.

    Raises
    ------
    BadInput
        If a limit is no number.
    """
    rows, keys = [], ("lower", "upper", "velocity", "effort")
    for name, joint in bodies.joints.items():
        try:
            row = [float(joint.limit.get(key, 0.0)) for key in keys]
        except ValueError as error:
            what = f"a limit of {name!r} is no number ({error})"
            raise BadInput(str(bodies.path), what, f"write {', '.join(keys)}") from None
        if joint.endless or row[0] >= row[1]:  # the latter is how none is written
            end = math.pi if joint.endless and visited is None else math.inf
            row[:2] = -end, end
        rows.append(row)
    low, high, speed, torque = np.array(rows).T
    if visited is not None:
        low, high = np.maximum(low, visited[:, 0]), np.minimum(high, visited[:, 1])
    return Limits(low, high, speed, 2.0 * speed, torque)


def exciting(
    bodies: Bodies,
    doubt: Doubt,
    friction: Mapping[str, Mapping[str, float]],
    noise: Mapping[str, float],
    limits: Limits,
    *,
    wanted: Sequence[str] | None = None,
    known: Mapping[str, Array] | None = None,
    seconds: float = 20.0,
    harmonics: int = 5,
    seed: int | None = None,
    tries: int | None = None,
    tell: Shown = silent,
) -> Excited:
    """Find a motion of all joints that leaves the least mean log sd of what is wanted.

    Parameters
    ----------
    bodies, doubt
        What the URDF asks of the joints, and how well that is now known.
    friction
        By joint, ``armature``, ``coulomb``, ``viscous``, ``load`` and ``offset`` as they are now
        believed to be, at the joint; zero if left out.
    noise
        By joint, the density of the effort's residual at low frequency, (N m)² s: were it white,
        its variance times the sampling period. A joint without tells nothing.
    limits
        Between which the motion stays. A joint that is held tells nothing either.
    wanted
        Numbers such as ``"elbow.viscous"``; by default the first four of each joint that tells.
    known
        By joint, precision ``(5, 5)`` of its friction, in the order above, by the data there are.
        Priors beside it are ten times as wide as the value, and flat where that is zero.
    seconds, harmonics
        Period, and waves of each joint in it.
    seed
        Decides all.
    tries
        Motions tried, about.
    tell
        Called with each stage before it begins.

    Raises
    ------
    BadInput
        If a wanted number is none, limits leave no room, or time is too short for the harmonics.
    """
    search = _Search(bodies, doubt, friction, noise, limits, known or {}, seconds, harmonics)
    for name in wanted or ():
        if name not in search.numbers:
            what = "is no number that a recording of this arm within these limits tells"
            raise BadInput(f"wanted: {name}", what, nearest(name, search.numbers))
    at = [search.numbers[name] for name in wanted or search.numbers]

    def score(sds: Array) -> float:
        return float(np.mean(np.log(np.minimum(sds[at], sys.float_info.max))))

    def judged(x: Array) -> float:
        return score(search.sds(search.kept(x, search.judged)))

    tries = max(tries or _TRIES, _RANDOM * _IMPROVED)
    tell(Progress("motions at random"))
    starts = np.random.default_rng(seed).normal(size=(tries // _RANDOM, search.size))
    before, scores = search.sds(None), np.array([judged(x) for x in starts])
    able = scores < score(before)
    no = BadInput("limits", "leave no motion the torque to tell what is wanted", "give wider ones")
    if not able.any():
        raise no
    found = []
    for k in np.argsort(scores)[:_IMPROVED]:
        tell(Progress("better motions"))
        budget = (tries - len(starts)) // _IMPROVED
        options: Any = {"maxfev": budget, "xtol": 0.01, "ftol": 1e-3}
        found.append(minimize(judged, starts[k], method="Powell", options=options))
    best = min(found, key=lambda one: float(one.fun)).x
    time = np.linspace(0.0, seconds, math.floor(seconds * _PLAYED) * (_FINE // _PLAYED) + 1)
    kept = search.kept(best, search.basis(time))
    after = search.sds(kept)
    if kept is None or not np.isfinite(after[at]).all():
        raise no
    return Excited(
        tuple(bodies.joints),
        tuple("m" if one.motion == "linear" else "rad" for one in bodies.joints.values()),
        time,
        kept.motion,
        kept.torque,
        {name: float(before[k]) for name, k in search.numbers.items()},
        {name: float(after[k]) for name, k in search.numbers.items()},
        math.exp(float(np.median(scores[able])) - score(after)),
    )


class _Effort(NamedTuple):
    """What a motion takes."""

    motion: Array  # (3, n_joints, n)
    torque: Array  # (n_joints, n) expected effort
    columns: Array  # (n_joints, n_causes + 5, n) its derivatives by all that a joint has unknown


class _Search:
    """Motions of an arm, each made of ``size`` numbers, and what they tell."""

    def __init__(
        self,
        bodies: Bodies,
        doubt: Doubt,
        friction: Mapping[str, Mapping[str, float]],
        noise: Mapping[str, float],
        limits: Limits,
        known: Mapping[str, Array],
        seconds: float,
        harmonics: int,
    ) -> None:
        order, most = list(bodies.joints), (limits.speed, limits.acceleration, limits.torque)
        room = np.isfinite(limits.high - limits.low) & (limits.high >= limits.low)
        for name, good in zip(order, room & (np.min(most, axis=0) > 0.0), strict=True):
            if not good:
                what = "are missing or leave no room"
                raise BadInput(f"limits of {name!r}", what, "give wider ones")
        least = max(harmonics, 2) * _RESOLVED / _PLAYED
        if harmonics < 2 or not least <= seconds < math.inf:
            what = f"is no time for {harmonics} harmonics from rest to rest"
            raise BadInput(f"{seconds:g} s", what, f"give at least two, and {least:g} s")
        self._at = np.flatnonzero(limits.high > limits.low)
        self._told = [(j, noise[order[j]]) for j in self._at.tolist() if order[j] in noise]
        if not self._told:
            what = "leave no joint whose noise is known room to move"
            raise BadInput("limits", what, "give wider ones")
        self._bodies, self._limits, self._seconds = bodies, limits, seconds
        self._parameters = np.repeat(doubt.columns(loaded=True)[None], len(order), axis=0)
        self._values = np.array([[friction.get(n, {}).get(t, 0.0) for t in _OWN] for n in order])
        sd = _WIDE * np.abs(self._values)
        told = np.divide(1.0, sd**2, out=np.zeros_like(sd), where=sd > 0.0)
        own = [np.diag(told[j]) + known.get(order[j], 0.0) for j, _ in self._told]
        # of all that is unknown: the bodies', then each joint's own
        self._causes = doubt.spread.shape[1]
        self._prior = np.asarray(block_diag(np.eye(self._causes), *own))
        self.numbers = {
            f"{order[j]}.{term}": self._causes + k * len(_OWN) + i
            for k, (j, _) in enumerate(self._told)
            for i, term in enumerate(TERMS)
        }
        self._harmonics = np.arange(1, harmonics + 1)
        # at both ends no speed, which is of cosines, and no acceleration, which is of sines
        ends = np.kron(np.eye(2), np.ones(harmonics)) * np.r_[np.ones(harmonics), self._harmonics]
        self._free = np.asarray(null_space(ends))
        self._each = self._free.shape[1] + 1
        self.size = self._at.size * self._each
        self._peaks, self.judged = (
            self.basis((np.arange(n * harmonics) + 0.5) * seconds / (n * harmonics))
            for n in (_PEAKS, _JUDGED)
        )

    def basis(self, time: Array) -> Array:
        """Give position, speed and acceleration of each way to move, ``(3, n_ways, n)``."""
        w = 2.0 * np.pi / self._seconds * self._harmonics[:, None]
        time = time % self._seconds
        sin, cos = np.sin(w * time), np.cos(w * time)
        series = np.array([[sin / w, -cos / w], [cos, sin], [-w * sin, w * cos]])
        out = np.asarray(self._free.T @ series.reshape(3, -1, time.size))
        out[1:, :, time == 0.0] = 0.0  # but for rounding, of which Coulomb friction takes the sign
        return out

    def kept(self, x: Array, basis: Array) -> _Effort | None:
        """Make the largest motion of a shape within the limits; none where it cannot stand."""
        centre, waves = self._scaled(x)

        def load(found: _Effort) -> Array:
            return np.asarray(np.max(np.abs(found.torque) / self._limits.torque[:, None], axis=0))

        while waves.any():
            found = self._effort(centre, waves, basis)
            over = load(found)
            if over.max() <= 1.0:
                return found
            few, low, high = basis[:, :, np.argsort(over)[-_WORST:]], 0.0, 1.0
            for _ in range(_HALVINGS):
                share = (low + high) / 2.0
                fits = load(self._effort(centre, share * waves, few, 1)).max() <= 1.0
                low, high = (share, high) if fits else (low, share)
            waves = low * waves
        return None

    def sds(self, recorded: _Effort | None) -> Array:
        """Say how well all is known with a recording besides; infinite where nothing is."""
        told, count = self._prior.copy(), len(_OWN)
        for k, (j, noise) in enumerate(self._told):
            if recorded is None:
                break
            x, first = recorded.columns[j], self._causes + k * count
            here = np.r_[: self._causes, first : first + count]
            told[np.ix_(here, here)] += x @ x.T * (self._seconds / x.shape[1] / noise)
        some = np.diag(told) > 0.0
        out, unit = np.full(some.size, np.inf), 1.0 / np.sqrt(np.diag(told)[some])
        try:
            root = np.linalg.cholesky(unit[:, None] * told[np.ix_(some, some)] * unit)
        except np.linalg.LinAlgError:
            return out
        out[some] = unit * np.linalg.norm(np.linalg.inv(root), axis=0)
        return out

    def _scaled(self, x: Array) -> tuple[Array, Array]:
        """Make centres ``(n_joints,)`` and waves ``(n_joints, n_ways)`` that fill their limits.

        The last of a joint's numbers says where it is in the room that its waves leave.
        """
        at, limits, x = self._at, self._limits, x.reshape(-1, self._each)
        shape = x[:, :-1] @ self._peaks
        # between samples waves rise no higher (Ehlich and Zeller 1964)
        rise = 1.0 / math.cos(math.pi / _PEAKS)
        top, bottom = shape[0].max(axis=1), shape[0].min(axis=1)
        half, room = rise * (top - bottom) / 2.0, (limits.high - limits.low)[at] / 2.0
        speed, acceleration = rise * np.abs(shape[1:]).max(axis=2)
        fits = room / half, limits.speed[at] / speed, limits.acceleration[at] / acceleration
        size = np.min(fits, axis=0)
        centre, waves = limits.low.copy(), np.zeros((limits.low.size, self._each - 1))
        centre[at] += room + np.tanh(x[:, -1]) * (room - size * half) - size * (top + bottom) / 2.0
        waves[at] = size[:, None] * x[:, :-1]
        return centre, waves

    def _effort(
        self, centre: Array, waves: Array, basis: Array, count: int | None = None
    ) -> _Effort:
        """Ask what a motion takes, and ``count - 1`` causes of it, all if left out."""
        motion = waves @ basis
        motion[0] += centre[:, None]
        torque = self._bodies.torques(motion, self._parameters[:, :, :count])
        urdf, (_, qd, qdd) = torque[:, 0], motion
        sign = np.sign(qd)
        own = np.stack([qdd, sign, qd, np.abs(urdf) * sign, np.ones_like(qd)], axis=1)
        effort = urdf + np.einsum("jt,jtn->jn", self._values, own)
        gain = 1.0 + self._values[:, _OWN.index("load"), None] * np.sign(urdf) * sign
        return _Effort(motion, effort, np.concatenate([gain[:, None] * torque[:, 1:], own], axis=1))
