"""Hidden states of a motion: bristle deflection, backlash, elastic transmission.

Their torque depends on the past motion; no function of position, speed and acceleration gives it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from scipy import fft

from bayesfric.recordings.arrays import Array, Segments

# Damping ratio of an elastic transmission, and least number of samples of a spectrum.
_DAMPING, _FEW = 0.05, 20


@njit(cache=True)
def deflection(q, reach):  # type: ignore[no-untyped-def]
    """Relative bristle deflection ``(N,)`` by Dahl's model, ``dz/dq = (1 - z sign(v)) / reach``.

    Exact between samples. P. R. Dahl, "A solid friction model", The Aerospace Corporation,
    TOR-0158(3107-18)-1 (1968).
    """
    z = np.zeros(q.size)
    for i in range(1, q.size):
        x = (q[i] - q[i - 1]) / reach
        side = 1.0 if x > 0.0 else -1.0
        z[i] = side + (z[i - 1] - side) * math.exp(-abs(x))
    return z


@njit(cache=True)
def since_reversal(q, least):  # type: ignore[no-untyped-def]
    """Distance ``(N,)`` since the last reversal larger than a least distance."""
    out = np.empty(q.size)
    reversal = extreme = q[0]
    direction = 0.0
    for i in range(q.size):
        x = q[i]
        if direction == 0.0:
            if abs(x - reversal) > least:
                direction = 1.0 if x > reversal else -1.0
                extreme = x
        elif (x - extreme) * direction > 0.0:
            extreme = x
        elif (extreme - x) * direction > least:
            reversal, direction, extreme = extreme, -direction, x
        out[i] = abs(x - reversal)
    return out


@njit(cache=True)
def in_gap(need, period, half, segments):  # type: ignore[no-untyped-def]
    """Relative position ``(N,)`` of a load in its gap (backlash).

    It flies freely from where its acceleration ``need`` changes sign until it meets the other side.
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
    """Return the torque ``(k, N)`` that elastic transmissions add at their antiresonances.

    ``1 / (1 - r^2 + 2 i D r) - 1`` of the load's torque, r the frequency over the antiresonance, D
    = 0.05.
    """
    out = np.zeros((len(hertz), x.size))
    for a, b in segments:
        if b - a <= _FEW:
            continue
        # detrended, its ends join
        part = x[a:b]
        part = part - np.linspace(part[0], part[-1], part.size)
        size = fft.next_fast_len(2 * part.size, real=True)
        f = fft.rfftfreq(size, period) / np.asarray(hertz)[:, None]
        response = 1.0 / (1.0 - f**2 + 2j * _DAMPING * f) - 1.0
        out[:, a:b] = fft.irfft(response * fft.rfft(part, size), size)[:, : part.size]
    return out
