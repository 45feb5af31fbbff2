"""Motion of a joint under a motor torque, compiled: acceleration, stiction, Runge-Kutta steps.

At a given direction of motion the motor torque is a piecewise linear, rising function of the
acceleration with one kink for each load-dependent element, so it is inverted without iteration
(but for a loss with the square of the load: Newton's method). While direction and power flow are
held the equation of motion is smooth; what ends that (an event: a reversal, breakaway, a change of
power flow) is located to rounding, and integration restarts there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from bayesfric.mechanism.kernels import (
    GAIN,
    INERTIA,
    INNER,
    LOAD_DRIVE,
    LOAD_INERTIA,
    LOAD_SQUARE,
    OFFSET,
    RATIO,
    element_torque,
    gravity_torque,
    load_losses,
    rises,
)
from bayesfric.mechanism.own_term import call
from bayesfric.recordings.arrays import Array, Flags, Index

# Rows of an integrated motion.
POSITION, SPEED, ACCELERATION, STICKS = range(4)
# Power flow that is not given; events within a step other than the index of an element whose power
# flow turns.
FREE = _REVERSAL = -1
_NOTHING = -2


class Carried(NamedTuple):
    """Terms without a slot in the kernels."""

    values: Array  # (n, n_carried, 2) coefficient and shape of each, of several vectors
    places: Index  # (n_carried,) index of its element, as in Samples
    addresses: Index  # (n_carried,) of their compiled columns
    stamps: Array  # (K,) times of the signals that some are multiplied by, s
    levels: Array  # (n_carried, K) factor of each at these times


class Plant(NamedTuple):
    """A joint with one parameter vector."""

    elements: Array  # (n_elements, n_slots)
    gain: float  # true motor torque is gain * measured - offset, N m or N
    offset: float
    inertia: float  # of the load, known added mass included, kg m² or kg
    weight: float  # gravity torque is weight sin(q + angle), added mass included, N m and rad
    angle: float
    kinks: int  # bit k: the input torque of element k has a kink where power changes direction
    squares: bool  # whether a loss grows with the square of the load
    carried: Carried | None  # where there are such terms: else nothing of them is compiled
    vector: int  # its index there
    # (n_elements, 2) scratch memory: T = slope qdd + intercept of the transmitted torques
    lines: Array
    # what a drive takes off the torque per position and speed of the joint, N m/rad and N m s/rad
    stiffness: float
    damping: float
    pull: float  # torque on the load that is known at this time, N m or N at the joint


class State(NamedTuple):
    """State of the joint at the begin of a step, and its motor torque until the end."""

    q: float  # of the joint, rad or m, SI
    qd: float
    qdd: float
    sign: float  # direction of motion, 1 or -1; 0 while it sticks
    before: float  # the last direction
    pattern: int  # bit k is set where the motor side drives element k
    torque: float  # true motor torque, N m or N, and its change per second
    rate: float
    time: float  # s


@njit(cache=True, error_model="numpy")
def plant_of(all_elements: Array, loads: Array, carried: Carried | None, vector: int) -> Plant:
    """Prepare one of the parameter vectors that are laid out as :class:`Tables`."""
    elements, load = all_elements[vector], loads[vector]
    # one sine instead of a sine and a cosine
    sine, cosine = gravity_torque(load, 1.0, 0.0), gravity_torque(load, 0.0, 1.0)
    kinks, squares = 0, False
    for k in range(elements.shape[0]):
        squares |= elements[k, LOAD_SQUARE] != 0.0
        for slot in range(LOAD_DRIVE, LOAD_SQUARE):
            if elements[k, slot] != 0.0:
                kinks |= 1 << k
    return Plant(
        elements,
        load[GAIN],
        load[OFFSET],
        load[LOAD_INERTIA],
        math.hypot(sine, cosine),
        math.atan2(cosine, sine),
        kinks,
        squares,
        carried,
        vector,
        np.empty((elements.shape[0], 2)),
        0.0,
        0.0,
        0.0,
    )


@njit(cache=True, error_model="numpy", inline="always")
def fed_back(plant: Plant, stiffness: float, damping: float, inertia: float, pull: float) -> Plant:
    """Return the joint under a drive that takes so much off the torque by position and speed.

    Its load has so much inertia and torque in addition.
    """
    return Plant(
        plant.elements,
        plant.gain,
        plant.offset,
        plant.inertia + inertia,
        plant.weight,
        plant.angle,
        plant.kinks,
        plant.squares,
        plant.carried,
        plant.vector,
        plant.lines,
        stiffness,
        damping,
        pull,
    )


@njit(**INNER, error_model="numpy")
def _level(stamps: Array, levels: Array, time: float) -> float:
    """Look up a signal as :class:`bayesfric.recordings.measurement.Signal` does."""
    if time <= stamps[0]:
        return float(levels[0])
    if time >= stamps[-1]:
        return float(levels[-1])
    k = np.searchsorted(stamps, time, side="right")
    share = (time - stamps[k - 1]) / (stamps[k] - stamps[k - 1])
    return float(levels[k - 1] + share * (levels[k] - levels[k - 1]))


@njit(**INNER, error_model="numpy")
def _carried_torque(
    carried: Carried | None,
    vector: int,
    k: int,
    to_input: float,
    q: float,
    qd: float,
    sign: float,
    time: float,
) -> float:
    """Torque of the terms without a slot of element k, or of the load, at its own input.

    ``to_input`` is the speed there over the joint's, ``q`` and ``qd`` are the joint's.
    """
    total = 0.0
    if carried is not None:
        for t in range(carried.places.shape[0]):
            if carried.places[t] == k:
                value, shape = carried.values[vector, t, 0], carried.values[vector, t, 1]
                value *= _level(carried.stamps, carried.levels[t], time)
                address, place, speed = carried.addresses[t], to_input * q, to_input * qd
                total += value * call(address, place, speed, sign, time, shape)
    return total


@njit(**INNER, error_model="numpy")
def _load_torque(plant: Plant, q: float, qd: float, sign: float, time: float) -> float:
    """Torque of the load at constant speed: gravity and its carried terms, at the joint."""
    carried = _carried_torque(
        plant.carried, plant.vector, plant.elements.shape[0], 1.0, q, qd, sign, time
    )
    if plant.weight == 0.0:
        return float(plant.pull + carried)
    return float(plant.weight * math.sin(q + plant.angle) + plant.pull + carried)


@njit(cache=True, error_model="numpy")
def motor_torque(plant: Plant, q: float, qd: float, qdd: float, sign: float, time: float) -> float:
    """Carry the load's torque through every element to the motor."""
    torque = plant.inertia * qdd + _load_torque(plant, q, qd, sign, time)
    to_input = 1.0
    for k in range(plant.elements.shape[0] - 1, -1, -1):
        element = plant.elements[k]
        to_input *= element[RATIO]
        speed = to_input * qd
        torque = element_torque(
            element, torque / element[RATIO], sign, speed, to_input * qdd, rises(element, speed)
        ) + _carried_torque(plant.carried, plant.vector, k, to_input, q, qd, sign, time)
    return float(torque)


@njit(cache=True, error_model="numpy")
def acceleration(
    plant: Plant, q: float, qd: float, torque: float, time: float, sign: float, pattern: int
) -> tuple[float, int]:
    """Solve for the acceleration, from load to motor, and for the power flow where it is free.

    ``torque = slope qdd + intercept`` of the power flow that ``pattern`` gives, or that the torque
    at every kink within ``low`` to ``high`` decides. A loss with the square of the load is
    linearised at the acceleration ``about``, by Newton's method.
    """
    elements = plant.elements
    torque -= plant.stiffness * q + plant.damping * qd
    still = _load_torque(plant, q, qd, sign, time)
    qdd, flow, about = 0.0, 0, 0.0
    for _ in range(40):
        slope, intercept = plant.inertia, still
        low, high = -math.inf, math.inf
        flow, to_input = 0 if pattern == FREE else pattern, 1.0
        for k in range(elements.shape[0] - 1, -1, -1):
            element = elements[k]
            to_input *= element[RATIO]
            slope /= element[RATIO]
            intercept /= element[RATIO]
            plant.lines[k, 0] = slope
            plant.lines[k, 1] = intercept
            if pattern == FREE and (plant.kinks >> k) & 1 == 1:
                if slope == 0.0:
                    drives = intercept * sign > 0.0
                else:
                    kink = -intercept / slope
                    if low < kink < high:
                        if motor_torque(plant, q, qd, kink, sign, time) < torque:
                            low = kink
                        else:
                            high = kink
                    drives = ((kink <= low) == (slope > 0.0)) == (sign > 0.0)
                if drives:
                    flow |= 1 << k
            speed = to_input * qd
            risen = rises(element, speed)
            drive, back = load_losses(element, sign, speed, risen[1])
            # sign |T| is T while the motor side drives and -T while the load does
            factor, shift = 1.0 + drive if (flow >> k) & 1 == 1 else 1.0 - back, 0.0
            square = element[LOAD_SQUARE] * sign
            if square != 0.0:
                passed = slope * about + intercept
                factor, shift = factor + 2.0 * square * passed, -square * passed * passed
            losses = element_torque(element, 0.0, sign, speed, 0.0, risen)
            slope = slope * factor + element[INERTIA] * to_input
            intercept = intercept * factor + losses + shift
            intercept += _carried_torque(
                plant.carried, plant.vector, k, to_input, q, qd, sign, time
            )
        qdd = (torque - intercept) / slope
        if not plant.squares or abs(qdd - about) <= 4e-16 * abs(qdd):  # rounding
            break
        about = qdd
    return qdd, flow


@njit(cache=True, error_model="numpy")
def breakaway_torques(plant: Plant, q: float, time: float) -> tuple[float, float]:
    """Motor torques between which the joint at rest sticks, a drive's share at rest on top."""
    spring = plant.stiffness * q
    return (
        motor_torque(plant, q, 0.0, 0.0, -1.0, time) + spring,
        motor_torque(plant, q, 0.0, 0.0, 1.0, time) + spring,
    )


@njit(**INNER, error_model="numpy")
def _step(plant: Plant, state: State, h: float) -> tuple[float, float]:
    """Take one classical Runge-Kutta step of ``h`` s, direction and power flow held."""
    q, qd, qdd, sign, _, pattern, torque, rate, time = state
    half = 0.5 * h
    middle, then = torque + rate * half, time + half
    v2 = qd + half * qdd
    a2, _ = acceleration(plant, q + half * qd, v2, middle, then, sign, pattern)
    v3 = qd + half * a2
    a3, _ = acceleration(plant, q + half * v2, v3, middle, then, sign, pattern)
    v4 = qd + h * a3
    a4, _ = acceleration(plant, q + h * v3, v4, torque + rate * h, time + h, sign, pattern)
    return (
        q + h * (qd + 2.0 * (v2 + v3) + v4) / 6.0,
        qd + h * (qdd + 2.0 * (a2 + a3) + a4) / 6.0,
    )


@njit(**INNER, error_model="numpy", forceinline=True)
def _transmitted(plant: Plant, k: int, qdd: float, sign: float, pattern: int) -> float:
    """Return the transmitted torque of element k, positive where it agrees with the pattern."""
    value = (plant.lines[k, 0] * qdd + plant.lines[k, 1]) * sign
    return float(value if (pattern >> k) & 1 == 1 else -value)


@njit(**INNER, error_model="numpy")
def _agreement(plant: Plant, state: State, h: float, which: int) -> float:
    """Value that is positive until event ``which`` (element, or -1: reversal), ``h`` later."""
    q, qd, _, sign, _, pattern, torque, rate, time = state
    if h > 0.0:
        q, qd = _step(plant, state, h)
    if which < 0:
        return sign * qd
    qdd, _ = acceleration(plant, q, qd, torque + rate * h, time + h, sign, pattern)
    return float(_transmitted(plant, which, qdd, sign, pattern))


@njit(**INNER, error_model="numpy")
def _locate(plant: Plant, state: State, h: float, which: int) -> float:
    """Time to an event known to come within ``h``, to rounding (Illinois method).

    Zero if the value is not positive anywhere before, that is, if the event is now. See Dowell and
    Jarratt, BIT 11, 1971.
    """
    a, b = 0.0, h
    fa = _agreement(plant, state, a, which)
    fb = _agreement(plant, state, b, which)
    if fa <= 0.0:
        for _ in range(60):
            c = 0.5 * b
            fc = _agreement(plant, state, c, which)
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
        fc = _agreement(plant, state, c, which)
        if fc > 0.0:
            if c - a < b - c:
                gb *= 0.5
            a, fa, ga = c, fc, fc
        else:
            if b - c < c - a:
                ga *= 0.5
            b, fb, gb = c, fc, fc
    return b if -fb <= fa else a


@njit(**INNER, error_model="numpy")
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


@njit(**INNER, error_model="numpy")
def _first_event(
    plant: Plant, state: State, h: float, q1: float, qd1: float
) -> tuple[float, int, float]:
    """Find what comes first within a step of ``h`` that ends at ``q1`` and ``qd1``.

    Gives when, what, and the acceleration at the end of a step in which nothing happens.
    """
    _, qd, qdd, sign, _, pattern, torque, rate, time = state
    qdd1, _ = acceleration(plant, q1, qd1, torque + rate * h, time + h, sign, pattern)
    dip, which = 0.0, _NOTHING
    if sign * qd1 <= 0.0:
        which = _REVERSAL
    else:
        if qd != 0.0:  # from standstill it moves off, despite the rounding of qdd
            dip = _dip(sign * qd, sign * qdd, sign * qd1, sign * qdd1, h)
        for k in range(plant.elements.shape[0]):
            bent = (plant.kinks >> k) & 1 == 1
            if bent and _transmitted(plant, k, qdd1, sign, pattern) < 0.0:
                which = k
    if which == _NOTHING and dip == 0.0:
        return h, _NOTHING, qdd1
    ahead, first = h, _NOTHING
    if dip > 0.0 and _agreement(plant, state, dip, _REVERSAL) <= 0.0:
        ahead, which = dip, _REVERSAL
    if which == _REVERSAL:
        ahead, first = _locate(plant, state, ahead, _REVERSAL), _REVERSAL
    for k in range(plant.elements.shape[0]):
        if (plant.kinks >> k) & 1 == 1 and _agreement(plant, state, ahead, k) < 0.0:
            ahead, first = _locate(plant, state, ahead, k), k
    return ahead, first, qdd1


@njit(**INNER, error_model="numpy")
def _at_rest(
    plant: Plant, q: float, before: float, torque: float, time: float, counts: Index
) -> tuple[float, float, float, int]:
    """Let a standing joint stick, or move off: acceleration, direction, last one, power flow."""
    low, high = breakaway_torques(plant, q, time)
    sign = 1.0 if torque > high else (-1.0 if torque < low else 0.0)
    if sign == 0.0:
        return 0.0, 0.0, before, 0
    counts[1] += before * sign < 0.0
    qdd, pattern = acceleration(plant, q, 0.0, torque, time, sign, FREE)
    return qdd, sign, sign, pattern


@njit(**INNER, error_model="numpy")
def _advance(
    plant: Plant, state: State, now: float, end: float, counts: Index, most_events: int = 64
) -> State:
    """Move a joint from ``now`` to ``end``, in s since a sample.

    ``state`` has the torque and time of that sample. After so many events no more are located.
    """
    q, qd, qdd, sign, before, pattern, start, rate, stamp = state
    events = 0
    while now < end:
        torque, time, h = start + rate * now, stamp + now, end - now
        if sign == 0.0:
            low, high = breakaway_torques(plant, q, time)
            then = start + rate * end
            if low <= torque <= high and low <= then <= high:
                break
            sign = 1.0 if torque > high or (torque >= low and then > high) else -1.0
            if low <= torque <= high:
                limit = high if sign > 0.0 else low
                now = min(now + (limit - torque) / rate, end)
                torque, time = start + rate * now, stamp + now
            counts[0] += 1
            counts[1] += before * sign < 0.0
            before = sign
            qdd, pattern = acceleration(plant, q, qd, torque, time, sign, FREE)
            continue
        at = State(q, qd, qdd, sign, before, pattern, torque, rate, time)
        q1, qd1 = _step(plant, at, h)
        ahead, first, qdd1 = _first_event(plant, at, h, q1, qd1)
        if first == _NOTHING:
            q, qd, qdd = q1, qd1, qdd1
            break
        events += 1
        counts[0] += 1
        if events > most_events:
            q, qd, now = q1, qd1, end
            if sign * qd > 0.0:
                torque, time = start + rate * end, stamp + end
                qdd, pattern = acceleration(plant, q, qd, torque, time, sign, FREE)
                break
            first = _REVERSAL
        elif ahead > 0.0:
            q, qd = _step(plant, at, ahead)
            now = end if ahead == h else now + ahead
        elif first == _REVERSAL:
            qd, qdd, sign = 0.0, 0.0, 0.0
            break  # it had moved off by no more than rounding
        torque, time = start + rate * now, stamp + now
        if first == _REVERSAL:
            qd = 0.0
            qdd, sign, before, pattern = _at_rest(plant, q, before, torque, time, counts)
        else:
            pattern ^= 1 << first
            qdd, _ = acceleration(plant, q, qd, torque, time, sign, pattern)
    return State(q, qd, qdd, sign, before, pattern, start, rate, stamp)


@njit(cache=True, error_model="numpy")
def integrate(
    plant: Plant,
    measured: Array,
    period: float,
    begin: float,
    linear: bool,
    q: float,
    qd: float,
    substeps: int,
    out: Array,
    counts: Index,
    runaway: float = 1e6,
) -> int:
    """Integrate, and write the samples (4, N) and the numbers of events and reversals.

    At rest the joint sticks while the torque lies within its breakaway torques. A torque that goes
    straight leaves them at a time that is found in closed form; reversals and sign changes of a
    transmitted torque are located by root finding. Ends beyond ``runaway`` rad or m.
    """
    sign = 1.0 if qd > 0.0 else (-1.0 if qd < 0.0 else 0.0)
    qdd, before, pattern = 0.0, sign, 0
    samples = measured.shape[0]
    for i in range(samples):
        torque, stamp = plant.gain * measured[i] - plant.offset, begin + i * period
        if not (abs(q) <= runaway and math.isfinite(qd)):
            return i
        # At a sample a held torque jumps, and direction and power flow are decided afresh; a
        # linear one goes on, and so do they unless the joint stands.
        if qd == 0.0:
            stuck = sign == 0.0
            qdd, sign, before, pattern = _at_rest(plant, q, before, torque, stamp, counts)
            counts[0] += stuck and sign != 0.0 and i > 0
        elif i == 0 or not linear:
            qdd, pattern = acceleration(plant, q, qd, torque, stamp, sign, FREE)
        out[POSITION, i], out[SPEED, i], out[ACCELERATION, i] = q, qd, qdd
        out[STICKS, i] = sign == 0.0
        if i == samples - 1:
            break
        rate = 0.0
        if linear:
            rate = (plant.gain * measured[i + 1] - plant.offset - torque) / period
        now = 0.0
        for step in range(1, substeps + 1):
            end = period * step / substeps
            state = State(q, qd, qdd, sign, before, pattern, torque, rate, stamp)
            q, qd, qdd, sign, before, pattern, _, _, _ = _advance(plant, state, now, end, counts)
            now = end
    return int(samples)


@njit(cache=True, error_model="numpy", parallel=True)
def integrate_segments(
    elements: Array,
    loads: Array,
    carried: Carried | None,
    valid: Flags,
    torque: Array,
    period: float,
    begin: float,
    linear: bool,
    starts: Index,
    ends: Index,
    q0: Array,
    qd0: Array,
    substeps: int,
) -> tuple[Array, Array]:
    """Integrate many parameter vectors, restarted in every segment, in parallel."""
    n, segments = elements.shape[0], starts.shape[0]
    q, qd = np.full((n, torque.shape[1]), np.nan), np.full((n, torque.shape[1]), np.nan)
    for job in prange(n * segments):
        i, k = job // segments, job % segments
        if valid[i]:
            a, b = starts[k], ends[k]
            row, time = torque[i if torque.shape[0] > 1 else 0, a:b], begin + a * period
            out, counts = np.empty((4, b - a)), np.zeros(2, np.int64)
            plant, state = plant_of(elements, loads, carried, i), (q0[i, k], qd0[i, k])
            done = integrate(plant, row, period, time, linear, *state, substeps, out, counts)
            for j in range(done):
                q[i, a + j], qd[i, a + j] = out[POSITION, j], out[SPEED, j]
    return q, qd
