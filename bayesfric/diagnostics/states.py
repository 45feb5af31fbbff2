"""States that a motion leaves behind: bristles, a load in its gap, an elastic transmission.

What they add to the torque depends on the motion before, so that no function of position, speed and
acceleration stands for it.
"""

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
    """Deflection of a bristle over its most, along a motion.

    Dahl's model of presliding [1]_, ``dz/dq = (1 - z sign(v)) / reach``, exact between samples.

    References
    ----------
    .. [1] P. R. Dahl, "A solid friction model", The Aerospace Corporation, TOR-0158(3107-18)-1
       (1968).

    Shapes: ``q`` (N,), returns (N,).
    """
    z = np.zeros(q.size)
    for i in range(1, q.size):
        x = (q[i] - q[i - 1]) / reach
        side = 1.0 if x > 0.0 else -1.0
        z[i] = side + (z[i - 1] - side) * math.exp(-abs(x))
    return z


@njit(cache=True)
def since_reversal(q, least):  # type: ignore[no-untyped-def]
    """Distance since the last reversal that went further than a least distance.

    Shapes: ``q`` (N,), returns (N,).
    """
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
def in_gap(need, period, half, segments):  # type: ignore[no-untyped-def]
    """Place of a load in its gap (backlash), along a motion.

    It flies freely from where the acceleration that the motor must give it changes sign, until it
    meets the other side, and stays there.

    Shapes: ``need`` (N,), ``segments`` (k, 2), returns (N,).
    """
    out = np.zeros(need.size)
    for a, b in segments:
        side = 1.0 if need[a] > 0.0 else -1.0
        x, v, flying = side * half, 0.0, False
        for i in range(a, b):
            if not flying and need[i] * side < 0.0:
                flying, v = True, 0.0
            if flying:
                x += v * period + 0.5 * need[i] * period**2
                v += need[i] * period
                if abs(x) >= half:
                    side = np.sign(x)
                    x, flying = side * half, False
            out[i] = x / half
    return out


def resonating(x: Array, segments: Segments, period: float, hertz: Sequence[float]) -> Array:
    """Give what elastic transmissions add to a load's torque, by their antiresonances.

    ``1 / (1 - r^2 + 2 i D r) - 1`` of each frequency, r its ratio to the antiresonance, with D =
    0.05 of critical damping.

    Shapes: ``x`` (N,), returns (k, N).
    """
    out = np.zeros((len(hertz), x.size))
    for a, b in segments:
        if b - a <= _FEW:
            continue
        # without its trend a part joins its own beginning
        part = x[a:b]
        part = part - np.linspace(part[0], part[-1], part.size)
        size = fft.next_fast_len(2 * part.size, real=True)
        f = fft.rfftfreq(size, period) / np.asarray(hertz)[:, None]
        more = 1.0 / (1.0 - f**2 + 2j * _DAMPING * f) - 1.0
        out[:, a:b] = fft.irfft(more * fft.rfft(part, size), size)[:, : part.size]
    return out
