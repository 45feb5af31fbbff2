"""The element equation, compiled once for all models.

Inverse and forward model share these functions, so they cannot disagree; exports and the law in
formulas are made of their source. Rows of ``elements`` and entries of ``load`` are laid out by
:meth:`Joint.tables`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.typing import NDArray

from bayesfric.mechanism.own_term import call
from bayesfric.recordings.arrays import Array

# Terms that the kernels write out, by their slots: an element is a row of the first, the load
# and the measurement make up the second.
ELEMENT_SLOTS = (
    "ratio", "inertia", "coulomb_positive", "coulomb_negative", "viscous", "quadratic",
    "stribeck_ratio", "stribeck_load_ratio", "stribeck_velocity", "stribeck_exponent",
    "load_drive", "load_back", "load_drive_difference", "load_back_difference",
    "load_speed", "load_square",
)  # fmt: skip
LOAD_SLOTS = ("inertia", "first_moment", "gravity_angle", "gravity", "offset", "gain")
_SLOTS = len(ELEMENT_SLOTS)
(
    RATIO, INERTIA, COULOMB_POSITIVE, COULOMB_NEGATIVE, VISCOUS, QUADRATIC,
    STRIBECK_RATIO, STRIBECK_LOAD_RATIO, STRIBECK_VELOCITY, STRIBECK_EXPONENT,
    LOAD_DRIVE, LOAD_BACK, LOAD_DRIVE_DIFFERENCE, LOAD_BACK_DIFFERENCE, LOAD_SPEED, LOAD_SQUARE,
) = range(_SLOTS)  # fmt: skip
LOAD_INERTIA, FIRST_MOMENT, GRAVITY_ANGLE, GRAVITY, OFFSET, GAIN = range(len(LOAD_SLOTS))
Row = Array | tuple[float, ...]  # of one element
Factors = tuple[float, float]  # of Coulomb and of load-dependent friction
_as_tuple: Any = to_fixed_tuple
# Of functions that only kernels call: what calls them from Python takes a fifth of the compiling.
INNER: Any = {"cache": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


class Samples(NamedTuple):
    """A motion and the other inputs, laid out for the kernels by :meth:`Joint.samples`."""

    sin_q: Array  # (N,) of the joint, rad or m, SI
    cos_q: Array
    speed: Array
    acceleration: Array
    position: Array
    time: Array  # (N,) s
    # (n_carried, N) torque of each term without a slot for a coefficient of one; not used where
    # a parameter shapes it
    columns: Array
    # (n_carried,) index of its element; that of the load is the number of elements, one more
    # what comes on top of the measured torque
    places: NDArray[np.int64]
    reaches: Array  # (n_carried,) speed of its element's input over the joint's
    # (n_carried,) of its compiled column where a parameter shapes it; 0 where none does
    addresses: NDArray[np.int64]


@njit(cache=True, inline="always")
def low_speed(speed: float, width: float, exponent: float) -> float:
    """Share ``exp(-|v/v0|^a)`` of the Stribeck rise of eq. (2), where ``a`` is 2."""
    # a width of zero is the limit in which no speed is low enough for a rise
    if width <= 0.0:
        return 0.0
    x = abs(speed) / width
    return math.exp(-x * x) if exponent == 2.0 else math.exp(-(x**exponent))


@njit(cache=True, inline="always")
def rises(element: Row, speed: float) -> Factors:
    """Factors ``1 + c exp(-|v/v0|^a)`` of Coulomb and of load-dependent friction, eq. (2)."""
    constant, load = element[STRIBECK_RATIO], element[STRIBECK_LOAD_RATIO]
    if constant == 0.0 and load == 0.0:
        return 1.0, 1.0
    share = low_speed(speed, element[STRIBECK_VELOCITY], element[STRIBECK_EXPONENT])
    return 1.0 + constant * share, 1.0 + load * share


@njit(cache=True, inline="always")
def load_losses(element: Row, sign: float, speed: float, rise: float) -> tuple[float, float]:
    """Loss per transmitted torque while the motor side drives, and while the load does, eq. (6)."""
    grown = element[LOAD_SPEED] * abs(speed)
    drive = element[LOAD_DRIVE] + sign * element[LOAD_DRIVE_DIFFERENCE]
    back = element[LOAD_BACK] + sign * element[LOAD_BACK_DIFFERENCE]
    return drive * rise + grown, back * rise + grown


@njit(cache=True, inline="always")
def element_torque(
    element: Row, torque: float, sign: float, speed: float, acceleration: float, risen: Factors
) -> float:
    """Torque at an element's input for one sample, section 2.2 with the friction law of eq. (2).

    Parameters
    ----------
    element
        Row of the table, :data:`ELEMENT_SLOTS`.
    torque
        At its output, brought to the input side, N m or N.
    sign
        Direction of motion, apart from ``speed`` because at rest it is the direction in which
        the joint is about to break away; 0 at rest leaves out what depends on direction.
    speed, acceleration
        Of its input, rad or m, SI.
    risen
        ``r, r_l``, the factors of :func:`rises` at that speed.

    Returns
    -------
    float
        N m or N; with ``T`` the torque and ``s`` the sign, ``T + J a + (C r + mu |T| + mu_T T²) s +
        f v + f3 v|v|``, where ``mu`` is ``mu_1`` for ``T s > 0`` and ``mu_2`` else, each times
        ``r_l``.
    """
    rise, load_rise = risen
    drive, back = load_losses(element, sign, speed, load_rise)
    power = torque * sign
    constant = element[COULOMB_POSITIVE] if sign > 0.0 else element[COULOMB_NEGATIVE]
    # mu_1 while the motor side drives, mu_2 while the load does (eq. 6)
    load = drive * power if power > 0.0 else -back * power
    return (
        torque
        + element[INERTIA] * acceleration
        + (constant * rise + load + element[LOAD_SQUARE] * torque * torque) * sign
        + speed * (element[VISCOUS] + element[QUADRATIC] * abs(speed))
    )


@njit(cache=True, inline="always")
def gravity_torque(load: Array, sin_q: float, cos_q: float) -> float:
    """Gravity on the load, ``g ml sin(q + q_g)``."""
    angle = load[GRAVITY_ANGLE]
    sine = sin_q if angle == 0.0 else sin_q * math.cos(angle) + cos_q * math.sin(angle)
    return float(load[GRAVITY] * load[FIRST_MOMENT] * sine)


@njit(cache=True, nogil=True, error_model="numpy")
def inverse_many(elements: Array, load: Array, carried: Array, samples: Samples) -> Array:
    """Measured motor torque of ``n`` parameter vectors at ``N`` samples, eq. (13) in general."""
    n = elements.shape[0]
    out = np.empty((n, samples.speed.shape[0]))
    if n == 0:
        return out
    low = _low_speeds(elements, samples.speed)
    for i in range(n):
        _inverse(elements[i], load[i], carried[i], samples, low, elements[0], out[i])
    return out


@njit(**INNER, error_model="numpy")
def _low_speeds(elements: Array, speed: Array) -> Array:
    """Share of the Stribeck rise ``(n_elements, N)`` with what shapes it in the first vector.

    Most vectors of a derivative have the same, and its exponential takes ten times the rest.
    """
    low = np.empty((elements.shape[1], speed.shape[0]))
    to_input = 1.0
    for k in range(elements.shape[1] - 1, -1, -1):
        first = elements[0, k]
        to_input *= first[RATIO]
        width, needed = first[STRIBECK_VELOCITY] / to_input, False
        for i in range(elements.shape[0]):
            rise, load_rise = elements[i, k, STRIBECK_RATIO], elements[i, k, STRIBECK_LOAD_RATIO]
            needed |= rise != 0.0 or load_rise != 0.0
        for j in range(speed.shape[0]):
            share = low_speed(speed[j], width, first[STRIBECK_EXPONENT]) if needed else 0.0
            low[k, j] = share
    return low


@njit(**INNER, error_model="numpy")
def _inverse(
    elements: Array,
    load: Array,
    carried: Array,
    samples: Samples,
    low: Array,
    first: Array,
    out: Array,
) -> None:
    """Write the measured motor torque of one parameter vector into ``out``."""
    for j in range(out.shape[0]):
        weight = gravity_torque(load, samples.sin_q[j], samples.cos_q[j])
        out[j] = load[LOAD_INERTIA] * samples.acceleration[j] + weight
    _carry(carried, samples, elements.shape[0], out)
    to_input = 1.0
    for k in range(elements.shape[0] - 1, -1, -1):
        to_input *= elements[k, RATIO]
        _through_element(elements[k], first[k], to_input, samples, low[k], out)
        _carry(carried, samples, k, out)
    for j in range(out.shape[0]):
        out[j] = (out[j] + load[OFFSET]) / load[GAIN]
    _carry(carried, samples, elements.shape[0] + 1, out)


@njit(**INNER)
def _carry(carried: Array, samples: Samples, place: int, out: Array) -> None:
    """Add the terms of one element, or the load, that have no slot."""
    for t in range(carried.shape[0]):
        if samples.places[t] != place:
            continue
        value, shape = carried[t, 0], carried[t, 1]
        address, reach = samples.addresses[t], samples.reaches[t]
        for j in range(out.shape[0]):
            if address == 0:
                out[j] += value * samples.columns[t, j]
            else:
                q, qd = reach * samples.position[j], reach * samples.speed[j]
                sign = float(np.sign(samples.speed[j]))
                out[j] += value * call(address, q, qd, sign, samples.time[j], shape)


@njit(**INNER)
def _through_element(
    element: Array, first: Array, to_input: float, samples: Samples, low: Array, out: Array
) -> None:
    """Carry all samples through one element: ``out`` goes from its output to its input."""
    to_torque = 1.0 / element[RATIO]
    # of the joint's speed instead of the input's
    scaled = element.copy()
    scaled[INERTIA] *= to_input
    scaled[VISCOUS] *= to_input
    scaled[QUADRATIC] *= to_input**2
    scaled[LOAD_SPEED] *= to_input
    scaled[STRIBECK_VELOCITY] /= to_input
    # a tuple, or the compiler must assume that writing `out` changes it
    row = _as_tuple(scaled, _SLOTS)
    constant, load = row[STRIBECK_RATIO], row[STRIBECK_LOAD_RATIO]
    known = (
        element[STRIBECK_VELOCITY] == first[STRIBECK_VELOCITY]
        and element[STRIBECK_EXPONENT] == first[STRIBECK_EXPONENT]
    )
    for j in range(out.shape[0]):
        v = samples.speed[j]
        sign = (v > 0.0) * 1.0 - (v < 0.0) * 1.0
        risen = (1.0 + constant * low[j], 1.0 + load * low[j]) if known else rises(row, v)
        out[j] = element_torque(row, out[j] * to_torque, sign, v, samples.acceleration[j], risen)
