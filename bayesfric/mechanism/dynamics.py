"""Acceleration of the joint for a motor torque, in closed form, and when it sticks.

At a given direction of motion the motor torque is a piecewise linear, rising
function of the acceleration with one kink for each load-dependent element, so it
is inverted without iteration.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit, types
from numba.extending import overload
from numpy.typing import NDArray

from bayesfric.mechanism.kernels import (
    INERTIA,
    LOAD_DRIVE,
    LOAD_INERTIA,
    LOAD_SQUARE,
    RATIO,
    element_input,
    element_torque,
    gravity_torque,
    load_losses,
    rises,
)
from bayesfric.mechanism.own_term import call
from bayesfric.recordings.arrays import Array


class CarriedValues(NamedTuple):
    """Terms without a slot in the kernels."""

    # (n_carried, 2) coefficients and what shapes each, or (n, n_carried, 2) of several vectors
    values: Array
    places: NDArray[np.int64]  # (n_carried,) index of the element of each, as in kernels.Samples
    addresses: NDArray[np.int64]  # (n_carried,) of their compiled columns
    stamps: Array  # (K,) times of what some are multiplied by, s
    levels: Array  # (n_carried, K) what each is multiplied by


class Moved(NamedTuple):
    """What the compiled functions of the forward model need of a joint; one parameter vector."""

    elements: Array  # elements, load: tables of Chain.tables
    load: Array
    inertia: float  # of the load, added mass included, kg m² or kg
    # weight, angle: amplitude and angle of its gravity torque, added mass included, N m and
    # rad
    weight: float
    angle: float
    # terms without a slot; None for a joint that has none, which is compiled by itself: a
    # third faster
    carried: CarriedValues | None


# Steps of Newton's method, which ends earlier where it moves by rounding only.
_ROUNDS = 40
_EXACT = 4e-16
# Lines T = slope qdd + intercept of the transmitted torques; scratch memory.
Lines = Array


@njit(cache=True, error_model="numpy")
def moved(
    elements: Array,
    load: Array,
    carried: CarriedValues | None,
    added_inertia: float,
    added_moment: float,
) -> Moved:
    """Gather what the forward model needs of one parameter vector, added mass included."""
    # one sine instead of a sine and a cosine
    sine = gravity_torque(load, added_moment, 1.0, 0.0)
    cosine = gravity_torque(load, added_moment, 0.0, 1.0)
    inertia = load[LOAD_INERTIA] + added_inertia
    weight, angle = math.hypot(sine, cosine), math.atan2(cosine, sine)
    return Moved(elements, load, inertia, weight, angle, carried)


def carried_by(carried: Any, vector: int) -> Any:
    """Take the terms of one of several parameter vectors."""
    return None if carried is None else carried._replace(values=carried.values[vector])


@overload(carried_by)
def _typed_carried_by(carried, vector):  # type: ignore[no-untyped-def]  # noqa: ARG001
    if isinstance(carried, types.NoneType):
        return lambda carried, vector: None  # noqa: ARG005
    return lambda carried, vector: CarriedValues(
        carried.values[vector], carried.places, carried.addresses, carried.stamps, carried.levels
    )


@njit(cache=True, error_model="numpy")
def _level(stamps: Array, levels: Array, time: float) -> float:
    """Look up a signal as :class:`bayesfric.recordings.inputs.Signal` does."""
    if time <= stamps[0]:
        return float(levels[0])
    if time >= stamps[-1]:
        return float(levels[-1])
    k = np.searchsorted(stamps, time, side="right")
    share = (time - stamps[k - 1]) / (stamps[k] - stamps[k - 1])
    return float(levels[k - 1] + share * (levels[k] - levels[k - 1]))


# without annotations: a compiled overload must look like what it stands for
def _carried_torque(carried, k, to_input, q, qd, sign, time) -> Any:  # type: ignore[no-untyped-def]
    """Torque of the terms without a slot of element k, or of the load."""
    total = 0.0
    for t in range(carried.values.shape[0]):
        if carried.places[t] == k:
            value, shape = carried.values[t, 0], carried.values[t, 1]
            address = carried.addresses[t]
            value *= _level(carried.stamps, carried.levels[t], time)
            total += value * call(address, to_input * q, to_input * qd, sign, time, shape)
    return total


@overload(_carried_torque)
def _typed_carried_torque(carried, k, to_input, q, qd, sign, time):  # type: ignore[no-untyped-def]  # noqa: ARG001
    if isinstance(carried, types.NoneType):
        return lambda carried, k, to_input, q, qd, sign, time: 0.0  # noqa: ARG005
    return _carried_torque


@njit(cache=True, error_model="numpy", inline="always")
def _load_torque(joint: Moved, q: float, qd: float, sign: float, time: float) -> float:
    """Torque of the load at constant speed."""
    own = _carried_torque(joint.carried, joint.elements.shape[0], 1.0, q, qd, sign, time)
    return float(joint.weight * math.sin(q + joint.angle) + own)


@njit(cache=True, error_model="numpy")
def motor_torque(
    joint: Moved, q: float, qd: float, qdd: float, sign: float, time: float, load_torque: float
) -> float:
    """Carry the load's torque through every element to the motor."""
    torque = load_torque
    to_input = 1.0
    for k in range(joint.elements.shape[0] - 1, -1, -1):
        to_input *= joint.elements[k, RATIO]
        torque = element_input(
            joint.elements[k], torque, sign, to_input * qd, to_input * qdd
        ) + _carried_torque(joint.carried, k, to_input, q, qd, sign, time)
    return torque


@njit(cache=True, error_model="numpy", inline="always")
def _element_line(
    elements: Array,
    k: int,
    slope: float,
    intercept: float,
    drives: bool,
    sign: float,
    speed: float,
    to_input: float,
    about: float,
) -> tuple[float, float]:
    """Carry the transmitted torque ``slope qdd + intercept`` to the input of element k.

    ``drives`` says which of mu_1 and mu_2 holds; ``to_input`` is the element's input
    speed over the joint's. A loss with the square of the load is taken by its tangent at the
    acceleration ``about``.
    """
    inertia = elements[k, INERTIA]
    _, load_rise = rises(elements[k], speed)
    drive, back = load_losses(elements[k], sign, speed, load_rise)
    # sign |T| is T while the motor side drives and -T while the load does
    factor, shift = 1.0 + drive if drives else 1.0 - back, 0.0
    square = elements[k, LOAD_SQUARE] * sign
    if square != 0.0:
        torque = slope * about + intercept
        factor, shift = factor + 2.0 * square * torque, -square * torque * torque
    losses = element_torque(elements[k], 0.0, sign, speed, 0.0)
    return slope * factor + inertia * to_input, intercept * factor + losses + shift


@njit(cache=True, error_model="numpy", inline="always")
def kinked(elements: Array, k: int) -> bool:
    """Whether the torque at the input of element k has a kink where power changes direction."""
    found = False
    for slot in range(LOAD_DRIVE, LOAD_SQUARE):
        found |= elements[k, slot] != 0.0
    return found


@njit(cache=True, error_model="numpy", inline="always")
def _squares(elements: Array) -> bool:
    found = False
    for k in range(elements.shape[0]):
        found |= elements[k, LOAD_SQUARE] != 0.0
    return found


@njit(cache=True, error_model="numpy")
def frozen_acceleration(
    joint: Moved,
    q: float,
    qd: float,
    torque: float,
    time: float,
    sign: float,
    pattern: int,
    lines: Lines,
) -> float:
    """Acceleration while direction and pattern (bit k: element k drives) are held.

    Leaves the lines of the transmitted torques in ``lines``, tangents where a loss grows with
    the square of the load.
    """
    found = _held_acceleration(joint, q, qd, torque, time, sign, pattern, lines, 0.0)
    if _squares(joint.elements):
        for _ in range(_ROUNDS):
            before = found
            found = _held_acceleration(joint, q, qd, torque, time, sign, pattern, lines, before)
            if abs(found - before) <= _EXACT * abs(found):
                break
    return found


@njit(cache=True, error_model="numpy")
def _held_acceleration(
    joint: Moved,
    q: float,
    qd: float,
    torque: float,
    time: float,
    sign: float,
    pattern: int,
    lines: Lines,
    about: float,
) -> float:
    """Take one step of Newton's method for :func:`frozen_acceleration` from ``about``."""
    elements = joint.elements
    slope, intercept = joint.inertia, _load_torque(joint, q, qd, sign, time)
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
            elements, k, slope, intercept, drives, sign, to_input * qd, to_input, about
        )
        intercept += _carried_torque(joint.carried, k, to_input, q, qd, sign, time)
    return (torque - intercept) / slope


@njit(cache=True, error_model="numpy")
def exact_acceleration(
    joint: Moved, q: float, qd: float, torque: float, time: float, sign: float
) -> tuple[float, int]:
    """Acceleration and pattern, in closed form unless a loss grows with the square of the load.

    The motor torque rises with the acceleration, with one kink per load-dependent
    element. Whether the solution lies above or below a kink is read off the torque
    at the kink, from the load to the motor; then everything is one line, or the tangent of one.
    """
    found, pattern = _free_acceleration(joint, q, qd, torque, time, sign, 0.0)
    if _squares(joint.elements):
        for _ in range(_ROUNDS):
            before = found
            found, pattern = _free_acceleration(joint, q, qd, torque, time, sign, before)
            if abs(found - before) <= _EXACT * abs(found):
                break
    return found, pattern


@njit(cache=True, error_model="numpy")
def _free_acceleration(
    joint: Moved, q: float, qd: float, torque: float, time: float, sign: float, about: float
) -> tuple[float, int]:
    """Take one step of Newton's method for :func:`exact_acceleration` from ``about``."""
    elements = joint.elements
    still = _load_torque(joint, q, qd, sign, time)
    slope, intercept = joint.inertia, still
    low, high = -math.inf, math.inf
    pattern = 0
    to_input = 1.0
    for k in range(elements.shape[0] - 1, -1, -1):
        ratio = elements[k, RATIO]
        to_input *= ratio
        slope /= ratio
        intercept /= ratio
        drives = False
        if kinked(elements, k):
            if slope == 0.0:
                drives = intercept * sign > 0.0
            else:
                kink = -intercept / slope
                if low < kink < high:
                    there = joint.inertia * kink + still
                    if motor_torque(joint, q, qd, kink, sign, time, there) < torque:
                        low = kink
                    else:
                        high = kink
                drives = ((kink <= low) == (slope > 0.0)) == (sign > 0.0)
        if drives:
            pattern |= 1 << k
        slope, intercept = _element_line(
            elements, k, slope, intercept, drives, sign, to_input * qd, to_input, about
        )
        intercept += _carried_torque(joint.carried, k, to_input, q, qd, sign, time)
    return (torque - intercept) / slope, pattern


@njit(cache=True, error_model="numpy")
def breakaway_torques(joint: Moved, q: float, time: float) -> tuple[float, float]:
    """Motor torques between which the joint at rest sticks."""
    down, up = _load_torque(joint, q, 0.0, -1.0, time), _load_torque(joint, q, 0.0, 1.0, time)
    return (
        motor_torque(joint, q, 0.0, 0.0, -1.0, time, down),
        motor_torque(joint, q, 0.0, 0.0, 1.0, time, up),
    )
