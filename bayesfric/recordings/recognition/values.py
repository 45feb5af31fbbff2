"""What the values of columns say: which unit is likely, and which columns belong together."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayesfric.recordings import units
from bayesfric.recordings.measurement import Array

# Units of angles and of angular speeds, the usual first.
ANGLES, SPEEDS = ("rad", "deg", "turn"), ("rad/s", "deg/s", "rpm", "turn/s")
# How well a velocity and a differentiated position must agree, and how well their factor is known.
_ALIKE, _FACTOR = 0.95, 0.08
_SAME = 0.999
# A period above is no number of seconds that anyone records a motion with.
_SLOWEST = 0.5
_TIMES = ("s", "ms", "us", "ns")
# Samples that are compared; of long recordings the middle.
_MOST = 20_000
_SMOOTH = 9


def increases(values: Array) -> bool:
    """Whether values are strictly increasing, as time is."""
    return values.size > 2 and bool(np.all(np.diff(values) > 0.0))


def time_unit(period: float) -> str:
    """Give the likely unit of time stamps by their period."""
    for unit in _TIMES[:-1]:
        if period < _SLOWEST:
            return unit
        period /= 1000.0
    return _TIMES[-1]


def whole(values: Array) -> bool:
    """Whether there are whole numbers only, and many of them."""
    return bool(np.all(values == np.round(values))) and np.unique(values).size > 20


def bits(values: Array) -> int | None:
    """Bits of signed numbers that were recorded as unsigned; ``None`` where they were not."""
    for count in (8, 16, 32):
        full = 2.0**count
        inside = values.min() >= 0.0 and values.max() < full and values.max() >= full / 2.0
        middle = (values > 0.25 * full) & (values < 0.75 * full)
        if inside and whole(values) and not middle.any() and (values < 0.25 * full).any():
            return count
    return None


def speed_factor(position: Array, velocity: Array, time: Array) -> float | None:
    """Give the velocity over the differentiated position; ``None`` where they are not alike."""
    part = middle(position.size)
    q, v, t = position[part], velocity[part], time[part]
    moving = smooth(np.gradient(q, t))
    seen = smooth(v)
    size = float(np.sqrt((moving @ moving) * (seen @ seen)))
    if not size > 0.0 or not math.isfinite(size):
        return None
    both = float(moving @ seen)
    return both / float(moving @ moving) if abs(both) > _ALIKE * size else None


def pairs(factor: float, angle: str = "", speed: str = "") -> list[tuple[str, str]]:
    """List units of position and velocity whose factor it is, of those that are known.

    The nearest come first, and of equally near ones the usual.
    """
    found = []
    for one in [angle] if angle else ANGLES:
        for other in [speed] if speed else SPEEDS:
            expected = units.scale([one], "angle") / units.scale([other], "angular_speed")
            off = abs(abs(factor) / expected - 1.0)
            if off < _FACTOR:
                found.append((round(off, 6), one, other))
    nearest = min(found, default=(0.0,))[0]
    return [(one, other) for off, one, other in found if off == nearest]


def explained(effort: Array, position: Array, time: Array) -> float:
    """Share of a signal's variance that a motion explains: inertia, friction and gravity."""
    part = middle(position.size)
    t, y, q = (smooth(one[part]) for one in (time, effort, position))
    v = np.gradient(q, t)
    a = np.gradient(v, t)
    columns = [np.ones_like(q), q, np.sin(q), np.cos(q), v, np.tanh(v / (0.05 * v.std() + 1e-30))]
    terms = np.column_stack([*columns, a])
    scale = np.sqrt(np.mean(terms**2, axis=0)) + 1e-30
    try:
        left = y - terms / scale @ np.linalg.lstsq(terms / scale, y, rcond=None)[0]
    except np.linalg.LinAlgError:  # numbers that no joint has
        return 0.0
    whole_of = float(np.var(y))
    return 1.0 - float(np.var(left)) / whole_of if whole_of > 0.0 else 0.0


def alike(one: Array, other: Array) -> bool:
    """Whether two signals are the same but for their scale, as a position and what it follows."""
    both = [_unit(x - x.mean()) for x in (one, other)]
    return abs(float(both[0] @ both[1])) > _SAME


def derivatives(signals: Sequence[Array], time: Array) -> list[tuple[int, int, float]]:
    """Find pairs of signals of which the second is the speed of the first, and their factor."""
    part = middle(time.size)
    moves = [_unit(smooth(np.gradient(s[part], time[part]))) for s in signals]
    seen = [_unit(smooth(s[part])) for s in signals]
    alike = np.array(moves) @ np.array(seen).T if signals else np.zeros((0, 0))
    found = []
    for i, j in zip(*np.nonzero(alike > _ALIKE), strict=True):
        factor = speed_factor(signals[i], signals[j], time)
        if i != j and factor is not None and pairs(factor):
            found.append((int(i), int(j), factor))
    return found


def _unit(values: Array) -> Array:
    size = float(np.linalg.norm(values))
    return values / size if size > 0.0 and math.isfinite(size) else np.zeros_like(values)


def middle(count: int) -> slice:
    """Give the part of a long recording that is looked at."""
    begin = max(0, (count - _MOST) // 2)
    return slice(begin, begin + _MOST)


def smooth(values: NDArray[np.float64]) -> Array:
    """Average neighbours, against the steps of an encoder."""
    width = min(_SMOOTH, max(1, values.size // 20))
    return np.convolve(values, np.full(width, 1.0 / width), mode="valid")
