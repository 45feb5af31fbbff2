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

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag, null_space
from scipy.optimize import brentq, minimize

from bayesfric.arm.arm_options import NUMBERS, torque_columns
from bayesfric.arm.fitted_arm import FittedArm, FittedJoint
from bayesfric.arm.inertial_prior import Bodies, InertialPrior
from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.progress import Progress, ProgressCallback, no_progress
from bayesfric.base.templates import environment
from bayesfric.estimates.autoregression import long_run_variance
from bayesfric.estimates.torque import places
from bayesfric.recordings.arrays import Array

# Numbers of a joint, and those that can be wanted.
_KEYS = tuple(key for key in NUMBERS if key != "gain")  # which is taken as exact
TERMS = tuple(key for key in _KEYS if NUMBERS[key].title)
_HARMONICS = 5  # of the series
# Samples a second of the arrays, and points a second that a controller interpolates.
_RATE, _POINT_RATE = 100, 20
# Samples of the fastest wave by which motions are compared, to a percent of their sds, and by which
# their peaks are found.
_COMPARED, _PEAKS = 16, 40
# Motions that are evaluated, a tenth of them at random. From one start on a UR10, at 2500 motions,
# Powell's method came farthest, BFGS nearly as far, COBYQA too in twice the CPU time; L-BFGS-B,
# COBYLA, random steps and Nelder-Mead came less far.
_TRIES = 4800
# A motion and what it takes: (3, n_joints, n) position, speed and acceleration; (n_joints, n)
# expected effort; (n_joints, n_deviations + 5, n) its derivatives by all unknowns of a joint.
_Effort = tuple[Array, Array, Array]


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
        import pandas as pd

        columns = {"time [s]": self.time}
        for j, (name, unit) in enumerate(zip(self.joints, self.units, strict=True)):
            columns[f"position[{name}] [{unit}]"] = self.motion[0, j]
            columns[f"velocity[{name}] [{unit}/s]"] = self.motion[1, j]
            columns[f"acceleration[{name}] [{unit}/s^2]"] = self.motion[2, j]
            columns[f"effort[{name}] [{'N' if unit == 'm' else 'N m'}]"] = self.torque[j]
        return str(pd.DataFrame(columns).to_csv(index=False))

    def as_joint_trajectory(self) -> str:
        """Write it as YAML of a ``trajectory_msgs/msg/JointTrajectory``, 20 points a second.

        The arm has to be moved to the first point before.
        """
        step = _RATE // _POINT_RATE
        stamps = [divmod(round(t * 1e9), 10**9) for t in self.time[::step].tolist()]
        points = zip(stamps, self.motion.T[::step].transpose(0, 2, 1), strict=True)
        template = environment("bayesfric.arm").get_template("exciting.yaml.j2")
        return f"{template.render(joints=self.joints, points=points)}\n"


def limits_of(bodies: Bodies, visited: Array) -> Limits:
    """Take limits of position, speed and torque from a URDF.

    The acceleration limit reaches the speed limit in half a second. **Collisions with the arm
    itself, a table or a wall are not checked**: each joint stays in the range ``visited``
    ``(n_joints, 2)`` of its log, but joints meet in combinations that the log may not have. Look at
    the motion in a simulator first.
    """
    rows = [(joint.low, joint.high, joint.speed, joint.effort) for joint in bodies.joints.values()]
    low, high, speed, torque = np.array(rows).T
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
    if arm.bodies.motors is not None:
        raise BadInput("--advise", "has no limits of coupled joints", "leave it out")
    z, prior = arm.consistency.draws, arm.prior
    present = replace(
        prior,
        nominal=prior.nominal + prior.spread @ z.mean(axis=0),
        spread=prior.spread @ np.linalg.cholesky(np.cov(z.T)),
    )
    return exciting_trajectory(
        arm.bodies,
        present,
        {name: (_numbers(joint), _noise_density(joint)) for name, joint in arm.fitted.items()},
        limits_of(arm.bodies, arm.visited),
        wanted=wanted,
        seconds=seconds,
        seed=seed,
        progress=progress,
    )


def _numbers(joint: FittedJoint) -> Array:
    """Values and sds ``(2, 5)`` of a joint's numbers; 0 and infinite of those that it lacks."""
    numbers = np.stack([np.zeros(len(_KEYS)), np.full(len(_KEYS), np.inf)])
    for k, key in enumerate(_KEYS):
        rows = [(x.value, x.reported.sd) for x in joint.number_rows(key)]
        if rows:
            numbers[:, k] = np.mean(rows, axis=0)
    return numbers


def _noise_density(joint: FittedJoint) -> float:
    """Density of the effort's residual at low frequency, (N m)² s or N² s."""
    target, posterior = joint.fitted.fit.target, joint.fitted.fit.posterior
    o, *_ = joint.fitted.model.observations
    torque, *_ = target.likelihood.predict(target.chain_values(posterior.median[None]))
    residual = o.measured - torque[0]
    variance = long_run_variance(residual - residual.mean(), places([o]))
    return float(variance / residual.size * o.period)


def exciting_trajectory(
    bodies: Bodies,
    prior: InertialPrior,
    joints: Mapping[str, tuple[Array, float]],
    limits: Limits,
    *,
    wanted: Sequence[str] | None = None,
    seconds: float = 20.0,
    seed: int | None = None,
    progress: ProgressCallback = no_progress,
) -> ExcitingTrajectory:
    """Find a motion of all joints that minimises the mean log sd of the wanted numbers.

    ``joints`` holds the present values and sds ``(2, 5)`` of joints with information, and the
    density of their effort's residual at low frequency, (N m)² s: of white noise its variance times
    the sampling period.
    """
    search = _Search(bodies, prior, joints, limits, seconds)
    for name in wanted or ():
        if name not in search.numbers:
            problem = "a recording of this arm within these limits does not identify it"
            raise BadInput(f"wanted: {name}", problem, nearest(name, search.numbers))
    at = [search.numbers[name] for name in wanted or search.numbers]

    def score(sds: Array) -> float:
        return float(np.mean(np.log(np.minimum(sds[at], sys.float_info.max))))

    def score_of(x: Array) -> float:
        return score(search.sds(search.largest(x, search.compared)))

    progress(Progress("motions at random"))
    starts = np.random.default_rng(seed).normal(size=(_TRIES // 10, search.size))
    before, scores = search.sds(None), np.array([score_of(x) for x in starts])
    informative = scores < score(before)
    optima = []
    for k in np.argsort(scores)[:3] if informative.any() else ():
        progress(Progress("better motions"))
        options: Any = {"maxfev": 3 * _TRIES // 10, "xtol": 0.01, "ftol": 1e-3}
        optima.append(minimize(score_of, starts[k], method="Powell", options=options))
    time = np.linspace(0.0, seconds, math.floor(seconds * _POINT_RATE) * (_RATE // _POINT_RATE) + 1)
    motion = None
    if optima:
        best = min(optima, key=lambda optimum: float(optimum.fun)).x
        motion = search.largest(best, search.basis(time))
    after = search.sds(motion)
    if motion is None or not np.isfinite(after[at]).all():
        problem = "allow no motion the torque to identify the wanted numbers"
        raise BadInput("limits", problem, "give wider ones")
    return ExcitingTrajectory(
        tuple(bodies.joints),
        tuple("m" if joint.motion == "linear" else "rad" for joint in bodies.joints.values()),
        time,
        *motion[:2],
        {name: float(before[k]) for name, k in search.numbers.items()},
        {name: float(after[k]) for name, k in search.numbers.items()},
        math.exp(float(np.median(scores[informative])) - score(after)),
    )


class _Search:
    """Motions of an arm, each given by ``size`` numbers, and their information."""

    def __init__(
        self,
        bodies: Bodies,
        prior: InertialPrior,
        joints: Mapping[str, tuple[Array, float]],
        limits: Limits,
        seconds: float,
    ) -> None:
        order = list(bodies.joints)
        smallest = np.min((limits.speed, limits.acceleration, limits.torque), axis=0)
        bounded = np.isfinite(limits.high - limits.low) & (limits.high >= limits.low)
        for name, usable in zip(order, bounded & (smallest > 0.0), strict=True):
            if not usable:
                problem = "are missing, or do not allow a motion"
                raise BadInput(f"limits of {name!r}", problem, "give wider ones")
        shortest = 0.5 * _HARMONICS  # the fastest wave then has ten of a controller's points
        if not shortest <= seconds < math.inf:
            problem = "is no time for a motion from rest to rest"
            raise BadInput(f"{seconds:g} s", problem, f"give at least {shortest:g} s")
        self._moving = np.flatnonzero(limits.high > limits.low)
        # noise of the joints with information
        self._noise = {j: joints[order[j]][1] for j in self._moving if order[j] in joints}
        if not self._noise:
            problem = "do not allow a motion of any joint whose noise is known"
            raise BadInput("limits", problem, "give wider ones")
        self._bodies, self._limits, self._seconds = bodies, limits, seconds
        self._parameters = np.repeat(prior.columns(loaded=True)[None], len(order), axis=0)
        unknown = np.stack([np.zeros(len(_KEYS)), np.full(len(_KEYS), np.inf)])
        numbers = np.array([joints.get(name, (unknown,))[0] for name in order])
        self._values = numbers[:, 0]
        # of all unknowns: deviations of the inertial parameters, then each joint's numbers
        first = self._deviations = prior.spread.shape[1]
        sds = [numbers[j, 1] for j in self._noise]
        self._precision = np.diag(np.concatenate([np.ones(first), *sds]) ** -2.0)
        self.numbers = {
            f"{order[j]}.{term}": first + k * len(_KEYS) + i
            for k, j in enumerate(self._noise)
            for i, term in enumerate(TERMS)
        }
        # zero speed at both ends constrains the cosines, zero acceleration the sines
        ones, waves = np.ones(_HARMONICS), np.arange(1, _HARMONICS + 1)
        self._free = np.asarray(null_space(block_diag(ones, waves)))
        self.size = self._moving.size * (self._free.shape[1] + 1)
        self._peaks, self.compared = (
            self.basis((np.arange(n) + 0.5) * seconds / n)
            for n in (_PEAKS * _HARMONICS, _COMPARED * _HARMONICS)
        )

    def basis(self, time: Array) -> Array:
        """Give position, speed and acceleration of each free wave, ``(3, n_waves, n)``."""
        w = 2.0 * np.pi / self._seconds * np.arange(1, _HARMONICS + 1)[:, None]
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
            return np.asarray(np.max(np.abs(effort[1]) / self._limits.torque[:, None], axis=0))

        while True:
            effort = self._effort(centre, waves, basis)
            loads = load(effort)
            if loads.max() <= 1.0:
                return effort
            loaded = basis[:, :, np.argsort(loads)[-8:]]

            def excess(share: float, waves: Array = waves, loaded: Array = loaded) -> float:
                return float(load(self._effort(centre, share * waves, loaded, 1)).max()) - 1.0

            if excess(0.0) >= 0.0:
                return None
            waves = 0.99 * brentq(excess, 0.0, 1.0, xtol=0.01) * waves

    def sds(self, recorded: _Effort | None) -> Array:
        """Give the sds of all unknowns with a recording added; infinite where nothing is known."""
        information, count = self._precision.copy(), len(_KEYS)
        for k, (j, noise) in enumerate(self._noise.items()):
            if recorded is None:
                break
            x, first = recorded[2][j], self._deviations + k * count
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
        at, limits, x = self._moving, self._limits, x.reshape(self._moving.size, -1)
        shape = x[:, :-1] @ self._peaks
        # bound of a wave between samples (Ehlich and Zeller 1964)
        rise = 1.0 / math.cos(math.pi / _PEAKS)
        top, bottom = shape[0].max(axis=1), shape[0].min(axis=1)
        half, room = rise * (top - bottom) / 2.0, (limits.high - limits.low)[at] / 2.0
        speed, acceleration = rise * np.abs(shape[1:]).max(axis=2)
        fits = room / half, limits.speed[at] / speed, limits.acceleration[at] / acceleration
        size = np.min(fits, axis=0)
        centre, waves = limits.low.copy(), np.zeros((limits.low.size, x.shape[1] - 1))
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
        friction = np.swapaxes(torque_columns(urdf, qd, qdd), 0, 1)
        effort = urdf + np.einsum("jt,jtn->jn", self._values, friction)
        gain = 1.0 + self._values[:, _KEYS.index("load"), None] * np.sign(urdf) * np.sign(qd)
        columns = np.concatenate([gain[:, None] * torque[:, 1:], friction], axis=1)
        return motion, effort, columns
