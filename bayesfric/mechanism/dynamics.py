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
    COULOMB_NEGATIVE,
    COULOMB_POSITIVE,
    INERTIA,
    LOAD_BACK,
    LOAD_DRIVE,
    LOAD_INERTIA,
    QUADRATIC,
    RATIO,
    STRIBECK_RATIO,
    VISCOUS,
    element_input,
    element_torque,
    gravity_torque,
    speed_factor,
)
from bayesfric.mechanism.own_term import call


class CarriedValues(NamedTuple):
    """Terms without a slot in the kernels."""

    # (n_carried,) coefficients, or (n, n_carried) of several parameter vectors
    values: NDArray[np.float64]
    places: NDArray[np.int64]  # (n_carried,) index of the element of each, as in kernels.Samples
    addresses: NDArray[np.int64]  # (n_carried,) of their compiled columns


class Moved(NamedTuple):
    """What the compiled functions of the forward model need of a joint; one parameter vector."""

    elements: NDArray[np.float64]  # elements, load: tables of Joint.tables
    load: NDArray[np.float64]
    inertia: float  # of the load, added mass included, kg m² or kg
    # weight, angle: amplitude and angle of its gravity torque, added mass included, N m and
    # rad
    weight: float
    angle: float
    # terms without a slot; None for a joint that has none, which is compiled by itself: a
    # third faster
    carried: CarriedValues | None


# Lines T = slope qdd + intercept of the transmitted torques; scratch memory.
Lines = NDArray[np.float64]


@njit(cache=True, error_model="numpy")
def moved(
    elements: NDArray[np.float64],
    load: NDArray[np.float64],
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
        carried.values[vector], carried.places, carried.addresses
    )


# without annotations: a compiled overload must look like what it stands for
def _carried_torque(carried, k, to_input, q, qd, sign, time) -> Any:  # type: ignore[no-untyped-def]
    """Torque of the terms without a slot of element k, or of the load."""
    total = 0.0
    for t in range(carried.values.shape[0]):
        if carried.places[t] == k:
            address = carried.addresses[t]
            total += carried.values[t] * call(address, to_input * q, to_input * qd, sign, time)
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

    Leaves the lines of the transmitted torques in ``lines``.
    """
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
            elements, k, slope, intercept, drives, sign, to_input * qd, to_input
        )
        intercept += _carried_torque(joint.carried, k, to_input, q, qd, sign, time)
    return (torque - intercept) / slope


@njit(cache=True, error_model="numpy")
def exact_acceleration(
    joint: Moved, q: float, qd: float, torque: float, time: float, sign: float
) -> tuple[float, int]:
    """Acceleration and pattern, in closed form.

    The motor torque rises with the acceleration, with one kink per load-dependent
    element. Whether the solution lies above or below a kink is read off the torque
    at the kink, from the load to the motor; then everything is one line.
    """
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
        if elements[k, LOAD_DRIVE] != 0.0 or elements[k, LOAD_BACK] != 0.0:
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
            elements, k, slope, intercept, drives, sign, to_input * qd, to_input
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
