"""What the samples of a signal are kept in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
# Half-open ranges of samples.
Segments = tuple[tuple[int, int], ...]
