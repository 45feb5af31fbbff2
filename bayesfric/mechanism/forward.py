"""Forward model: the motion under a motor torque, with true stiction.

While the joint keeps its direction and no element's transmitted torque changes sign, the equation
of motion is smooth and classical Runge-Kutta steps integrate it. Reversals, breakaway and sign
changes of a transmitted torque are located to rounding and the integration restarted there, so
nothing non-smooth is ever integrated across and the error falls with the fourth power of the step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
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
from bayesfric.recordings.arrays import Array, Flags
from bayesfric.recordings.filters import later
from bayesfric.recordings.measurement import Hold, Inputs


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
    elements, load, carried = forward_tables(joint, vector[np.newaxis], inputs)
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
    elements, load, carried = forward_tables(joint, vectors, inputs)
    q, qd = integrate_segments(
        elements,
        load,
        carried,
        possible(joint, vectors, elements, load),
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


def forward_tables(
    joint: Joint, vectors: Array, inputs: Inputs
) -> tuple[Array, Array, Carried | None]:
    """Lay parameter vectors out for the forward model; a delay is no term of it."""
    elements, load, values = joint.tables(vectors, inputs)
    all_terms = joint.carried_terms(inputs)
    columns = [
        k
        for k, term in enumerate(all_terms)
        if term.row.column is not None
        and (term.row.option != "signals" or term.row.signal in inputs.others)
    ]
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


def possible(joint: Joint, vectors: Array, elements: Array, load: Array) -> Flags:
    """Flag the vectors ``(n,)`` that have one motion."""
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
