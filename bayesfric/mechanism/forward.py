"""Forward model: the motion under a motor torque, with true stiction.

While the joint keeps its direction and no element's transmitted torque changes
sign, the equation of motion is smooth and classical Runge-Kutta steps integrate
it. Reversals, breakaway and sign changes of a transmitted torque are located to
rounding and the integration restarted there, so nothing non-smooth is ever
integrated across and the error falls with the fourth power of the step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayesfric.mechanism.chain import Chain, Tables
from bayesfric.mechanism.dynamics import CarriedValues, Moved, moved
from bayesfric.mechanism.integrate import (
    ACCELERATION,
    POSITION,
    RUNAWAY,
    SPEED,
    STICKS,
    integrate,
    integrate_segments,
)
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
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.filters import later
from bayesfric.recordings.measurement import Hold, Inputs

# Linear pieces of a cubic torque, a sample.
_FINER = 4
_MAX_SUBSTEPS = 64


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
    sticking: NDArray[np.bool_]  # (N,) where static friction holds the joint
    events: int  # located stops, breakaways and sign changes of transmitted torques
    reversals: int  # number of times that the joint moved off in the other direction
    step_error: float  # estimated largest error of q, rad or m; NaN for given substeps
    substeps: int  # integration steps per sample
    unresolved: int = 0  # steps with too many events to locate; only if far too coarse


def simulate(
    chain: Chain,
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

    Substeps are doubled until ``q`` changes by less than ``tolerance``. The joint sticks while the
    torque lies within its breakaway torques; no friction law is smoothed. Raises ValueError where
    the acceleration is not unique, and :class:`RunsAway`.
    """
    measured = _torque(torque, period, hold, substeps)
    if not (math.isfinite(q0) and math.isfinite(qd0)):
        raise ValueError("q0 and qd0 must be finite numbers")
    vector = np.asarray(values, dtype=np.float64)
    joint = _joint(chain, vector, inputs)
    samples = _delayed_torque(chain, vector[np.newaxis], measured, period)[0]
    finer = _FINER if hold == "cubic" else 1
    fine = _interpolated(samples[np.newaxis], finer)[0]

    def run(each: int) -> Motion:
        """Integrate in ``each`` steps a piece; the error is not known."""
        out, counts = np.empty((4, fine.size)), np.zeros(3, dtype=np.int64)
        step, start = float(period) / finer, (float(q0), float(qd0))
        done = integrate(joint, fine, step, float(begin), hold != "zero", *start, each, out, counts)
        if done < fine.size:
            at = f"{RUNAWAY:g} rad or m after {done * period / finer:g} s"
            raise RunsAway(f"the joint runs away: beyond {at}")
        out = out[:, ::finer]
        return Motion(
            time=np.arange(measured.size, dtype=np.float64) * float(period),
            q=out[POSITION],
            qd=out[SPEED],
            qdd=out[ACCELERATION],
            torque=measured,
            sticking=out[STICKS] == 1.0,
            events=int(counts[0]),
            reversals=int(counts[1]),
            step_error=math.nan,
            substeps=each * finer,
            unresolved=int(counts[2]),
        )

    if substeps is not None:
        return run(-(-substeps // finer))
    motion = run(2)
    while True:
        coarse, motion = motion, run(2 * motion.substeps // finer)
        change = float(np.max(np.abs(motion.q - coarse.q)))
        if change < tolerance or motion.substeps >= _MAX_SUBSTEPS:
            # of fourth order: half the step leaves a sixteenth of the error
            return replace(motion, step_error=change / 15.0)


def _joint(chain: Chain, vector: Array, inputs: Inputs) -> Moved:
    """Prepare a joint for simulation; refuse values without a unique motion."""
    if vector.shape != (len(chain.names),):
        raise ValueError(f"values must have the shape ({len(chain.names)},), not {vector.shape}")
    outside = [
        p.name
        for p, value in zip(chain.parameters, vector, strict=True)
        if not (np.isfinite(value) and p.lower <= value <= p.upper)
    ]
    if outside:
        raise ValueError(f"not finite or outside its support: {', '.join(outside)}")
    (elements,), (load,), carried = chain.tables(vector[np.newaxis], inputs)
    if load[GAIN] == 0.0 or np.any(elements[:, STRIBECK_VELOCITY] == 0.0):
        raise ValueError("gain and Stribeck velocities must be greater than zero")
    joint = moved(
        elements, load, carried_values(chain, carried, inputs), *inputs.load(chain.load.motion)
    )
    low, high = _slope_bounds(elements[np.newaxis], np.array([joint.inertia]))
    if high[0] <= 0.0:
        raise ValueError("the chain has no inertia, so a torque does not determine its motion")
    if low[0] <= 0.0:
        raise ValueError(
            "irreversible gearbox: its loss when the load drives is so large, against the inertia "
            "on the motor side, that one torque allows more than one motion"
        )
    return joint


def simulate_segments(
    chain: Chain,
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
    if vectors.ndim != 2 or vectors.shape[1] != len(chain.names):
        raise ValueError(f"values must have the shape (n, {len(chain.names)})")
    samples = _torque(torque, period, hold, substeps)
    ranges = np.asarray(segments, dtype=np.int64)
    if ranges.ndim != 2 or ranges.shape[1] != 2 or np.any(ranges[:, 0] >= ranges[:, 1]):
        raise ValueError("segments must be (K, 2) ranges that are not empty")
    if ranges.min() < 0 or ranges.max() > samples.size:
        raise ValueError("segments must lie within the samples of torque")
    shape = (len(vectors), len(ranges))
    start, speed = (
        np.ascontiguousarray(np.broadcast_to(np.asarray(x, np.float64), shape)) for x in (q0, qd0)
    )
    if not all(np.all(np.isfinite(x)) for x in (vectors, start, speed)):
        raise ValueError("values, q0 and qd0 must be finite")
    tables = chain.tables(vectors, inputs)
    finer = _FINER if hold == "cubic" else 1
    q, qd = integrate_segments(
        tables.elements,
        tables.load,
        carried_values(chain, tables.carried, inputs),
        inputs.load(chain.load.motion),
        _interpolated(_delayed_torque(chain, vectors, samples, period), finer),
        float(period) / finer,
        float(begin),
        hold != "zero",
        np.ascontiguousarray(finer * ranges[:, 0]),
        np.ascontiguousarray(finer * (ranges[:, 1] - 1) + 1),
        start,
        speed,
        -(-substeps // finer),
        possible(chain, vectors, tables, inputs.load(chain.load.motion)[0]),
    )
    return np.asarray(q[:, ::finer]), np.asarray(qd[:, ::finer])


def carried_values(chain: Chain, values: Array, inputs: Inputs) -> CarriedValues | None:
    """Prepare the terms without a slot for the forward model; a delay is none of them."""
    all_terms = chain.carried_terms(inputs)
    columns = [k for k, term in enumerate(all_terms) if term.row.column is not None]
    if not columns:
        return None
    terms = [all_terms[k] for k in columns]
    signals = {k: signal_of(c.row, inputs) for k, c in enumerate(terms) if c.row.signal}
    # straight lines between the stamps of all are straight lines of each
    stamps = np.unique(
        np.concatenate([np.zeros(1), *(signal.stamps for signal in signals.values())])
    )
    levels = np.ones((len(terms), stamps.size))
    for k, signal in signals.items():
        levels[k] = signal.at(stamps) - terms[k].row.zero
    return CarriedValues(
        np.ascontiguousarray(values[:, columns]),
        np.array([c.place for c in terms], dtype=np.int64),
        np.array([c.address for c in terms], dtype=np.int64),
        np.ascontiguousarray(stamps, dtype=np.float64),
        levels,
    )


def _delayed_torque(chain: Chain, vectors: Array, torque: Array, period: float) -> Array:
    """Torque that acts when the recorded motion shows it: one for all, or each vector's own.

    Gives ``(1, N)`` or ``(n, N)``.
    """
    if not chain.delay or chain.by_target:
        return torque[np.newaxis]
    samples = chain.delays(vectors) / period
    return np.stack([later(torque, delay) for delay in samples.tolist()])


def _interpolated(torque: Array, finer: int) -> Array:
    """Give samples ``(n, N)`` and what a cubic puts between them, ``(n, finer (N - 1) + 1)``."""
    if finer == 1:
        return torque
    out = np.empty((len(torque), finer * (torque.shape[1] - 1) + 1))
    out[:, ::finer] = torque
    n = torque.shape[1]
    for i, row in enumerate(torque):
        # one sample beyond either end, on the parabola through the last three
        first, last = (3.0 * (x[0] - x[1]) + x[2] if n > 2 else x[0] for x in (row, row[::-1]))
        padded = np.concatenate([[first], row, [last]])
        for k in range(1, finer):
            out[i, k::finer] = later(padded, -k / finer, neighbours=2)[1:-2]
    return out


def possible(
    chain: Chain, vectors: Array, tables: Tables, added_inertia: float
) -> NDArray[np.bool_]:
    """Flag the vectors in the support that have one motion for one torque.

    A motion is unique where the motor torque rises with the acceleration for every direction of
    power. It does not where ``mu_2`` is so far above one that the inertia on the motor side does
    not outweigh it. Growth of load-dependent friction with speed or load is left out of this.
    """
    lower = np.array([p.lower for p in chain.parameters])
    upper = np.array([p.upper for p in chain.parameters])
    valid = np.all((vectors >= lower) & (vectors <= upper), axis=1)
    elements, load = tables.elements, tables.load
    valid &= (load[:, GAIN] > 0) & np.all(elements[:, :, STRIBECK_VELOCITY] > 0, axis=1)
    valid &= _slope_bounds(elements, load[:, LOAD_INERTIA] + added_inertia)[0] > 0
    return np.asarray(valid)


def _torque(torque: ArrayLike, period: float, hold: str, substeps: int | None) -> Array:
    """Check a torque ``(N,)``, period, hold and number of steps."""
    samples = np.array(torque, dtype=np.float64)
    if samples.ndim != 1 or samples.size == 0:
        raise ValueError("torque must be a one-dimensional array of samples")
    if not np.all(np.isfinite(samples)):
        raise ValueError("torque must be finite")
    if not (math.isfinite(period) and period > 0):
        raise ValueError("period must be a positive number of seconds")
    if hold not in get_args(Hold):
        raise ValueError("hold must be 'zero', 'linear' or 'cubic'")
    if substeps is not None and substeps < 1:
        raise ValueError("substeps must be at least 1")
    return samples


def _slope_bounds(elements: Array, inertia: Array) -> tuple[Array, Array]:
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
