"""Runge-Kutta steps between located events: reversals, breakaway, changes of power flow."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from bayesfric.mechanism.dynamics import (
    CarriedValues,
    Lines,
    Moved,
    breakaway_torques,
    carried_by,
    exact_acceleration,
    frozen_acceleration,
    kinked,
    moved,
)
from bayesfric.mechanism.kernels import GAIN, OFFSET
from bayesfric.recordings.arrays import Array

RUNAWAY = 1e6  # rad or m
_MAX_EVENTS = 64  # in one step


class At(NamedTuple):
    """Where a step begins: the motion, the torque with its rate, and which way all goes."""

    q: float
    qd: float
    qdd: float
    torque: float
    rate: float
    time: float
    sign: float
    pattern: int


@njit(cache=True, error_model="numpy")
def _step(joint: Moved, at: At, lines: Lines, h: float) -> tuple[float, float]:
    """Take one Runge-Kutta step."""
    q, qd, qdd, torque, rate, time, sign, pattern = at
    half = 0.5 * h
    middle = torque + rate * half
    v2 = qd + half * qdd
    then = time + half
    a2 = frozen_acceleration(joint, q + half * qd, v2, middle, then, sign, pattern, lines)
    v3 = qd + half * a2
    a3 = frozen_acceleration(joint, q + half * v2, v3, middle, then, sign, pattern, lines)
    v4 = qd + h * a3
    end = torque + rate * h
    a4 = frozen_acceleration(joint, q + h * v3, v4, end, time + h, sign, pattern, lines)
    return (
        q + h * (qd + 2.0 * (v2 + v3) + v4) / 6.0,
        qd + h * (qdd + 2.0 * (a2 + a3) + a4) / 6.0,
    )


@njit(cache=True, error_model="numpy", inline="always")
def _transmitted(lines: Lines, k: int, qdd: float, sign: float, pattern: int) -> float:
    """Return the transmitted torque of element k, positive where it agrees with the pattern."""
    value = (lines[k, 0] * qdd + lines[k, 1]) * sign
    return float(value if (pattern >> k) & 1 == 1 else -value)


@njit(cache=True, error_model="numpy")
def _agreement(joint: Moved, at: At, lines: Lines, h: float, which: int) -> float:
    """Value that is positive until event ``which`` (element, or -1: reversal), ``h`` later."""
    q, qd, _, torque, rate, time, sign, pattern = at
    if h > 0.0:
        q, qd = _step(joint, at, lines, h)
    if which < 0:
        return sign * qd
    qdd = frozen_acceleration(joint, q, qd, torque + rate * h, time + h, sign, pattern, lines)
    return _transmitted(lines, which, qdd, sign, pattern)


@njit(cache=True, error_model="numpy")
def _locate(joint: Moved, at: At, lines: Lines, h: float, which: int) -> float:
    """Time to an event known to come within ``h``, to rounding (Illinois method).

    Zero if the value is not positive anywhere before, that is, if the event is now.
    """
    a, b = 0.0, h
    fa = _agreement(joint, at, lines, a, which)
    fb = _agreement(joint, at, lines, b, which)
    if fa <= 0.0:
        for _ in range(60):
            c = 0.5 * b
            fc = _agreement(joint, at, lines, c, which)
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
        fc = _agreement(joint, at, lines, c, which)
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
def integrate(
    joint: Moved,
    measured: Array,
    period: float,
    begin: float,
    linear: bool,
    q: float,
    qd: float,
    substeps: int,
    q_out: Array,
    qd_out: Array,
    qdd_out: Array,
    sticking: NDArray[np.bool_],
    counts: NDArray[np.int64],
) -> int:
    """Integrate and write the samples; returns how many there are before a runaway.

    ``begin`` is the time of the first sample, for terms that depend on time; while the joint
    sticks, these count as they were at the last sample.
    ``counts`` are events, reversals and unresolved steps.
    """
    elements, load = joint.elements, joint.load
    n_elements = elements.shape[0]
    lines = np.empty((n_elements, 2))
    bent = np.empty(n_elements, dtype=np.int64)
    n_bent = 0
    for k in range(n_elements):
        if kinked(elements, k):
            bent[n_bent] = k
            n_bent += 1

    samples = measured.shape[0]
    before = 1.0 if qd > 0.0 else (-1.0 if qd < 0.0 else 0.0)  # last direction of motion
    sign = before  # zero while sticking
    pattern = 0
    qdd = low = high = 0.0
    for i in range(samples):
        start = load[GAIN] * measured[i] - load[OFFSET]
        stamp = begin + i * period
        if not (abs(q) <= RUNAWAY and math.isfinite(qd)):
            return i
        # At a sample a held torque jumps, and direction and power flow are decided afresh; a
        # linear one goes on, and so do they unless the joint stands.
        if qd == 0.0:
            low, high = breakaway_torques(joint, q, stamp)
            was, sign = sign, 1.0 if start > high else (-1.0 if start < low else 0.0)
            if sign != 0.0:
                if was == 0.0 and i > 0:
                    counts[0] += 1
                if before * sign < 0.0:
                    counts[1] += 1
                before = sign
        if sign == 0.0:
            qdd = 0.0
        elif i == 0 or not linear or qd == 0.0:
            qdd, pattern = exact_acceleration(joint, q, qd, start, stamp, sign)
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
                torque, time = start + rate * now, stamp + now
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
                        torque, time = start + rate * now, stamp + now
                    counts[0] += 1
                    if before * sign < 0.0:
                        counts[1] += 1
                    before = sign
                    qdd, pattern = exact_acceleration(joint, q, qd, torque, time, sign)
                    continue

                at = At(q, qd, qdd, torque, rate, time, sign, pattern)
                q1, qd1 = _step(joint, at, lines, h)
                then = torque + rate * h
                qdd1 = frozen_acceleration(joint, q1, qd1, then, time + h, sign, pattern, lines)
                dip = 0.0
                which = -2
                if sign * qd1 <= 0.0:
                    which = -1
                else:
                    if qd != 0.0:  # from rest it moves off, whatever the rounding of qdd
                        dip = _dip(sign * qd, sign * qdd, sign * qd1, sign * qdd1, h)
                    for j in range(n_bent):
                        if _transmitted(lines, bent[j], qdd1, sign, pattern) < 0.0:
                            which = bent[j]
                if which == -2 and dip == 0.0:
                    q, qd, qdd, now = q1, qd1, qdd1, end
                    continue

                # Something happens within the step: find what comes first.
                ahead = h
                first = -2
                if dip > 0.0 and _agreement(joint, at, lines, dip, -1) <= 0.0:
                    ahead = dip
                    which = -1
                if which == -1:
                    ahead = _locate(joint, at, lines, ahead, -1)
                    first = -1
                for j in range(n_bent):
                    if _agreement(joint, at, lines, ahead, bent[j]) < 0.0:
                        ahead = _locate(joint, at, lines, ahead, bent[j])
                        first = bent[j]
                if first == -2:
                    q, qd, qdd, now = q1, qd1, qdd1, end
                    continue
                events += 1
                counts[0] += 1
                if events > _MAX_EVENTS:
                    counts[2] += 1
                    q, qd, now, first = q1, qd1, end, -1 if sign * qd1 <= 0.0 else -3
                elif ahead > 0.0:
                    q, qd = _step(joint, at, lines, ahead)
                    now = end if ahead == h else now + ahead
                elif first == -1:
                    # It was about to leave, by no more than rounding: it has not left.
                    now, qd, sign, qdd = end, 0.0, 0.0, 0.0
                    low, high = breakaway_torques(joint, q, time)
                    continue
                torque, time = start + rate * now, stamp + now
                if first >= 0:
                    pattern ^= 1 << first
                    qdd = frozen_acceleration(joint, q, qd, torque, time, sign, pattern, lines)
                elif first == -3:
                    qdd, pattern = exact_acceleration(joint, q, qd, torque, time, sign)
                else:
                    qd = qdd = 0.0
                    low, high = breakaway_torques(joint, q, time)
                    sign = 1.0 if torque > high else (-1.0 if torque < low else 0.0)
                    if sign != 0.0:
                        if before * sign < 0.0:
                            counts[1] += 1
                        before = sign
                        qdd, pattern = exact_acceleration(joint, q, qd, torque, time, sign)
    return int(samples)


@njit(cache=True, error_model="numpy", parallel=True)
def integrate_segments(
    elements: Array,
    load: Array,
    carried: CarriedValues | None,
    added: tuple[float, float],
    torque: Array,
    period: float,
    begin: float,
    linear: bool,
    starts: NDArray[np.int64],
    ends: NDArray[np.int64],
    q0: Array,
    qd0: Array,
    substeps: int,
    valid: NDArray[np.bool_],
) -> tuple[Array, Array]:
    """Integrate many parameter vectors, each anew at the start of every segment.

    ``torque`` is ``(n, N)``, or ``(1, N)`` for one that acts on all. Gives positions and speeds.
    """
    n, segments = elements.shape[0], starts.shape[0]
    q = np.full((n, torque.shape[1]), np.nan)
    qd = np.full((n, torque.shape[1]), np.nan)
    for job in prange(n * segments):
        i, k = job // segments, job % segments
        if valid[i]:
            a, b = starts[k], ends[k]
            done = integrate(
                moved(elements[i], load[i], carried_by(carried, i), added[0], added[1]),
                torque[i if torque.shape[0] > 1 else 0, a:b],
                period,
                begin + a * period,
                linear,
                q0[i, k],
                qd0[i, k],
                substeps,
                q[i, a:b],
                qd[i, a:b],
                np.empty(b - a),
                np.empty(b - a, dtype=np.bool_),
                np.zeros(3, dtype=np.int64),
            )
            q[i, a + done : b] = np.nan
            qd[i, a + done : b] = np.nan
    return q, qd
