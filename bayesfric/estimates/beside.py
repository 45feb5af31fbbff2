"""What is fitted beside all that a mechanism can do, and with what sd."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.information import Information
from bayesfric.estimates.torque_form import OPEN, shortest
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.measurement import Array


def bends(chain: Joint) -> bool:
    """Whether load losses, or what shapes other terms, bend the totals of least squares."""
    return any(p.row.bends for p in chain.parameters)


class Beside(NamedTuple):
    """One coefficient that was fitted beside all that the mechanism can do."""

    value: float
    sd: float  # the larger of the plain and the robust one
    residual: Array  # (n,)


def fitted_beside(
    regressors: Array, columns: Array, target: Array, where: NDArray[np.int64]
) -> Beside | None:
    """Fit the last of ``columns`` ``(n, k)`` beside regressors by least squares.

    ``where`` ``(n,)`` is what :func:`bayesfric.estimates.torque.places` gives of the outputs.
    ``None`` where these are too few.
    """
    matrix = np.column_stack([regressors, columns])
    if len(target) <= matrix.shape[1]:
        return None
    size, _, solution, _ = shortest(matrix)
    found = solution @ target
    left = target - matrix @ found
    information = Information(matrix, left, 1.0 / size, places=where, tolerance=OPEN)
    sd = larger(*information.sds(np.eye(len(found))[-1]))
    return Beside(float(found[-1]), sd, left)


def larger(sd: float, robust: float) -> float:
    """Take the larger standard deviation of those that are known."""
    return float(np.nanmax([sd, robust, 0.0]))
