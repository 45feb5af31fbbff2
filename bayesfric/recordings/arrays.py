"""Arrays of samples, and ranges and flags of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Index = NDArray[np.int64]
# Half-open ranges of samples.
Segments = tuple[tuple[int, int], ...]


def rms(x: Array) -> float:
    """Root mean square of ``(n,)``."""
    return float(np.sqrt(np.mean(x**2)))


def runs(flags: Flags, begin: int = 0) -> Segments:
    """Give the ranges of flagged samples, the first of all being number ``begin``."""
    ends = begin + np.flatnonzero(np.diff(flags, prepend=False, append=False))
    return tuple(zip(ends[::2].tolist(), ends[1::2].tolist(), strict=True))


def in_segments(segments: Segments, n: int) -> Flags:
    """Flag those of ``n`` samples that lie in segments."""
    flags = np.zeros(n, dtype=np.bool_)
    for a, b in segments:
        flags[a:b] = True
    return flags


def near(flags: Flags, reach: int, ahead: int | None = None) -> Flags:
    """Flag what lies up to ``reach`` samples after a flagged one, or ``ahead`` before it."""
    ahead = reach if ahead is None else ahead
    n = len(flags)
    before = np.concatenate([[0], np.cumsum(flags)])
    index = np.arange(n)
    inside = before[np.minimum(index + ahead + 1, n)] - before[np.maximum(index - reach, 0)]
    return np.asarray(inside > 0)


def without_excluded(segments: Segments, excluded: Flags) -> Segments:
    """Split segments at excluded samples."""
    return tuple(part for a, b in segments for part in runs(~excluded[a:b], a))


def pchip(at: Array, stamps: Array, values: Array) -> Array:
    """Interpolate by PCHIP, which keeps the slope continuous; constant beyond its ends."""
    from scipy.interpolate import pchip_interpolate

    return np.asarray(pchip_interpolate(stamps, values, np.clip(at, stamps[0], stamps[-1])))
