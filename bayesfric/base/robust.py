"""A scale that is blind to outliers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def robust_sd(residual: NDArray[np.float64]) -> float:
    """Take a normal's standard deviation from the median absolute value of residuals ``(n,)``."""
    return float(1.482602218505602 * np.median(np.abs(residual)))
