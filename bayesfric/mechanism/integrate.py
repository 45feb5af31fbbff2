"""Integration of the motion: Runge-Kutta steps from one event to the next.

Within a step direction of motion and power flow are held, so the equation of motion is smooth; what
ends that (an event: a reversal, breakaway, a change of power flow) is located to rounding, and
integration restarts there.
"""

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
    acceleration,
    breakaway_torques,
    held_acceleration,
    moved,
)
from bayesfric.recordings.arrays import Array

RUNAWAY = 1e6  # rad or m
_MAX_EVENTS = 64  # in one step
Counts = NDArray[np.int64]


# Rows of an integrated motion.
POSITION, SPEED, ACCELERATION, STICKS = 0, 1, 2, 3
# Events within a step other than the index of an element whose power flow turns.
_REVERSAL, _NOTHING = -1, -2


class At(NamedTuple):
    """State at the begin of a step."""

    q: float  # of the joint, rad or m, SI
    qd: float
    qdd: float
    torque: float  # true motor torque, N m or N, and its change per second
    rate: float
    time: float  # s
    sign: float  # direction of motion, 1 or -1
    pattern: int  # bit k is set where the motor side drives element k


@njit(cache=True, error_model="numpy")
def _step(joint: Moved, at: At, lines: Lines, h: float) -> tuple[float, float]:
    """Take one classical Runge-Kutta step of ``h`` s, direction and power flow held."""
    q, qd, qdd, torque, rate, time, sign, pattern = at
    half = 0.5 * h
    middle = torque + rate * half
    v2 = qd + half * qdd
    then = time + half
    a2 = held_acceleration(joint, q + half * qd, v2, middle, then, sign, pattern, lines)
    v3 = qd + half * a2
    a3 = held_acceleration(joint, q + half * v2, v3, middle, then, sign, pattern, lines)
    v4 = qd + h * a3
    end = torque + rate * h
    a4 = held_acceleration(joint, q + h * v3, v4, end, time + h, sign, pattern, lines)
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
    qdd = held_acceleration(joint, q, qd, torque + rate * h, time + h, sign, pattern, lines)
    return _transmitted(lines, which, qdd, sign, pattern)


@njit(cache=True, error_model="numpy")
def _locate(joint: Moved, at: At, lines: Lines, h: float, which: int) -> float:
    """Time to an event known to come within ``h``, to rounding (Illinois method).

    Zero if the value is not positive anywhere before, that is, if the event is now. See Dowell and
    Jarratt, BIT 11, 1971.
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


class _Going(NamedTuple):
    """State of the joint between two events."""

    q: float
    qd: float
    qdd: float
    sign: float  # direction of motion, zero while it sticks
    before: float  # the last direction
    pattern: int
    low: float  # breakaway torques
    high: float


@njit(cache=True, error_model="numpy")
def _at_rest(
    joint: Moved, going: _Going, torque: float, time: float, lines: Lines, counts: Counts
) -> _Going:
    """Let a standing joint stick, or move off."""
    low, high = breakaway_torques(joint, going.q, time)
    sign = 1.0 if torque > high else (-1.0 if torque < low else 0.0)
    going = _Going(going.q, 0.0, 0.0, sign, going.before, going.pattern, low, high)
    return going if sign == 0.0 else _moves_off(joint, going, torque, time, lines, counts)


@njit(cache=True, error_model="numpy")
def _moves_off(
    joint: Moved, going: _Going, torque: float, time: float, lines: Lines, counts: Counts
) -> _Going:
    """Compute acceleration and power flow for a direction, and count a reversal."""
    q, qd, _, sign, before, _, low, high = going
    counts[1] += before * sign < 0.0
    qdd, pattern = acceleration(joint, q, qd, torque, time, sign, lines)
    return _Going(q, qd, qdd, sign, sign, pattern, low, high)


@njit(cache=True, error_model="numpy", inline="always")
def _first_event(
    joint: Moved, at: At, lines: Lines, h: float, q1: float, qd1: float
) -> tuple[float, int, float]:
    """Find what comes first within a step of ``h`` that ends at ``q1`` and ``qd1``.

    Gives when, what, and the acceleration at the end of a step in which nothing happens.
    """
    sign, pattern = at.sign, at.pattern
    then = at.torque + at.rate * h
    qdd1 = held_acceleration(joint, q1, qd1, then, at.time + h, sign, pattern, lines)
    dip, which = 0.0, _NOTHING
    if sign * qd1 <= 0.0:
        which = _REVERSAL
    else:
        if at.qd != 0.0:  # from standstill it moves off, despite the rounding of qdd
            dip = _dip(sign * at.qd, sign * at.qdd, sign * qd1, sign * qdd1, h)
        for k in range(joint.elements.shape[0]):
            bent = (joint.kinks >> k) & 1 == 1
            if bent and _transmitted(lines, k, qdd1, sign, pattern) < 0.0:
                which = k
    if which == _NOTHING and dip == 0.0:
        return h, _NOTHING, qdd1
    ahead, first = h, _NOTHING
    if dip > 0.0 and _agreement(joint, at, lines, dip, _REVERSAL) <= 0.0:
        ahead, which = dip, _REVERSAL
    if which == _REVERSAL:
        ahead, first = _locate(joint, at, lines, ahead, _REVERSAL), _REVERSAL
    for k in range(joint.elements.shape[0]):
        if (joint.kinks >> k) & 1 == 1 and _agreement(joint, at, lines, ahead, k) < 0.0:
            ahead, first = _locate(joint, at, lines, ahead, k), k
    return ahead, first, qdd1


@njit(cache=True, error_model="numpy", inline="always")
def _advance(
    joint: Moved,
    going: _Going,
    start: float,
    rate: float,
    stamp: float,
    span: tuple[float, float],
    lines: Lines,
    counts: Counts,
) -> _Going:
    """Move a joint over a ``span`` of s since a sample's ``stamp``; its torque is linear in it."""
    now, end = span
    events = 0
    while now < end:
        q, qd, qdd, sign, before, pattern, low, high = going
        torque, time, h = start + rate * now, stamp + now, end - now
        if sign == 0.0:
            then = start + rate * end
            if low <= torque <= high and low <= then <= high:
                break
            sign = 1.0 if torque > high or (torque >= low and then > high) else -1.0
            if low <= torque <= high:
                limit = high if sign > 0.0 else low
                now = min(now + (limit - torque) / rate, end)
                torque, time = start + rate * now, stamp + now
            counts[0] += 1
            off = _Going(q, qd, qdd, sign, before, pattern, low, high)
            going = _moves_off(joint, off, torque, time, lines, counts)
            continue
        at = At(q, qd, qdd, torque, rate, time, sign, pattern)
        q1, qd1 = _step(joint, at, lines, h)
        ahead, first, qdd1 = _first_event(joint, at, lines, h, q1, qd1)
        if first == _NOTHING:
            return _Going(q1, qd1, qdd1, sign, before, pattern, low, high)
        events += 1
        counts[0] += 1
        if events > _MAX_EVENTS:  # no more events are located in this step
            counts[2] += 1
            q, qd, now = q1, qd1, end
            if sign * qd > 0.0:
                torque, time = start + rate * end, stamp + end
                qdd, pattern = acceleration(joint, q, qd, torque, time, sign, lines)
                return _Going(q, qd, qdd, sign, before, pattern, low, high)
            first = _REVERSAL
        elif ahead > 0.0:
            q, qd = _step(joint, at, lines, ahead)
            now = end if ahead == h else now + ahead
        elif first == _REVERSAL:
            # it had moved off by no more than rounding
            low, high = breakaway_torques(joint, q, time)
            return _Going(q, 0.0, 0.0, 0.0, before, pattern, low, high)
        torque, time = start + rate * now, stamp + now
        going = _Going(q, qd, qdd, sign, before, pattern, low, high)
        if first == _REVERSAL:
            going = _at_rest(joint, going, torque, time, lines, counts)
        else:
            pattern ^= 1 << first
            qdd = held_acceleration(joint, q, qd, torque, time, sign, pattern, lines)
            going = _Going(q, qd, qdd, sign, before, pattern, low, high)
    return going


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
    out: Array,
    counts: Counts,
) -> int:
    """Integrate and write the samples.

    At rest the joint sticks while the torque lies within its breakaway torques. A torque that goes
    straight leaves them at a time that is found in closed form; reversals and sign changes of a
    transmitted torque are located by root finding. Of a step with more than 64 events the rest is
    integrated without locating any, and counted.
    """
    gain, offset = joint.gain, joint.offset
    lines = np.empty((joint.elements.shape[0], 2))
    before = 1.0 if qd > 0.0 else (-1.0 if qd < 0.0 else 0.0)
    going = _Going(q, qd, 0.0, before, before, 0, 0.0, 0.0)
    samples = measured.shape[0]
    for i in range(samples):
        start, stamp = gain * measured[i] - offset, begin + i * period
        if not (abs(going.q) <= RUNAWAY and math.isfinite(going.qd)):
            return i
        # At a sample a held torque jumps, and direction and power flow are decided afresh; a
        # linear one goes on, and so do they unless the joint stands.
        if going.qd == 0.0:
            stuck = going.sign == 0.0
            going = _at_rest(joint, going, start, stamp, lines, counts)
            counts[0] += stuck and going.sign != 0.0 and i > 0
        elif i == 0 or not linear:
            at = going.q, going.qd, start, stamp, going.sign
            qdd, pattern = acceleration(joint, *at, lines)
            going = _Going(going.q, going.qd, qdd, going.sign, going.before, pattern, 0.0, 0.0)
        out[POSITION, i], out[SPEED, i], out[ACCELERATION, i] = going.q, going.qd, going.qdd
        out[STICKS, i] = going.sign == 0.0
        if i == samples - 1:
            break
        rate = 0.0
        if linear:
            rate = (gain * measured[i + 1] - offset - start) / period
        now = 0.0
        for step in range(1, substeps + 1):
            end = period * step / substeps
            going = _advance(joint, going, start, rate, stamp, (now, end), lines, counts)
            now = end
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
    """Integrate many parameter vectors, restarted in every segment, in parallel."""
    n, segments = elements.shape[0], starts.shape[0]
    q = np.full((n, torque.shape[1]), np.nan)
    qd = np.full((n, torque.shape[1]), np.nan)
    for job in prange(n * segments):
        i, k = job // segments, job % segments
        if valid[i]:
            a, b = starts[k], ends[k]
            out = np.full((4, b - a), np.nan)
            integrate(
                moved(elements[i], load[i], carried, added[0], added[1], i),
                torque[i if torque.shape[0] > 1 else 0, a:b],
                period,
                begin + a * period,
                linear,
                q0[i, k],
                qd0[i, k],
                substeps,
                out,
                np.zeros(3, dtype=np.int64),
            )
            q[i, a:b], qd[i, a:b] = out[POSITION], out[SPEED]
    return q, qd
