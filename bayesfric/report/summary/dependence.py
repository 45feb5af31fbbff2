"""Whether what a model leaves depends on a quantity, whatever the memory of the noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.fft import dct

Array = NDArray[np.float64]

# Degree of the curves looked for: a quadratic loss leaves an S of three.
_DEGREE = 3
# Slow cosines that tell how much chance does; more tell no more, fewer are needed at least.
_MOST, _SPARE = 24, 4
# Share of a curve that the model itself does not make, below which nothing is left of it.
_LEFT = 1e-3


def smooth_p_value(residual: Array, x: Array, columns: Array) -> float:
    """Test whether residuals follow a smooth curve of ``x`` that the model cannot make.

    Products of residual and curve have a mean where there is a dependence, else none. How far
    chance moves that mean is told by their slow cosines, each as uncertain as the mean itself
    (Lazarus, Lewis, Stock and Watson, J. Bus. Econ. Stat. 36, 2018): whatever their memory, as
    long as it is lost from swing to swing. No correlation has to be estimated, and a dependence,
    the same in every swing, does not pass for memory.

    ``residual`` ``(M,)`` is in order of time. What of a curve lies in ``columns`` ``(M, k)``,
    derivatives of the predictions, was fitted away. Gives 1 where there are too few swings to tell.
    """
    n = residual.size
    places = stats.rankdata(x) * 2.0 / (n + 1) - 1.0
    curves = np.polynomial.legendre.legvander(places, _DEGREE)[:, 1:]
    size = np.linalg.norm(columns, axis=0)
    # a scaling that nothing tells has two columns that are one
    base, strength, _ = np.linalg.svd(columns[:, size > 0.0] / size[size > 0.0], False)
    base = base[:, strength > 1e-9 * strength.max(initial=0.0)]
    residual = residual - base @ (base.T @ residual)
    length = np.linalg.norm(curves, axis=0)
    curves = (curves - base @ (base.T @ curves)) / length
    found, left, _ = np.linalg.svd(curves, full_matrices=False)
    products = found[:, left > _LEFT] * residual[:, None]
    q, cosines = products.shape[1], min(_MOST, _swings(x))
    if not q or cosines < q + _SPARE or not residual.any():
        return 1.0
    mean, *slow = dct(products, axis=0, norm="ortho")[: cosines + 1]
    scatter = np.stack(slow)
    # Hotelling's T², as a ratio of variances
    square = float(mean @ np.linalg.lstsq(scatter.T @ scatter / cosines, mean)[0])
    rest = cosines - q + 1
    return float(stats.f.sf(square * rest / (cosines * q), q, rest))


def _swings(x: Array) -> int:
    """Count how often ``x`` goes from its lowest quarter to its highest and back."""
    low, high = np.quantile(x, [0.25, 0.75])
    upper = x[(x <= low) | (x >= high)] >= high
    return int(np.count_nonzero(np.diff(upper)) // 2)
