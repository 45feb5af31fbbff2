"""Forward model: the motion under a motor torque, with true stiction, or under a drive's law.

While the joint keeps its direction and no element's transmitted torque changes sign, the equation
of motion is smooth and classical Runge-Kutta steps integrate it. Reversals, breakaway and sign
changes of a transmitted torque are located to rounding and the integration restarted there, so
nothing non-smooth is ever integrated across and the error falls with the fourth power of the step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike

from bayesfric.mechanism.integrate import (
    ACCELERATION,
    POSITION,
    SPEED,
    STICKS,
    Carried,
    integrate,
    integrate_segments,
    plant_of,
)
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.kernels import (
    GAIN,
    INERTIA,
    LOAD_BACK,
    LOAD_BACK_DIFFERENCE,
    LOAD_DRIVE,
    LOAD_DRIVE_DIFFERENCE,
    LOAD_INERTIA,
    RATIO,
    STRIBECK_LOAD_RATIO,
    STRIBECK_VELOCITY,
)
from bayesfric.mechanism.own_term import signal_of
from bayesfric.recordings.arrays import Array, Flags, Index
from bayesfric.recordings.filters import later
from bayesfric.recordings.measurement import Hold, Inputs, Law


class RunsAway(ValueError):
    """A simulated joint moved beyond 1e6 rad or m."""


@dataclass(frozen=True)
class Motion:
    """A simulated motion."""

    time: Array  # (N,) s, from zero
    q: Array  # (N,) of the joint, rad or m
    qd: Array  # (N,)
    qdd: Array  # (N,) right after the sample
    torque: Array  # (N,) measured motor torque, N m or N
    sticking: Flags  # (N,) where static friction holds the joint
    events: int  # located stops, breakaways and sign changes of transmitted torques
    reversals: int  # number of times that the joint moved off in the other direction
    step_error: float  # estimated largest error of q, rad or m; NaN for given substeps
    substeps: int  # integration steps per sample


def simulate(
    joint: Joint,
    values: ArrayLike,
    torque: ArrayLike,
    period: float,
    *,
    q0: float = 0.0,
    qd0: float = 0.0,
    inputs: Inputs = Inputs(),  # noqa: B008  (frozen)
    begin: float = 0.0,
    hold: Hold = "linear",
    substeps: int | None = None,
    tolerance: float = 1e-9,
) -> Motion:
    """Simulate the joint under a measured motor torque ``(N,)``, N m or N.

    Substeps are doubled until ``q`` changes by less than ``tolerance``, or to 64 a sample. The
    joint sticks while the torque lies within its breakaway torques; no friction law is smoothed.
    Raises ValueError where the acceleration is not unique, and :class:`RunsAway`.
    """
    measured = np.array(torque, dtype=np.float64)
    if not (np.isfinite([q0, qd0]).all() and np.isfinite(measured).all()):
        raise ValueError("torque, q0 and qd0 must be finite")
    vector = np.asarray(values, dtype=np.float64)
    elements, load, carried = _tables(joint, vector[np.newaxis], inputs)
    for reason, flags in _impossible(joint, vector[np.newaxis], elements, load).items():
        if flags[0]:
            raise ValueError(reason)
    plant = plant_of(elements, load, carried, 0)
    (acting,) = _acting(joint, vector[np.newaxis], measured, period)

    def run(each: int) -> Motion:
        """Integrate in ``each`` steps a sample; the error is not known."""
        out, counts = np.empty((4, measured.size)), np.zeros(2, dtype=np.int64)
        step, linear, start = float(period), hold != "zero", (float(q0), float(qd0))
        done = integrate(plant, acting, step, float(begin), linear, *start, each, out, counts)
        if done < measured.size:
            at = f"beyond 1e+06 rad or m after {done * period:g} s"
            raise RunsAway(f"the joint runs away: {at}")
        q, qd, qdd, sticks = out[[POSITION, SPEED, ACCELERATION, STICKS]]
        time = np.arange(measured.size, dtype=np.float64) * step
        events, reversals = counts.tolist()
        return Motion(time, q, qd, qdd, measured, sticks == 1.0, events, reversals, math.nan, each)

    if substeps is not None:
        return run(substeps)
    motion = run(2)
    while True:
        coarse, motion = motion, run(2 * motion.substeps)
        change = float(np.max(np.abs(motion.q - coarse.q)))
        if change < tolerance or motion.substeps >= 64:
            # of fourth order: half the step leaves a sixteenth of the error
            return replace(motion, step_error=change / 15.0)


def simulate_segments(
    joint: Joint,
    values: ArrayLike,
    torque: ArrayLike,
    period: float,
    segments: ArrayLike,
    q0: ArrayLike,
    qd0: ArrayLike,
    *,
    inputs: Inputs = Inputs(),  # noqa: B008  (frozen)
    begin: float = 0.0,
    hold: Hold = "linear",
    substeps: int = 2,
) -> tuple[Array, Array]:
    """Simulate vectors ``(n, d)`` from a given state in every segment ``(K, 2)``, in parallel.

    Returns positions and speeds ``(n, N)``, NaN where a vector has no motion, or runs away.
    """
    vectors = np.asarray(values, dtype=np.float64)
    ranges = np.asarray(segments, dtype=np.int64)
    shape = (len(vectors), len(ranges))
    start, speed = (
        np.ascontiguousarray(np.broadcast_to(np.asarray(x, np.float64), shape)) for x in (q0, qd0)
    )
    elements, load, carried = _tables(joint, vectors, inputs)
    q, qd = integrate_segments(
        elements,
        load,
        carried,
        _possible(joint, vectors, elements, load),
        _acting(joint, vectors, np.asarray(torque, dtype=np.float64), period),
        float(period),
        float(begin),
        hold != "zero",
        np.ascontiguousarray(ranges[:, 0]),
        np.ascontiguousarray(ranges[:, 1]),
        start,
        speed,
        substeps,
    )
    return np.asarray(q), np.asarray(qd)


def _tables(joint: Joint, vectors: Array, inputs: Inputs) -> tuple[Array, Array, Carried | None]:
    """Lay parameter vectors out for the forward model; a delay is no term of it."""
    elements, load, values = joint.tables(vectors, inputs)
    all_terms = joint.carried_terms(inputs)
    columns = [k for k, term in enumerate(all_terms) if term.row.column is not None]
    if not columns:
        return elements, load, None
    terms = [all_terms[k] for k in columns]
    signals = {k: signal_of(c.row, inputs) for k, c in enumerate(terms) if c.row.signal}
    # straight lines between the stamps of all are straight lines of each
    stamps = np.unique(
        np.concatenate([np.zeros(1), *(signal.stamps for signal in signals.values())])
    )
    levels = np.ones((len(terms), stamps.size))
    for k, signal in signals.items():
        levels[k] = signal.at(stamps) - terms[k].row.zero
    carried = Carried(
        np.ascontiguousarray(values[:, columns]),
        np.array([c.place for c in terms], dtype=np.int64),
        np.array([c.address for c in terms], dtype=np.int64),
        np.ascontiguousarray(stamps, dtype=np.float64),
        levels,
    )
    return elements, load, carried


def _acting(joint: Joint, vectors: Array, torque: Array, period: float) -> Array:
    """Give the torque at the time that the recorded motion shows it: ``(1, N)``, or each vector's.

    With a delay that is unknown each vector has its own.
    """
    if not joint.delay or joint.by_target:
        return torque[np.newaxis]
    return np.stack([later(torque, s) for s in (joint.delays(vectors) / period).tolist()])


def _impossible(joint: Joint, vectors: Array, elements: Array, load: Array) -> dict[str, Flags]:
    """Flag the vectors that are outside the support, or have no single motion, by reason.

    A motion is unique where the motor torque rises with the acceleration for every direction of
    power. It does not where ``mu_2`` is so far above one that the inertia on the motor side does
    not outweigh it. Growth of load-dependent friction with speed or load is left out of this.
    """
    reasons = {
        f"{p.name} is not finite, or outside its support": ~(
            np.isfinite(x) & (x >= p.lower) & (x <= p.upper)
        )
        for p, x in zip(joint.parameters, vectors.T, strict=True)
    }
    speeds = elements[:, :, STRIBECK_VELOCITY]
    low, high = slope_bounds(elements, load[:, LOAD_INERTIA])
    return reasons | {
        "gain and Stribeck velocities must be greater than zero": ~(
            (load[:, GAIN] > 0) & np.all(speeds > 0, axis=1)
        ),
        "the chain has no inertia, so a torque does not determine its motion": ~(high > 0),
        "irreversible gearbox: its loss when the load drives is so large, against the inertia "
        "on the motor side, that one torque allows more than one motion": ~(low > 0),
    }


def _possible(joint: Joint, vectors: Array, elements: Array, load: Array) -> Flags:
    flags: Flags = np.any(list(_impossible(joint, vectors, elements, load).values()), axis=0)
    return ~flags


def slope_bounds(elements: Array, inertia: Array) -> tuple[Array, Array]:
    """Smallest and largest motor torque per joint acceleration, over all power directions.

    At rest and without load: what load-dependent friction grows by is left out.
    """
    low, high = inertia, inertia
    to_input = np.ones_like(inertia)
    for k in range(elements.shape[1] - 1, -1, -1):
        element = elements[:, k]
        to_input = to_input * element[:, RATIO]
        rise = 1.0 + np.maximum(element[:, STRIBECK_LOAD_RATIO], 0.0)
        drive, drive_apart = element[:, LOAD_DRIVE], np.abs(element[:, LOAD_DRIVE_DIFFERENCE])
        back, back_apart = element[:, LOAD_BACK], np.abs(element[:, LOAD_BACK_DIFFERENCE])
        lower = np.minimum(1.0 - (back + back_apart) * rise, 1.0 + (drive - drive_apart) * rise)
        upper = np.maximum(1.0 - (back - back_apart) * rise, 1.0 + (drive + drive_apart) * rise)
        corners = np.stack([low * lower, low * upper, high * lower, high * upper])
        corners /= element[:, RATIO]
        low = corners.min(axis=0) + element[:, INERTIA] * to_input
        high = corners.max(axis=0) + element[:, INERTIA] * to_input
    return low, high


# --- a drive whose torque depends on the motion: position control, back-EMF ------------


class _Drive(NamedTuple):
    """A :class:`Law` for the compiled functions, ``(N,)`` arrays.

    ``on (scale clip(command - kp q - kd qd, limit) - back_emf qd) + push``, in units of the
    measured torque.
    """

    command: Array
    scale: Array
    on: Array  # 1 where the drive gives a torque, else 0
    push: Array  # (1, N) or (n, N) torque in addition
    kp: float
    kd: float
    limit: float
    back_emf: float
    held: bool  # whether a command is held until the next; else linear
    delays: Array  # (n,) by which the drive acts late on its target, in samples


def follow(
    joint: Joint,
    values: ArrayLike,
    law: Law,
    period: float,
    segments: ArrayLike,
    q0: ArrayLike,
    qd0: ArrayLike,
    *,
    push: ArrayLike | None = None,
    inputs: Inputs = Inputs(),  # noqa: B008  (frozen)
    begin: float = 0.0,
    held: bool = False,
    step: float = 2e-3,
) -> tuple[Array, Array]:
    """Simulate the joint while a drive follows its command, restarted in every segment ``(K, 2)``.

    Between two closings of the loop the torque is linear; its value at the end, which depends on
    the motion, is predicted with a constant torque and corrected once (Heun's method).
    """
    vectors = np.ascontiguousarray(values, dtype=np.float64)
    elements, load, carried = _tables(joint, vectors, inputs)
    on = np.ones(law.command.size) if law.off is None else 1.0 - law.off
    rows = np.zeros((1, on.size)) if push is None else push
    command, scale, on, pushed = (
        np.ascontiguousarray(x, dtype=np.float64) for x in (law.command, law.scale, on, rows)
    )
    kp, kd, limit, back_emf = map(float, (law.kp, law.kd, law.limit, law.back_emf))
    late = joint.by_target and law.closed
    delays = joint.delays(vectors) / period if late else np.zeros(len(vectors))
    drive = _Drive(command, scale, on, pushed, kp, kd, limit, back_emf, held, delays)
    q, qd = _follow(
        elements,
        load,
        carried,
        _possible(joint, vectors, elements, load),
        drive,
        float(period),
        float(begin),
        np.asarray(segments, dtype=np.int64),
        np.asarray(q0, dtype=np.float64),
        np.asarray(qd0, dtype=np.float64),
        int(np.ceil(period / step - 1e-9)),
    )
    return np.asarray(q), np.asarray(qd)


@njit(cache=True, error_model="numpy", inline="always")
def _between(command: Array, first: int, last: int, place: float) -> float:
    """Command on a straight line at a place, in samples, of those from ``first`` to ``last``."""
    place = min(max(place, float(first)), float(last))
    i = min(int(place), last - 1)
    return float(command[i] + (place - i) * (command[i + 1] - command[i]))


@njit(cache=True, error_model="numpy", inline="always")
def _standing(command: Array, first: int, place: float, step: float) -> float:
    """Mean of a held command over a step, both in samples; before the ``first`` it is as there."""
    begin = max(int(np.floor(place)), first)
    end = max(int(np.floor(place + step * (1.0 - 1e-9))), first)
    share = (end - place) / step if end > begin else 0.0
    return float(share * command[begin] + (1.0 - share) * command[end])


@njit(cache=True, error_model="numpy", inline="always")
def _torque(
    drive: _Drive, i: int, share: float, command: float, push: float, q: float, qd: float
) -> float:
    """Torque of the drive between samples i and i + 1."""
    j = min(i + 1, drive.command.shape[0] - 1)
    scale = drive.scale[i] + share * (drive.scale[j] - drive.scale[i])
    aimed = command - drive.kp * q - drive.kd * qd
    aimed = min(max(aimed, -drive.limit), drive.limit)
    return float(drive.on[i] * (scale * aimed - drive.back_emf * qd) + push)


@njit(cache=True, error_model="numpy", parallel=True)
def _follow(
    elements: Array,
    loads: Array,
    carried: Carried | None,
    valid: Flags,
    drive: _Drive,
    period: float,
    begin: float,
    segments: Index,
    q0: Array,
    qd0: Array,
    steps: int,
) -> tuple[Array, Array]:
    """Integrate every vector and segment in parallel, with ``steps`` loop closings a sample."""
    n, pieces, samples = len(elements), segments.shape[0], drive.command.shape[0]
    q_out, qd_out = np.full((n, samples), np.nan), np.full((n, samples), np.nan)
    h = period / steps
    for job in prange(n * pieces):
        v, k = job // pieces, job % pieces
        if not valid[v]:
            continue
        plant = plant_of(elements, loads, carried, v)
        push = drive.push[v if drive.push.shape[0] > 1 else 0]
        torque, out, counts = np.empty(2), np.empty((4, 2)), np.zeros(2, dtype=np.int64)
        a, b = segments[k]
        q, qd = q0[k], qd0[k]
        for i in range(a, b):
            q_out[v, i], qd_out[v, i] = q, qd
            if i == b - 1 or np.isnan(q):
                continue
            for s in range(steps):
                now, then = (0.0, 0.0) if drive.held else (s / steps, (s + 1) / steps)
                change = push[i + 1] - push[i]
                before = push[i] + s / steps * change
                after = push[i] + (s + 1) / steps * change
                time = begin + i * period + s * h
                place = i + s / steps - drive.delays[v]
                first = last = _standing(drive.command, a, place, 1.0 / steps)
                if not drive.held:
                    first = _between(drive.command, a, b - 1, place)
                    last = _between(drive.command, a, b - 1, place + 1.0 / steps)
                torque[0] = torque[1] = _torque(drive, i, now, first, before, q, qd)
                done = 2
                for _ in range(2):  # predict the motion and so the torque at the end, then correct
                    count = integrate(plant, torque, h, time, True, q, qd, 1, out, counts)
                    done = min(done, count)
                    end, fast = out[POSITION, 1], out[SPEED, 1]
                    torque[1] = _torque(drive, i, then, last, after, end, fast)
                q, qd = (out[POSITION, 1], out[SPEED, 1]) if done == 2 else (np.nan, np.nan)
    return q_out, qd_out
