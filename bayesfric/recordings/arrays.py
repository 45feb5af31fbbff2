"""Arrays of samples, and ranges and flags of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Index = NDArray[np.int64]
# Half-open ranges of samples.
Segments = tuple[tuple[int, int], ...]


def runs(flags: Flags, begin: int = 0) -> Segments:
    """Give the ranges of flagged samples, the first of all being number ``begin``."""
    ends = begin + np.flatnonzero(np.diff(flags, prepend=False, append=False))
    return tuple(zip(ends[::2].tolist(), ends[1::2].tolist(), strict=True))


def near(flags: Flags, reach: int) -> Flags:
    """Flag what lies no more than ``reach`` samples from a flagged one."""
    n = len(flags)
    before = np.concatenate([[0], np.cumsum(flags)])
    index = np.arange(n)
    inside = before[np.minimum(index + reach + 1, n)] - before[np.maximum(index - reach, 0)]
    return np.asarray(inside > 0)


def without_excluded(segments: Segments, excluded: Flags) -> Segments:
    """Split segments at excluded samples."""
    return tuple(part for a, b in segments for part in runs(~excluded[a:b], a))
