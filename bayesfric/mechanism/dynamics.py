"""Acceleration of the joint for a motor torque, in closed form, and when it sticks.

At a given direction of motion the motor torque is a piecewise linear, rising
function of the acceleration with one kink for each load-dependent element, so it
is inverted without iteration.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
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
    element_torque,
    gravity_torque,
    motor_torque,
    speed_factor,
)

# What the compiled functions of the forward model need of the joint: the element and load
# tables of one parameter vector and, added mass included, the load's inertia and
# the amplitude and angle of its gravity torque.
Joint = tuple[NDArray[np.float64], NDArray[np.float64], float, float, float]
# Lines T = slope qdd + intercept of the transmitted torques; scratch memory.
Lines = NDArray[np.float64]


@njit(cache=True, error_model="numpy")
def joint_tables(
    elements: NDArray[np.float64],
    load: NDArray[np.float64],
    added_inertia: float,
    added_moment: float,
) -> Joint:
    """Gather what the forward model needs of one parameter vector, added mass included."""
    # one sine instead of a sine and a cosine
    sine = gravity_torque(load, added_moment, 1.0, 0.0)
    cosine = gravity_torque(load, added_moment, 0.0, 1.0)
    inertia = load[LOAD_INERTIA] + added_inertia
    return elements, load, inertia, math.hypot(sine, cosine), math.atan2(cosine, sine)


@njit(cache=True, error_model="numpy", inline="always")
def _load_torque(joint: Joint, q: float) -> float:
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
def frozen_acceleration(
    joint: Joint,
    q: float,
    qd: float,
    torque: float,
    sign: float,
    pattern: int,
    lines: Lines,
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
def exact_acceleration(
    joint: Joint, q: float, qd: float, torque: float, sign: float
) -> tuple[float, int]:
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
def breakaway_torques(joint: Joint, q: float) -> tuple[float, float]:
    """Motor torques between which the joint at rest sticks."""
    gravity = _load_torque(joint, q)
    return (
        motor_torque(joint[0], gravity, -1.0, 0.0, 0.0),
        motor_torque(joint[0], gravity, 1.0, 0.0, 0.0),
    )
