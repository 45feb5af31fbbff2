"""Forward model: the motion that a motor torque makes, with true stiction.

While the joint keeps its direction and no element's transmitted torque changes
sign, the equation of motion is smooth and classical Runge-Kutta steps integrate
it. Reversals, breakaway and sign changes of a transmitted torque are located to
rounding and the integration restarted there, so nothing non-smooth is ever
integrated across and the error falls with the fourth power of the step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike, NDArray

from bayesfric.mechanism.chain import Chain
from bayesfric.mechanism.inverse import added_load
from bayesfric.mechanism.kernels import (
    COULOMB_NEGATIVE,
    COULOMB_POSITIVE,
    GAIN,
    INERTIA,
    LOAD_BACK,
    LOAD_DRIVE,
    LOAD_INERTIA,
    OFFSET,
    QUADRATIC,
    RATIO,
    STRIBECK_RATIO,
    STRIBECK_VELOCITY,
    VISCOUS,
    element_torque,
    gravity_torque,
    motor_torque,
    speed_factor,
)

Hold = Literal["linear", "zero"]

_RUNAWAY = 1e6  # rad or m
_MAX_EVENTS = 64  # in one step
_MAX_SUBSTEPS = 64

# What every compiled function below needs of the joint: the element and load
# tables of one parameter vector and, added mass included, the load's inertia and
# the amplitude and angle of its gravity torque.
_Joint = tuple[NDArray[np.float64], NDArray[np.float64], float, float, float]
# Lines T = slope qdd + intercept of the transmitted torques; scratch memory.
_Lines = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """A simulated motion.

    Attributes
    ----------
    time
        ``(N,)``, s, from zero.
    q, qd, qdd
        ``(N,)`` position, speed and acceleration of the joint (rad or m, SI). The
        acceleration is the one right after the sample.
    torque
        ``(N,)`` measured motor torque, as given (N m or N).
    sticking
        ``(N,)``, where static friction holds the joint; speed and acceleration
        are then exactly zero.
    events
        Located stops, breakaways and sign changes of transmitted torques.
    reversals
        How often the joint moved off against the direction it had moved in before.
    step_error
        Estimated discretisation error of ``q`` (rad or m), largest over the samples.
    substeps
        Integration steps per sample.
    unresolved
        Steps with more events than the simulator follows; their rest was
        integrated without locating any. Zero unless the steps are far too coarse.
    """

    time: NDArray[np.float64]
    q: NDArray[np.float64]
    qd: NDArray[np.float64]
    qdd: NDArray[np.float64]
    torque: NDArray[np.float64]
    sticking: NDArray[np.bool_]
    events: int
    reversals: int
    step_error: float
    substeps: int
    unresolved: int = 0


def simulate(
    chain: Chain,
    values: ArrayLike,
    torque: ArrayLike,
    period: float,
    *,
    q0: float = 0.0,
    qd0: float = 0.0,
    added_mass: float = 0.0,
    radius: float = 0.0,
    hold: Hold = "linear",
    substeps: int | None = None,
    tolerance: float = 1e-9,
) -> Motion:
    """Motion of the joint under a measured motor torque.

    Parameters
    ----------
    chain
        The mechanism.
    values
        ``(n_parameters,)`` in the order of ``chain.names``.
    torque
        ``(N,)`` measured motor torque (N m or N), one sample every ``period``; what
        acts is ``gain * torque - offset``.
    period
        s.
    q0, qd0
        Position and speed at the first sample (rad or m, SI).
    added_mass, radius
        Known mass in kg bolted to the load at a radius in m; a sliding load
        takes the mass alone.
    hold
        Torque between samples: ``linear``, or ``zero`` for held until the next.
    substeps
        Integration steps per sample. By default they are doubled, from 2, until
        ``q`` changes by less than ``tolerance`` or there are 64.
    tolerance
        rad or m; not used where ``substeps`` is given.

    Returns
    -------
    Motion

    Raises
    ------
    ValueError
        If an input is not finite, has the wrong shape or is outside its support, if
        the acceleration is not unique (no inertia, or a gearbox so irreversible
        that the motor's inertia does not outweigh it), or if the joint runs away
        beyond 1e6 rad or m.
    """
    vector = np.asarray(values, dtype=np.float64)
    if vector.shape != (len(chain.names),):
        raise ValueError(f"values must have the shape ({len(chain.names)},), not {vector.shape}")
    samples = _torque(torque, period, hold)
    if not (math.isfinite(q0) and math.isfinite(qd0)):
        raise ValueError("q0 and qd0 must be finite numbers")
    outside = [
        p.name
        for p, value in zip(chain.parameters, vector, strict=True)
        if not (np.isfinite(value) and p.lower <= value <= p.upper)
    ]
    if outside:
        raise ValueError(f"not finite or outside its support: {', '.join(outside)}")
    elements, load = chain.tables(vector[np.newaxis])
    if load[0, GAIN] == 0.0 or np.any(elements[0, :, STRIBECK_VELOCITY] == 0.0):
        raise ValueError("gain and Stribeck velocities must be greater than zero")
    inertia, moment = added_load(chain, added_mass, radius)
    joint = _joint(elements[0], load[0], float(inertia), float(moment))
    _check_slope(joint)

    def run(steps: int) -> _Run:
        return _Run(joint, samples, period, hold == "linear", q0, qd0, steps)

    if substeps is None:
        coarse = run(2)
        while True:
            fine = run(2 * coarse.substeps)
            change = float(np.max(np.abs(fine.q - coarse.q)))
            if change < tolerance or fine.substeps >= _MAX_SUBSTEPS:
                break
            coarse = fine
        error = change / 15.0
    else:
        if substeps < 1:
            raise ValueError("substeps must be at least 1")
        fine = run(substeps)
        even = substeps % 2 == 0
        other = run(substeps // 2 if even else 2 * substeps)
        change = float(np.max(np.abs(fine.q - other.q)))
        error = change / 15.0 if even else change * 16.0 / 15.0
    return Motion(
        time=np.arange(samples.size, dtype=np.float64) * float(period),
        q=fine.q,
        qd=fine.qd,
        qdd=fine.qdd,
        torque=samples,
        sticking=fine.sticking,
        events=int(fine.counts[0]),
        reversals=int(fine.counts[1]),
        step_error=error,
        substeps=fine.substeps,
        unresolved=int(fine.counts[2]),
    )


def simulate_many(
    chain: Chain,
    values: ArrayLike,
    torque: ArrayLike,
    period: float,
    *,
    q0: ArrayLike = 0.0,
    qd0: ArrayLike = 0.0,
    added_mass: float = 0.0,
    radius: float = 0.0,
    hold: Hold = "linear",
    substeps: int = 2,
) -> NDArray[np.float64]:
    """Positions of the joint for many parameter vectors, in parallel.

    Parameters
    ----------
    chain, torque, period, added_mass, radius, hold
        As for :func:`simulate`.
    values
        ``(n, n_parameters)``.
    q0, qd0
        Position and speed at the first sample, one for all or ``(n,)``.
    substeps
        Integration steps per sample.

    Returns
    -------
    ndarray
        ``(n, N)``, rad or m. A row is NaN where the vector is outside the support or
        has no unique motion, and from where the joint runs away, so that a fit can
        reject the vector.

    Raises
    ------
    ValueError
        If an input is not finite or has the wrong shape.
    """
    vectors = np.asarray(values, dtype=np.float64)
    if vectors.ndim != 2 or vectors.shape[1] != len(chain.names):
        raise ValueError(f"values must have the shape (n, {len(chain.names)})")
    samples = _torque(torque, period, hold)
    start = np.ascontiguousarray(np.broadcast_to(np.asarray(q0, np.float64), len(vectors)))
    speed = np.ascontiguousarray(np.broadcast_to(np.asarray(qd0, np.float64), len(vectors)))
    if not all(np.all(np.isfinite(x)) for x in (vectors, start, speed)):
        raise ValueError("values, q0 and qd0 must be finite")
    if substeps < 1:
        raise ValueError("substeps must be at least 1")
    elements, load = chain.tables(vectors)
    inertia, moment = added_load(chain, added_mass, radius)
    lower = np.array([p.lower for p in chain.parameters])
    upper = np.array([p.upper for p in chain.parameters])
    valid = np.all((vectors >= lower) & (vectors <= upper), axis=1)
    valid &= (load[:, GAIN] > 0) & np.all(elements[:, :, STRIBECK_VELOCITY] > 0, axis=1)
    valid &= _slope_bounds(elements, load[:, LOAD_INERTIA] + inertia)[0] > 0
    return _run_many(
        elements,
        load,
        float(inertia),
        float(moment),
        samples,
        float(period),
        hold == "linear",
        start,
        speed,
        substeps,
        valid,
    )


class _Run:
    """One integration with a given number of steps per sample."""

    def __init__(
        self,
        joint: _Joint,
        torque: NDArray[np.float64],
        period: float,
        linear: bool,
        q0: float,
        qd0: float,
        substeps: int,
    ) -> None:
        self.substeps = substeps
        self.q, self.qd, self.qdd = (np.empty(torque.size) for _ in range(3))
        self.sticking = np.empty(torque.size, dtype=np.bool_)
        self.counts = np.zeros(3, dtype=np.int64)
        done = _run(
            joint,
            torque,
            float(period),
            linear,
            float(q0),
            float(qd0),
            substeps,
            self.q,
            self.qd,
            self.qdd,
            self.sticking,
            self.counts,
        )
        if done < torque.size:
            raise ValueError(
                f"the joint runs away: beyond {_RUNAWAY:g} rad or m after {done * period:g} s"
            )


def _torque(torque: ArrayLike, period: float, hold: str) -> NDArray[np.float64]:
    samples = np.array(torque, dtype=np.float64)
    if samples.ndim != 1 or samples.size == 0:
        raise ValueError("torque must be a one-dimensional array of samples")
    if not np.all(np.isfinite(samples)):
        raise ValueError("torque must be finite")
    if not (math.isfinite(period) and period > 0):
        raise ValueError("period must be a positive number of seconds")
    if hold not in ("linear", "zero"):
        raise ValueError("hold must be 'linear' or 'zero'")
    return samples


def _slope_bounds(
    elements: NDArray[np.float64], inertia: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Smallest and largest motor torque per joint acceleration, over all power directions."""
    low, high = inertia, inertia
    to_input = np.ones_like(inertia)
    for k in range(elements.shape[1] - 1, -1, -1):
        element = elements[:, k]
        to_input = to_input * element[:, RATIO]
        rise = 1.0 + element[:, STRIBECK_RATIO]
        drive, back = element[:, LOAD_DRIVE], element[:, LOAD_BACK]
        least, most = 1.0 - back * rise, 1.0 + drive * rise
        corners = np.stack([low * least, low * most, high * least, high * most])
        corners /= element[:, RATIO]
        low = corners.min(axis=0) + element[:, INERTIA] * to_input
        high = corners.max(axis=0) + element[:, INERTIA] * to_input
    return low, high


def _check_slope(joint: _Joint) -> None:
    elements, inertia = joint[0], joint[2]
    low, high = _slope_bounds(elements[np.newaxis], np.array([inertia]))
    if high[0] <= 0.0:
        raise ValueError("the chain has no inertia, so a torque does not determine its motion")
    if low[0] <= 0.0:
        raise ValueError(
            "irreversible gearbox: its loss when the load drives is so large, against the inertia "
            "on the motor side, that one torque allows more than one motion"
        )


@njit(cache=True, error_model="numpy")
def _joint(
    elements: NDArray[np.float64],
    load: NDArray[np.float64],
    added_inertia: float,
    added_moment: float,
) -> _Joint:
    # one sine instead of a sine and a cosine
    sine = gravity_torque(load, added_moment, 1.0, 0.0)
    cosine = gravity_torque(load, added_moment, 0.0, 1.0)
    inertia = load[LOAD_INERTIA] + added_inertia
    return elements, load, inertia, math.hypot(sine, cosine), math.atan2(cosine, sine)


@njit(cache=True, error_model="numpy", inline="always")
def _load_torque(joint: _Joint, q: float) -> float:
    """Torque of the load at constant speed."""
    return joint[3] * math.sin(q + joint[4])


@njit(cache=True, error_model="numpy", inline="always")
def _element_line(
    elements: NDArray[np.float64],
    k: int,
    slope: float,
    intercept: float,
    drives: bool,
    sign: float,
    speed: float,
    to_input: float,
) -> tuple[float, float]:
    """Carry the transmitted torque ``slope qdd + intercept`` to the input of element k.

    ``drives`` says which of mu_1 and mu_2 holds; ``to_input`` is the element's input
    speed over the joint's.
    """
    rise = 1.0
    if elements[k, STRIBECK_RATIO] != 0.0:
        rise = speed_factor(elements[k], speed)
    inertia = elements[k, INERTIA]
    drive, back = elements[k, LOAD_DRIVE], elements[k, LOAD_BACK]
    # sign |T| is T while the motor side drives and -T while the load does
    factor = 1.0 + drive * rise if drives else 1.0 - back * rise
    losses = element_torque(
        0.0,
        sign,
        speed,
        0.0,
        inertia,
        elements[k, COULOMB_POSITIVE],
        elements[k, COULOMB_NEGATIVE],
        elements[k, VISCOUS],
        elements[k, QUADRATIC],
        drive,
        back,
        rise,
    )
    return slope * factor + inertia * to_input, intercept * factor + losses


@njit(cache=True, error_model="numpy")
def _frozen(
    joint: _Joint,
    q: float,
    qd: float,
    torque: float,
    sign: float,
    pattern: int,
    lines: _Lines,
) -> float:
    """Acceleration while direction and pattern (bit k: element k drives) are held.

    Leaves the lines of the transmitted torques in ``lines``.
    """
    elements = joint[0]
    slope, intercept = joint[2], _load_torque(joint, q)
    to_input = 1.0
    for k in range(elements.shape[0] - 1, -1, -1):
        ratio = elements[k, RATIO]
        to_input *= ratio
        slope /= ratio
        intercept /= ratio
        lines[k, 0] = slope
        lines[k, 1] = intercept
        drives = (pattern >> k) & 1 == 1
        slope, intercept = _element_line(
            elements, k, slope, intercept, drives, sign, to_input * qd, to_input
        )
    return (torque - intercept) / slope


@njit(cache=True, error_model="numpy")
def _exact(joint: _Joint, q: float, qd: float, torque: float, sign: float) -> tuple[float, int]:
    """Acceleration and pattern, in closed form.

    The motor torque rises with the acceleration, with one kink per load-dependent
    element. Whether the solution lies above or below a kink is read off the torque
    at the kink, from the load to the motor; then everything is one line.
    """
    elements = joint[0]
    gravity = _load_torque(joint, q)
    slope, intercept = joint[2], gravity
    low, high = -math.inf, math.inf
    pattern = 0
    to_input = 1.0
    for k in range(elements.shape[0] - 1, -1, -1):
        ratio = elements[k, RATIO]
        to_input *= ratio
        slope /= ratio
        intercept /= ratio
        drives = False
        if elements[k, LOAD_DRIVE] != 0.0 or elements[k, LOAD_BACK] != 0.0:
            if slope == 0.0:
                drives = intercept * sign > 0.0
            else:
                kink = -intercept / slope
                if low < kink < high:
                    if motor_torque(elements, joint[2] * kink + gravity, sign, qd, kink) < torque:
                        low = kink
                    else:
                        high = kink
                drives = ((kink <= low) == (slope > 0.0)) == (sign > 0.0)
        if drives:
            pattern |= 1 << k
        slope, intercept = _element_line(
            elements, k, slope, intercept, drives, sign, to_input * qd, to_input
        )
    return (torque - intercept) / slope, pattern


@njit(cache=True, error_model="numpy")
def _limits(joint: _Joint, q: float) -> tuple[float, float]:
    """Motor torques between which the joint at rest sticks."""
    gravity = _load_torque(joint, q)
    return (
        motor_torque(joint[0], gravity, -1.0, 0.0, 0.0),
        motor_torque(joint[0], gravity, 1.0, 0.0, 0.0),
    )


@njit(cache=True, error_model="numpy")
def _step(
    joint: _Joint,
    q: float,
    qd: float,
    qdd: float,
    torque: float,
    rate: float,
    sign: float,
    pattern: int,
    lines: _Lines,
    h: float,
) -> tuple[float, float]:
    """Take one Runge-Kutta step; ``qdd`` is the acceleration at its start."""
    half = 0.5 * h
    middle = torque + rate * half
    v2 = qd + half * qdd
    a2 = _frozen(joint, q + half * qd, v2, middle, sign, pattern, lines)
    v3 = qd + half * a2
    a3 = _frozen(joint, q + half * v2, v3, middle, sign, pattern, lines)
    v4 = qd + h * a3
    a4 = _frozen(joint, q + h * v3, v4, torque + rate * h, sign, pattern, lines)
    return (
        q + h * (qd + 2.0 * (v2 + v3) + v4) / 6.0,
        qd + h * (qdd + 2.0 * (a2 + a3) + a4) / 6.0,
    )


@njit(cache=True, error_model="numpy", inline="always")
def _transmitted(lines: _Lines, k: int, qdd: float, sign: float, pattern: int) -> float:
    """Return the transmitted torque of element k, positive where it agrees with the pattern."""
    value = (lines[k, 0] * qdd + lines[k, 1]) * sign
    return float(value if (pattern >> k) & 1 == 1 else -value)


@njit(cache=True, error_model="numpy")
def _agreement(
    joint: _Joint,
    q: float,
    qd: float,
    qdd: float,
    torque: float,
    rate: float,
    sign: float,
    pattern: int,
    lines: _Lines,
    h: float,
    which: int,
) -> float:
    """Value that is positive until event ``which`` (element, or -1: reversal), ``h`` later."""
    if h > 0.0:
        q, qd = _step(joint, q, qd, qdd, torque, rate, sign, pattern, lines, h)
    if which < 0:
        return sign * qd
    qdd = _frozen(joint, q, qd, torque + rate * h, sign, pattern, lines)
    return _transmitted(lines, which, qdd, sign, pattern)


@njit(cache=True, error_model="numpy")
def _locate(
    joint: _Joint,
    q: float,
    qd: float,
    qdd: float,
    torque: float,
    rate: float,
    sign: float,
    pattern: int,
    lines: _Lines,
    h: float,
    which: int,
) -> float:
    """Time to an event known to come within ``h``, to rounding (Illinois method).

    Zero if the value is not positive anywhere before, that is, if the event is now.
    """
    a, b = 0.0, h
    fa = _agreement(joint, q, qd, qdd, torque, rate, sign, pattern, lines, a, which)
    fb = _agreement(joint, q, qd, qdd, torque, rate, sign, pattern, lines, b, which)
    if fa <= 0.0:
        for _ in range(60):
            c = 0.5 * b
            fc = _agreement(joint, q, qd, qdd, torque, rate, sign, pattern, lines, c, which)
            if fc > 0.0:
                a, fa = c, fc
                break
            b, fb = c, fc
        if fa <= 0.0:
            return 0.0
    ga, gb = fa, fb
    for i in range(200):
        if fb == 0.0 or b - a <= 2.3e-16 * b:
            break
        c = b - gb * (b - a) / (gb - ga)
        if not a < c < b or i > 40:
            c = 0.5 * (a + b)
            if not a < c < b:
                break
        fc = _agreement(joint, q, qd, qdd, torque, rate, sign, pattern, lines, c, which)
        if fc > 0.0:
            if c - a < b - c:
                gb *= 0.5
            a, fa, ga = c, fc, fc
        else:
            if b - c < c - a:
                ga *= 0.5
            b, fb, gb = c, fc, fc
    return b if -fb <= fa else a


@njit(cache=True, error_model="numpy")
def _dip(v0: float, a0: float, v1: float, a1: float, h: float) -> float:
    """When, within a step from speed v0 to v1 that stays positive at both ends, it is least.

    Zero if that needs no look: the speed falls to no less than its tangents allow.
    """
    if not (a0 < 0.0 < a1) or v0 + a0 * h > 0.0 or v1 - a1 * h > 0.0:
        return 0.0
    # derivative of the cubic through both ends, a x² + b x + c on 0 < x < 1
    a = 6.0 * (v0 - v1) + 3.0 * h * (a0 + a1)
    b = -6.0 * (v0 - v1) - 2.0 * h * (2.0 * a0 + a1)
    c = h * a0
    root = math.sqrt(max(b * b - 4.0 * a * c, 0.0))
    # c < 0 < a + b + c: one root inside, going up
    x = (-b + root) / (2.0 * a) if b < 0.0 and a != 0.0 else -2.0 * c / (b + root)
    return h * x if 0.0 < x < 1.0 else 0.0


@njit(cache=True, error_model="numpy")
def _run(
    joint: _Joint,
    measured: NDArray[np.float64],
    period: float,
    linear: bool,
    q: float,
    qd: float,
    substeps: int,
    q_out: NDArray[np.float64],
    qd_out: NDArray[np.float64],
    qdd_out: NDArray[np.float64],
    sticking: NDArray[np.bool_],
    counts: NDArray[np.int64],
) -> int:
    """Integrate and write the samples; returns how many there are before a runaway.

    ``counts`` are events, reversals and unresolved steps.
    """
    elements, load = joint[0], joint[1]
    n_elements = elements.shape[0]
    lines = np.empty((n_elements, 2))
    kinked = np.empty(n_elements, dtype=np.int64)
    n_kinked = 0
    for k in range(n_elements):
        if elements[k, LOAD_DRIVE] != 0.0 or elements[k, LOAD_BACK] != 0.0:
            kinked[n_kinked] = k
            n_kinked += 1

    samples = measured.shape[0]
    before = 1.0 if qd > 0.0 else (-1.0 if qd < 0.0 else 0.0)  # last direction of motion
    sign = before  # zero while sticking
    pattern = 0
    qdd = low = high = 0.0
    for i in range(samples):
        start = load[GAIN] * measured[i] - load[OFFSET]
        if not (abs(q) <= _RUNAWAY and math.isfinite(qd)):
            return i
        # At a sample everything is decided afresh: the torque may have jumped.
        if qd == 0.0:
            low, high = _limits(joint, q)
            was, sign = sign, 1.0 if start > high else (-1.0 if start < low else 0.0)
            if sign != 0.0:
                if was == 0.0 and i > 0:
                    counts[0] += 1
                if before * sign < 0.0:
                    counts[1] += 1
                before = sign
        qdd = 0.0
        if sign != 0.0:
            qdd, pattern = _exact(joint, q, qd, start, sign)
        q_out[i], qd_out[i], qdd_out[i], sticking[i] = q, qd, qdd, sign == 0.0
        if i == samples - 1:
            break
        rate = 0.0
        if linear:
            rate = (load[GAIN] * measured[i + 1] - load[OFFSET] - start) / period
        now = 0.0
        for step in range(1, substeps + 1):
            end = period * step / substeps
            events = 0
            while now < end:
                torque = start + rate * now
                h = end - now
                if sign == 0.0:
                    then = start + rate * end
                    if low <= torque <= high and low <= then <= high:
                        now = end
                        continue
                    sign = 1.0 if torque > high or (torque >= low and then > high) else -1.0
                    if low <= torque <= high:
                        limit = high if sign > 0.0 else low
                        now = min(now + (limit - torque) / rate, end)
                        torque = start + rate * now
                    counts[0] += 1
                    if before * sign < 0.0:
                        counts[1] += 1
                    before = sign
                    qdd, pattern = _exact(joint, q, qd, torque, sign)
                    continue

                q1, qd1 = _step(joint, q, qd, qdd, torque, rate, sign, pattern, lines, h)
                qdd1 = _frozen(joint, q1, qd1, torque + rate * h, sign, pattern, lines)
                dip = 0.0
                which = -2
                if sign * qd1 <= 0.0:
                    which = -1
                else:
                    if qd != 0.0:  # from rest it moves off, whatever the rounding of qdd
                        dip = _dip(sign * qd, sign * qdd, sign * qd1, sign * qdd1, h)
                    for j in range(n_kinked):
                        if _transmitted(lines, kinked[j], qdd1, sign, pattern) < 0.0:
                            which = kinked[j]
                if which == -2 and dip == 0.0:
                    q, qd, qdd, now = q1, qd1, qdd1, end
                    continue

                # Something happens within the step: find what comes first.
                ahead = h
                first = -2
                if (
                    dip > 0.0
                    and _agreement(joint, q, qd, qdd, torque, rate, sign, pattern, lines, dip, -1)
                    <= 0.0
                ):
                    ahead = dip
                    which = -1
                if which == -1:
                    ahead = _locate(
                        joint, q, qd, qdd, torque, rate, sign, pattern, lines, ahead, -1
                    )
                    first = -1
                for j in range(n_kinked):
                    if (
                        _agreement(
                            joint,
                            q,
                            qd,
                            qdd,
                            torque,
                            rate,
                            sign,
                            pattern,
                            lines,
                            ahead,
                            kinked[j],
                        )
                        < 0.0
                    ):
                        ahead = _locate(
                            joint, q, qd, qdd, torque, rate, sign, pattern, lines, ahead, kinked[j]
                        )
                        first = kinked[j]
                if first == -2:
                    q, qd, qdd, now = q1, qd1, qdd1, end
                    continue
                events += 1
                counts[0] += 1
                if events > _MAX_EVENTS:
                    counts[2] += 1
                    q, qd, now, first = q1, qd1, end, -1 if sign * qd1 <= 0.0 else -3
                elif ahead > 0.0:
                    q, qd = _step(joint, q, qd, qdd, torque, rate, sign, pattern, lines, ahead)
                    now = end if ahead == h else now + ahead
                elif first == -1:
                    # It was about to leave, by no more than rounding: it has not left.
                    now, qd, sign, qdd = end, 0.0, 0.0, 0.0
                    low, high = _limits(joint, q)
                    continue
                torque = start + rate * now
                if first >= 0:
                    pattern ^= 1 << first
                    qdd = _frozen(joint, q, qd, torque, sign, pattern, lines)
                elif first == -3:
                    qdd, pattern = _exact(joint, q, qd, torque, sign)
                else:
                    qd = qdd = 0.0
                    low, high = _limits(joint, q)
                    sign = 1.0 if torque > high else (-1.0 if torque < low else 0.0)
                    if sign != 0.0:
                        if before * sign < 0.0:
                            counts[1] += 1
                        before = sign
                        qdd, pattern = _exact(joint, q, qd, torque, sign)
    return int(samples)


@njit(cache=True, error_model="numpy", parallel=True)
def _run_many(
    elements: NDArray[np.float64],
    load: NDArray[np.float64],
    added_inertia: float,
    added_moment: float,
    torque: NDArray[np.float64],
    period: float,
    linear: bool,
    q0: NDArray[np.float64],
    qd0: NDArray[np.float64],
    substeps: int,
    valid: NDArray[np.bool_],
) -> NDArray[np.float64]:
    n, samples = elements.shape[0], torque.shape[0]
    out = np.full((n, samples), np.nan)
    for i in prange(n):
        if valid[i]:
            done = _run(
                _joint(elements[i], load[i], added_inertia, added_moment),
                torque,
                period,
                linear,
                q0[i],
                qd0[i],
                substeps,
                out[i],
                np.empty(samples),
                np.empty(samples),
                np.empty(samples, dtype=np.bool_),
                np.zeros(3, dtype=np.int64),
            )
            out[i, done:] = np.nan
    return out
