"""The torque as linear in what a mechanism's parameters can change near a place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bayesfric.estimates.descent import TorqueProblem
from bayesfric.estimates.knowledge import Knowledge
from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.measurement import Array
from bayesfric.recordings.observation import Observation


def bends(chain: Joint) -> bool:
    """Whether load losses or a Stribeck rise bend the totals of least squares."""
    return any(p.row.role == "loss" or p.row.option == "stribeck" for p in chain.parameters)


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
