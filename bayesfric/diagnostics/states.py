"""States that a motion leaves behind: bristles, a load in its gap, an elastic transmission."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from scipy import fft

from bayesfric.recordings.arrays import Array, Segments

# Share of critical damping of an elastic transmission, and samples below which it has no spectrum.
_DAMPING, _FEW = 0.05, 20


@njit(cache=True)
def deflection(q, reach):  # type: ignore[no-untyped-def]
    """Deflection of a bristle over its most ``(N,)``, -1 to 1, along a motion (Dahl 1968)."""
    z = np.zeros(q.size)
    for i in range(1, q.size):
        x = (q[i] - q[i - 1]) / reach
        side = 1.0 if x > 0.0 else -1.0
        z[i] = side + (z[i - 1] - side) * math.exp(-abs(x))
    return z


@njit(cache=True)
def since_reversal(q, least):  # type: ignore[no-untyped-def]
    """Distance ``(N,)`` since the last reversal that went further than ``least``."""
    out = np.empty(q.size)
    turn = far = q[0]
    way = 0.0
    for i in range(q.size):
        x = q[i]
        if way == 0.0:
            if abs(x - turn) > least:
                way = 1.0 if x > turn else -1.0
                far = x
        elif (x - far) * way > 0.0:
            far = x
        elif (far - x) * way > least:
            turn, way, far = far, -way, x
        out[i] = abs(x - turn)
    return out


@njit(cache=True)
def in_gap(need, period, half, begins):  # type: ignore[no-untyped-def]
    """Place ``(N,)`` of a load in its gap, -1 to 1.

    It flies freely from where the acceleration ``need`` that the motor must give it changes sign,
    until it meets the other side. ``half`` is half the gap; it begins anew where ``begins``.
    """
    out = np.zeros(need.size)
    side, x, v, flying = 1.0, 0.0, 0.0, False
    for i in range(need.size):
        if begins[i]:
            side = 1.0 if need[i] > 0.0 else -1.0
            x, v, flying = side * half, 0.0, False
        if not flying and need[i] * side < 0.0:
            flying, v = True, 0.0
        if flying:
            x += v * period + 0.5 * need[i] * period**2
            v += need[i] * period
            if abs(x) >= half:
                side = 1.0 if x > 0.0 else -1.0
                x, v, flying = side * half, 0.0, False
        out[i] = x / half
    return out


def resonating(x: Array, segments: Segments, period: float, hertz: Sequence[float]) -> Array:
    """Give what elastic transmissions add to a load's torque ``(N,)`` of their own frequencies.

    One row a frequency, ``(k, N)``.
    """
    out = np.zeros((len(hertz), x.size))
    for a, b in segments:
        if b - a <= _FEW:
            continue
        # without its trend a part joins its own beginning
        part = x[a:b] - np.linspace(x[a], x[b - 1], b - a)
        size = fft.next_fast_len(2 * (b - a), real=True)
        f = fft.rfftfreq(size, period) / np.asarray(hertz)[:, None]
        more = 1.0 / (1.0 - f**2 + 2j * _DAMPING * f) - 1.0
        out[:, a:b] = fft.irfft(more * fft.rfft(part, size), size)[:, : b - a]
    return out
