"""The next recording of an arm: a motion that narrows the intervals of numbers, within limits.

All joints move at once along finite Fourier series [1]_: periodic, and here from rest to rest. The
torque is linear in friction and inertial parameters, so the sds after a motion follow from its
Fisher information and the present knowledge, and no effort is simulated.

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
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag, null_space
from scipy.optimize import minimize

from bayesfric.arm.arm_options import NUMBERS
from bayesfric.arm.fitted_arm import FittedArm, FittedJoint
from bayesfric.arm.inertial_prior import Bodies, InertialPrior
from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.progress import Progress, ProgressCallback, no_progress
from bayesfric.estimates.autoregression import long_run_variance
from bayesfric.estimates.torque import places
from bayesfric.recordings.arrays import Array

# Numbers of a joint, and those that can be wanted.
_KEYS = tuple(NUMBERS)
TERMS = tuple(key for key, number in NUMBERS.items() if number.title)
# Samples a second of the arrays, and points a second that a controller interpolates; of these the
# fastest wave has at least so many that a spline is that wave.
_RATE, _POINT_RATE, _POINTS_PER_WAVE = 100, 20, 10
# Samples of the fastest wave by which motions are compared, to a percent of their sds, and by which
# their peaks are found.
_COMPARED, _PEAKS = 16, 40
# Sd of a prior, relative to the value.
_WIDE = 10.0
# Samples of largest effort by which a motion is scaled down, by so many bisections.
_LARGEST, _BISECTIONS = 8, 6
# Motions evaluated, one in how many at random, and how many of the best are improved. From one
# start on a UR10, at 2500 motions, Powell's method came farthest, BFGS nearly as far, COBYQA too in
# twice the CPU time; L-BFGS-B, COBYLA, random steps and Nelder-Mead came less far.
_TRIES, _RANDOM, _IMPROVED = 4800, 10, 3


@dataclass(frozen=True)
class Limits:
    """Limits of a motion, ``(n_joints,)`` each in the order of ``Bodies.joints``."""

    low: Array  # positions, rad or m; a joint is held still where they are equal
    high: Array
    speed: Array  # magnitudes, may be infinite
    acceleration: Array
    torque: Array  # of the expected effort


@dataclass(frozen=True, eq=False)
class ExcitingTrajectory:
    """A trajectory and the sds that it is expected to give.

    ``sd_before`` and ``sd_after`` are by ``"JOINT.armature"``, ``coulomb``, ``viscous`` and
    ``load``, infinite where nothing is known. ``narrower`` compares the wanted sds, as a geometric
    mean, with those of the median of random motions.
    """

    joints: tuple[str, ...]
    units: tuple[str, ...]  # "rad" or "m"
    time: Array  # (n,) s, one period with both its ends
    motion: Array  # (3, n_joints, n) position, speed and acceleration
    torque: Array  # (n_joints, n) expected effort, N m or N
    sd_before: Mapping[str, float]
    sd_after: Mapping[str, float]
    narrower: float

    def text(self, wanted: Sequence[str] | None = None) -> str:
        """Summarise how much narrower the wanted intervals, or all, are expected to be."""
        ratios = [self.sd_before[name] / self.sd_after[name] for name in wanted or self.sd_after]
        mean = math.exp(float(np.mean(np.log([x for x in ratios if math.isfinite(x)] or [1.0]))))
        return (
            f"next motion: expected to make intervals {mean:.2g} times narrower than now, "
            f"{self.narrower:.2g} times narrower than a motion at random"
        )

    def as_json(self) -> dict[str, Any]:
        """Give duration and sds; ``None`` where nothing is known."""
        before, after = (
            {name: sd if math.isfinite(sd) else None for name, sd in sds.items()}
            for sds in (self.sd_before, self.sd_after)
        )
        sds = {"sd_before": before, "sd_after": after}
        return {"seconds": float(self.time[-1]), **sds, "narrower": self.narrower}

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

        The arm has to be moved to the first point before.
        """
        lines = [f"joint_names: {json.dumps(self.joints)}", "points:"]
        step = _RATE // _POINT_RATE
        for at, point in zip(self.time[::step], self.motion.T[::step], strict=True):
            kinds = zip(("positions", "velocities", "accelerations"), point.T, strict=True)
            # in fixed point, as YAML 1.1 reads 1e-05 as a text
            rows = [f"{kind}: [{', '.join(f'{x:.9f}' for x in row)}]" for kind, row in kinds]
            sec, nanosec = divmod(round(float(at) * 1e9), 10**9)
            rows.append(f"time_from_start: {{sec: {sec}, nanosec: {nanosec}}}")
            lines.append("- " + "\n  ".join(rows))
        return "\n".join(lines) + "\n"


def limits_of(bodies: Bodies, *, visited: Array | None = None) -> Limits:
    """Take limits of position, speed and torque from a URDF.

    The acceleration limit reaches the speed limit in half a second. **Collisions with the arm
    itself, a table or a wall are not checked**: with ``visited`` ``(n_joints, 2)`` each joint stays
    in the range of its log, which is much safer, but joints meet in combinations that the log may
    not have. Look at the motion in a simulator first. Without, endless joints get ±π.
    """
    rows, keys = [], ("lower", "upper", "velocity", "effort")
    for name, joint in bodies.joints.items():
        try:
            row = [float(joint.limit.get(key, 0.0)) for key in keys]
        except ValueError as error:
            problem = f"a limit of {name!r} is no number ({error})"
            raise BadInput(str(bodies.path), problem, f"write {', '.join(keys)}") from None
        if joint.endless or row[0] >= row[1]:  # the latter means that there is no limit
            end = math.pi if joint.endless and visited is None else math.inf
            row[:2] = -end, end
        rows.append(row)
    low, high, speed, torque = np.array(rows).T
    if visited is not None:
        low, high = np.maximum(low, visited[:, 0]), np.minimum(high, visited[:, 1])
    return Limits(low, high, speed, 2.0 * speed, torque)


def next_motion(
    arm: FittedArm,
    wanted: Sequence[str] | None = None,
    *,
    seconds: float = 20.0,
    seed: int | None = None,
    progress: ProgressCallback = no_progress,
) -> ExcitingTrajectory:
    """Find the motion whose recording adds most to a fitted arm's.

    It stays between positions where the arm has been, and within the URDF's limits. ``wanted`` are
    numbers such as ``"elbow_joint.load"``, by default all.
    """
    z, prior = arm.consistency.draws, arm.prior
    present = replace(
        prior,
        nominal=prior.nominal + prior.spread @ z.mean(axis=0),
        spread=prior.spread @ np.linalg.cholesky(np.cov(z.T)),
    )
    fitted = {name: joint for name, joint in arm.joints.items() if joint.result is not None}
    return exciting_trajectory(
        arm.bodies,
        present,
        {name: joint.numbers for name, joint in fitted.items()},
        {name: _noise_density(joint) for name, joint in fitted.items()},
        limits_of(arm.bodies, visited=arm.visited),
        wanted=wanted,
        known={name: _precision(joint) for name, joint in fitted.items()},
        seconds=seconds,
        seed=seed,
        progress=progress,
    )


def _noise_density(joint: FittedJoint) -> float:
    """Density of the effort's residual at low frequency, (N m)² s or N² s."""
    assert joint.result is not None
    target, posterior = joint.result.fit.target, joint.result.fit.posterior
    o, *_ = joint.result.model.observations
    torque, *_ = target.likelihood.predict(target.chain_values(posterior.median[None]))
    residual = o.measured - torque[0]
    variance = long_run_variance(residual - residual.mean(), places([o]))
    return float(variance / residual.size * o.period)


def _precision(joint: FittedJoint) -> Array:
    """Precision ``(5, 5)`` of a joint's friction, zero of numbers that it does not have."""
    sd = np.full(len(NUMBERS), np.inf)
    for k, key in enumerate(NUMBERS):
        sds = [row.reported.sd for row in joint.number_rows(key)]
        if sds:
            sd[k] = np.mean(sds)
    return np.diag(sd**-2.0)


def exciting_trajectory(
    bodies: Bodies,
    prior: InertialPrior,
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
    progress: ProgressCallback = no_progress,
) -> ExcitingTrajectory:
    """Find a motion of all joints that minimises the mean log sd of the wanted numbers.

    ``friction`` holds the present estimates by joint, ``noise`` the density of the effort's
    residual at low frequency, (N m)² s: of white noise its variance times the sampling period. A
    joint without noise, or that is held, has no information. ``known`` is the precision ``(5, 5)``
    of a joint's friction by the data; its prior has 10 times the value as sd, flat at zero.
    """
    search = _Search(bodies, prior, friction, noise, limits, known or {}, seconds, harmonics)
    for name in wanted or ():
        if name not in search.numbers:
            problem = "a recording of this arm within these limits does not identify it"
            raise BadInput(f"wanted: {name}", problem, nearest(name, search.numbers))
    at = [search.numbers[name] for name in wanted or search.numbers]

    def score(sds: Array) -> float:
        return float(np.mean(np.log(np.minimum(sds[at], sys.float_info.max))))

    def score_of(x: Array) -> float:
        return score(search.sds(search.largest(x, search.compared)))

    tries = max(tries or _TRIES, _RANDOM * _IMPROVED)
    progress(Progress("motions at random"))
    starts = np.random.default_rng(seed).normal(size=(tries // _RANDOM, search.size))
    before, scores = search.sds(None), np.array([score_of(x) for x in starts])
    informative = scores < score(before)
    impossible = BadInput(
        "limits", "allow no motion the torque to identify the wanted numbers", "give wider ones"
    )
    if not informative.any():
        raise impossible
    optima = []
    for k in np.argsort(scores)[:_IMPROVED]:
        progress(Progress("better motions"))
        budget = (tries - len(starts)) // _IMPROVED
        options: Any = {"maxfev": budget, "xtol": 0.01, "ftol": 1e-3}
        optima.append(minimize(score_of, starts[k], method="Powell", options=options))
    best = min(optima, key=lambda optimum: float(optimum.fun)).x
    time = np.linspace(0.0, seconds, math.floor(seconds * _POINT_RATE) * (_RATE // _POINT_RATE) + 1)
    motion = search.largest(best, search.basis(time))
    after = search.sds(motion)
    if motion is None or not np.isfinite(after[at]).all():
        raise impossible
    return ExcitingTrajectory(
        tuple(bodies.joints),
        tuple("m" if joint.motion == "linear" else "rad" for joint in bodies.joints.values()),
        time,
        motion.motion,
        motion.torque,
        {name: float(before[k]) for name, k in search.numbers.items()},
        {name: float(after[k]) for name, k in search.numbers.items()},
        math.exp(float(np.median(scores[informative])) - score(after)),
    )


class _Effort(NamedTuple):
    """A motion and the effort that it takes."""

    motion: Array  # (3, n_joints, n)
    torque: Array  # (n_joints, n) expected effort
    columns: Array  # (n_joints, n_deviations + 5, n) its derivatives by all unknowns of a joint


class _Search:
    """Motions of an arm, each given by ``size`` numbers, and their information."""

    def __init__(
        self,
        bodies: Bodies,
        prior: InertialPrior,
        friction: Mapping[str, Mapping[str, float]],
        noise: Mapping[str, float],
        limits: Limits,
        known: Mapping[str, Array],
        seconds: float,
        harmonics: int,
    ) -> None:
        order = list(bodies.joints)
        smallest = np.min((limits.speed, limits.acceleration, limits.torque), axis=0)
        bounded = np.isfinite(limits.high - limits.low) & (limits.high >= limits.low)
        for name, usable in zip(order, bounded & (smallest > 0.0), strict=True):
            if not usable:
                problem = "are missing, or do not allow a motion"
                raise BadInput(f"limits of {name!r}", problem, "give wider ones")
        shortest = max(harmonics, 2) * _POINTS_PER_WAVE / _POINT_RATE
        if harmonics < 2 or not shortest <= seconds < math.inf:
            problem = f"is no time for {harmonics} harmonics from rest to rest"
            raise BadInput(f"{seconds:g} s", problem, f"give at least two, and {shortest:g} s")
        self._moving = np.flatnonzero(limits.high > limits.low)
        # joints with information, and their noise
        self._joints = [(j, noise[order[j]]) for j in self._moving.tolist() if order[j] in noise]
        if not self._joints:
            problem = "do not allow a motion of any joint whose noise is known"
            raise BadInput("limits", problem, "give wider ones")
        self._bodies, self._limits, self._seconds = bodies, limits, seconds
        self._parameters = np.repeat(prior.columns(loaded=True)[None], len(order), axis=0)
        self._values = np.array([[friction.get(n, {}).get(k, 0.0) for k in _KEYS] for n in order])
        sd = _WIDE * np.abs(self._values)
        precision = np.divide(1.0, sd**2, out=np.zeros_like(sd), where=sd > 0.0)
        blocks = [np.diag(precision[j]) + known.get(order[j], 0.0) for j, _ in self._joints]
        # of all unknowns: deviations of the inertial parameters, then each joint's numbers
        self._deviations = prior.spread.shape[1]
        self._prior = np.asarray(block_diag(np.eye(self._deviations), *blocks))
        self.numbers = {
            f"{order[j]}.{term}": self._deviations + k * len(_KEYS) + i
            for k, (j, _) in enumerate(self._joints)
            for i, term in enumerate(TERMS)
        }
        self._harmonics = np.arange(1, harmonics + 1)
        # zero speed at both ends constrains the cosines, zero acceleration the sines
        ends = np.kron(np.eye(2), np.ones(harmonics)) * np.r_[np.ones(harmonics), self._harmonics]
        self._free = np.asarray(null_space(ends))
        self._per_joint = self._free.shape[1] + 1
        self.size = self._moving.size * self._per_joint
        self._peaks, self.compared = (
            self.basis((np.arange(n * harmonics) + 0.5) * seconds / (n * harmonics))
            for n in (_PEAKS, _COMPARED)
        )

    def basis(self, time: Array) -> Array:
        """Give position, speed and acceleration of each free wave, ``(3, n_waves, n)``."""
        w = 2.0 * np.pi / self._seconds * self._harmonics[:, None]
        time = time % self._seconds
        sin, cos = np.sin(w * time), np.cos(w * time)
        series = np.array([[sin / w, -cos / w], [cos, sin], [-w * sin, w * cos]])
        out = np.asarray(self._free.T @ series.reshape(3, -1, time.size))
        out[1:, :, time == 0.0] = 0.0  # Coulomb friction would take the sign of a rounding error
        return out

    def largest(self, x: Array, basis: Array) -> _Effort | None:
        """Scale a shape to the limits; ``None`` where the arm cannot even hold its position."""
        centre, waves = self._scaled(x)

        def load(effort: _Effort) -> Array:
            return np.asarray(np.max(np.abs(effort.torque) / self._limits.torque[:, None], axis=0))

        while waves.any():
            effort = self._effort(centre, waves, basis)
            loads = load(effort)
            if loads.max() <= 1.0:
                return effort
            largest, low, high = basis[:, :, np.argsort(loads)[-_LARGEST:]], 0.0, 1.0
            for _ in range(_BISECTIONS):
                share = (low + high) / 2.0
                fits = load(self._effort(centre, share * waves, largest, 1)).max() <= 1.0
                low, high = (share, high) if fits else (low, share)
            waves = low * waves
        return None

    def sds(self, recorded: _Effort | None) -> Array:
        """Give the sds of all unknowns with a recording added; infinite where nothing is known."""
        information, count = self._prior.copy(), len(_KEYS)
        for k, (j, noise) in enumerate(self._joints):
            if recorded is None:
                break
            x, first = recorded.columns[j], self._deviations + k * count
            at = np.r_[: self._deviations, first : first + count]
            information[np.ix_(at, at)] += x @ x.T * (self._seconds / x.shape[1] / noise)
        informed = np.diag(information) > 0.0
        out, unit = np.full(informed.size, np.inf), 1.0 / np.sqrt(np.diag(information)[informed])
        scaled = unit[:, None] * information[np.ix_(informed, informed)] * unit
        try:
            root = np.linalg.cholesky(scaled)
        except np.linalg.LinAlgError:
            return out
        out[informed] = unit * np.linalg.norm(np.linalg.inv(root), axis=0)
        return out

    def _scaled(self, x: Array) -> tuple[Array, Array]:
        """Scale to the kinematic limits: centres ``(n_joints,)`` and waves ``(n_joints, n_waves)``.

        The last of a joint's numbers places the centre in the range that its waves leave.
        """
        at, limits, x = self._moving, self._limits, x.reshape(-1, self._per_joint)
        shape = x[:, :-1] @ self._peaks
        # bound of a wave between samples (Ehlich and Zeller 1964)
        rise = 1.0 / math.cos(math.pi / _PEAKS)
        top, bottom = shape[0].max(axis=1), shape[0].min(axis=1)
        half, room = rise * (top - bottom) / 2.0, (limits.high - limits.low)[at] / 2.0
        speed, acceleration = rise * np.abs(shape[1:]).max(axis=2)
        fits = room / half, limits.speed[at] / speed, limits.acceleration[at] / acceleration
        size = np.min(fits, axis=0)
        centre, waves = limits.low.copy(), np.zeros((limits.low.size, self._per_joint - 1))
        centre[at] += room + np.tanh(x[:, -1]) * (room - size * half) - size * (top + bottom) / 2.0
        waves[at] = size[:, None] * x[:, :-1]
        return centre, waves

    def _effort(
        self, centre: Array, waves: Array, basis: Array, count: int | None = None
    ) -> _Effort:
        """Compute the effort of a motion, and derivatives by ``count - 1`` deviations or all."""
        motion = waves @ basis
        motion[0] += centre[:, None]
        torque = self._bodies.torques(motion, self._parameters[:, :, :count])
        urdf, (_, qd, qdd) = torque[:, 0], motion
        sign = np.sign(qd)
        friction = np.stack([qdd, sign, qd, np.abs(urdf) * sign, np.ones_like(qd)], axis=1)
        effort = urdf + np.einsum("jt,jtn->jn", self._values, friction)
        gain = 1.0 + self._values[:, _KEYS.index("load"), None] * np.sign(urdf) * sign
        columns = np.concatenate([gain[:, None] * torque[:, 1:], friction], axis=1)
        return _Effort(motion, effort, columns)
