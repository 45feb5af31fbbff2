"""The torque as linear in what a mechanism's parameters can change near a place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.descent import TorqueProblem
from bayesfric.estimates.information import Information
from bayesfric.estimates.knowledge import Knowledge
from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.estimates.torque_form import OPEN, shortest
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.measurement import Array
from bayesfric.recordings.observation import Observation


def bends(chain: Joint) -> bool:
    """Whether load losses, or what shapes other terms, bend the totals of least squares."""
    return any(p.row.bends for p in chain.parameters)


def torque_near(
    chain: Joint, observations: Sequence[Observation], point: Mapping[str, float] | None
) -> tuple[Array, Array]:
    """Write the torque as regressors ``(n, k)`` and a model ``(n,)`` that they change.

    Near a point they are of the chain's parameters, in its order; without one of the totals of
    least squares, which :func:`bends` says hold only roughly.
    """
    if point is None:
        regressors = TotalsProjection(chain, observations).regressors
        return regressors, np.zeros(sum(o.measured.size for o in observations))
    problem = TorqueProblem(chain, observations, Knowledge())
    x = np.array([point[name] for name in chain.names])
    return problem.jacobian(x), problem.measured - problem.residual(x)


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
