"""What robust fits share: where the Huber loss bends, and a scale blind to outliers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Residuals beyond this many standard deviations count less; 95 % efficient without outliers
# (Huber, Robust Statistics, 1981).
HUBER = 1.345


def robust_sd(residual: NDArray[np.float64]) -> float:
    """Take a normal's standard deviation from the median absolute value of residuals ``(n,)``."""
    return float(1.482602218505602 * np.median(np.abs(residual)))


def shares(residual: NDArray[np.float64], knee: float) -> NDArray[np.float64]:
    """Weigh squared residuals such that they have the slope of Huber's loss, one below ``knee``."""
    if not np.isfinite(knee):
        return np.ones(residual.shape)
    return np.asarray(knee / np.maximum(np.abs(residual), knee))


def losses(residual: NDArray[np.float64], knee: float) -> NDArray[np.float64]:
    """Huber's loss: squares below ``knee``, and ``2 knee |r| - knee²`` beyond."""
    share = shares(residual, knee)
    return np.asarray(residual**2 * share * (2.0 - share))
