"""What the samples of a signal are kept in."""

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
