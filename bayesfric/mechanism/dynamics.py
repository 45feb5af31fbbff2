"""Acceleration of the joint under a motor torque, in closed form, and its breakaway torques.

At a given direction of motion the motor torque is a piecewise linear, rising
function of the acceleration with one kink for each load-dependent element, so it
is inverted without iteration (but for a loss with the square of the load: Newton's method).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit, types
from numba.extending import overload
from numpy.typing import NDArray

from bayesfric.mechanism.kernels import (
    GAIN,
    INERTIA,
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
from bayesfric.recordings.arrays import Array


class CarriedValues(NamedTuple):
    """Terms without a slot in the kernels."""

    values: Array  # (n, n_carried, 2) coefficient and shape of each, of several vectors
    places: NDArray[np.int64]  # (n_carried,) index of its element, as in Samples
    addresses: NDArray[np.int64]  # (n_carried,) of their compiled columns
    stamps: Array  # (K,) times of the signals that some are multiplied by, s
    levels: Array  # (n_carried, K) factor of each at these times


class Moved(NamedTuple):
    """A joint with one parameter vector, for the compiled functions of the forward model."""

    elements: Array  # (n_elements, n_slots), a vector's of Chain.tables
    gain: float  # true motor torque is gain * measured - offset, N m or N
    offset: float
    inertia: float  # of the load, known added mass included, kg m² or kg
    weight: float  # gravity torque is weight sin(q + angle), added mass included, N m and rad
    angle: float
    kinks: int  # bit k: the input torque of element k has a kink where power changes direction
    squares: bool  # whether a loss grows with the square of the load
    carried: CarriedValues | None  # terms without a slot, if any
    vector: int  # index of their vector


# Most steps of Newton's method, and its relative tolerance: rounding.
_ROUNDS = 40
_EXACT = 4e-16
# (n_elements, 2) lines T = slope qdd + intercept of the transmitted torques; scratch memory.
Lines = Array


@njit(cache=True, error_model="numpy")
def moved(
    elements: Array,
    load: Array,
    carried: CarriedValues | None,
    added_inertia: float,
    added_moment: float,
    vector: int = 0,
) -> Moved:
    """Prepare one parameter vector of :meth:`Chain.tables`, added mass included."""
    # one sine instead of a sine and a cosine
    sine = gravity_torque(load, added_moment, 1.0, 0.0)
    cosine = gravity_torque(load, added_moment, 0.0, 1.0)
    inertia = load[LOAD_INERTIA] + added_inertia
    weight, angle = math.hypot(sine, cosine), math.atan2(cosine, sine)
    kinks, squares = 0, False
    for k in range(elements.shape[0]):
        squares |= elements[k, LOAD_SQUARE] != 0.0
        for slot in range(LOAD_DRIVE, LOAD_SQUARE):
            if elements[k, slot] != 0.0:
                kinks |= 1 << k
    gain, offset = load[GAIN], load[OFFSET]
    return Moved(elements, gain, offset, inertia, weight, angle, kinks, squares, carried, vector)


@njit(cache=True, error_model="numpy")
def _level(stamps: Array, levels: Array, time: float) -> float:
    """Look up a signal as :class:`bayesfric.recordings.measurement.Signal` does."""
    if time <= stamps[0]:
        return float(levels[0])
    if time >= stamps[-1]:
        return float(levels[-1])
    k = np.searchsorted(stamps, time, side="right")
    share = (time - stamps[k - 1]) / (stamps[k] - stamps[k - 1])
    return float(levels[k - 1] + share * (levels[k] - levels[k - 1]))


# without annotations: a compiled overload needs the same signature
def _carried_torque(carried, vector, k, to_input, q, qd, sign, time) -> Any:  # type: ignore[no-untyped-def]
    """Torque of the terms without a slot of element k, or of the load, at its own input.

    ``to_input`` is the speed there over the joint's, ``q`` and ``qd`` are the joint's.
    """
    total = 0.0
    for t in range(carried.places.shape[0]):
        if carried.places[t] == k:
            value, shape = carried.values[vector, t, 0], carried.values[vector, t, 1]
            address = carried.addresses[t]
            value *= _level(carried.stamps, carried.levels[t], time)
            total += value * call(address, to_input * q, to_input * qd, sign, time, shape)
    return total


@overload(_carried_torque)
def _typed_carried_torque(carried, vector, k, to_input, q, qd, sign, time):  # type: ignore[no-untyped-def]  # noqa: ARG001
    if isinstance(carried, types.NoneType):
        return lambda carried, vector, k, to_input, q, qd, sign, time: 0.0  # noqa: ARG005
    return _carried_torque


@njit(cache=True, error_model="numpy", inline="always")
def _load_torque(joint: Moved, q: float, qd: float, sign: float, time: float) -> float:
    """Torque of the load at constant speed: gravity and its carried terms, at the joint."""
    place = joint.elements.shape[0]
    carried = _carried_torque(joint.carried, joint.vector, place, 1.0, q, qd, sign, time)
    return float(joint.weight * math.sin(q + joint.angle) + carried)


@njit(cache=True, error_model="numpy")
def motor_torque(
    joint: Moved,
    q: float,
    qd: float,
    qdd: float,
    sign: float,
    time: float,
    load_torque: float,
) -> float:
    """Carry the load's torque through every element to the motor."""
    torque = load_torque
    to_input = 1.0
    for k in range(joint.elements.shape[0] - 1, -1, -1):
        to_input *= joint.elements[k, RATIO]
        torque = element_torque(
            joint.elements[k],
            torque / joint.elements[k, RATIO],
            sign,
            to_input * qd,
            to_input * qdd,
        ) + _carried_torque(joint.carried, joint.vector, k, to_input, q, qd, sign, time)
    return torque


@njit(cache=True, error_model="numpy")
def acceleration(
    joint: Moved, q: float, qd: float, torque: float, time: float, sign: float, lines: Lines
) -> tuple[float, int]:
    """Solve for the acceleration, and for the elements that the motor side drives.

    Whether it lies above or below an element's kink follows from the torque there, from load to
    motor; then ``torque = slope qdd + intercept``, by Newton's method where a loss is quadratic.
    """
    qdd, pattern = _solved(joint, q, qd, torque, time, sign, 0, True, lines, 0.0)
    if joint.squares:
        for _ in range(_ROUNDS):
            about = qdd
            qdd, pattern = _solved(joint, q, qd, torque, time, sign, 0, True, lines, about)
            if abs(qdd - about) <= _EXACT * abs(qdd):
                break
    return qdd, pattern


@njit(cache=True, error_model="numpy")
def held_acceleration(
    joint: Moved,
    q: float,
    qd: float,
    torque: float,
    time: float,
    sign: float,
    pattern: int,
    lines: Lines,
) -> float:
    """Return the :func:`acceleration` for a given direction and power flow, where it is smooth."""
    qdd, _ = _solved(joint, q, qd, torque, time, sign, pattern, False, lines, 0.0)
    if joint.squares:
        for _ in range(_ROUNDS):
            about = qdd
            qdd, _ = _solved(joint, q, qd, torque, time, sign, pattern, False, lines, about)
            if abs(qdd - about) <= _EXACT * abs(qdd):
                break
    return qdd


# inlined, so that held and free power flow are compiled separately
@njit(cache=True, error_model="numpy", inline="always")
def _solved(
    joint: Moved,
    q: float,
    qd: float,
    torque: float,
    time: float,
    sign: float,
    pattern: int,
    free: bool,
    lines: Lines,
    about: float,
) -> tuple[float, int]:
    """Solve from load to motor, with quadratic losses linearised at the acceleration ``about``.

    ``slope`` and ``intercept`` are those of the torque over ``qdd``. ``free`` finds the power flow
    at every kink within ``low`` to ``high``; else ``pattern`` gives it.
    """
    elements = joint.elements
    still = _load_torque(joint, q, qd, sign, time)
    slope, intercept = joint.inertia, still
    low, high = -math.inf, math.inf
    flow, to_input = 0 if free else pattern, 1.0
    for k in range(elements.shape[0] - 1, -1, -1):
        ratio = elements[k, RATIO]
        to_input *= ratio
        slope /= ratio
        intercept /= ratio
        lines[k, 0] = slope
        lines[k, 1] = intercept
        if free and (joint.kinks >> k) & 1 == 1:
            if slope == 0.0:
                drives = intercept * sign > 0.0
            else:
                kink = -intercept / slope
                if low < kink < high:
                    at_kink = joint.inertia * kink + still
                    if motor_torque(joint, q, qd, kink, sign, time, at_kink) < torque:
                        low = kink
                    else:
                        high = kink
                drives = ((kink <= low) == (slope > 0.0)) == (sign > 0.0)
            if drives:
                flow |= 1 << k
        speed = to_input * qd
        _, load_rise = rises(elements[k], speed)
        drive, back = load_losses(elements[k], sign, speed, load_rise)
        # sign |T| is T while the motor side drives and -T while the load does
        factor, shift = 1.0 + drive if (flow >> k) & 1 == 1 else 1.0 - back, 0.0
        square = elements[k, LOAD_SQUARE] * sign
        if square != 0.0:
            passed = slope * about + intercept
            factor, shift = factor + 2.0 * square * passed, -square * passed * passed
        losses = element_torque(elements[k], 0.0, sign, speed, 0.0)
        slope = slope * factor + elements[k, INERTIA] * to_input
        intercept = intercept * factor + losses + shift
        intercept += _carried_torque(joint.carried, joint.vector, k, to_input, q, qd, sign, time)
    return (torque - intercept) / slope, flow


@njit(cache=True, error_model="numpy")
def breakaway_torques(joint: Moved, q: float, time: float) -> tuple[float, float]:
    """Motor torques between which the joint at rest sticks."""
    down, up = _load_torque(joint, q, 0.0, -1.0, time), _load_torque(joint, q, 0.0, 1.0, time)
    return (
        motor_torque(joint, q, 0.0, 0.0, -1.0, time, down),
        motor_torque(joint, q, 0.0, 0.0, 1.0, time, up),
    )
