"""Whether the load goes with the angle, so that a loss by either looks like one by the other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.torque import load_at_outputs
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.observation import Observation

Array = NDArray[np.float64]

# Degree of the polynomial that stands for a smooth function of the angle.
_DEGREE = 6


def load_by_angle(chain: Joint, observations: Sequence[Observation], values: Array) -> float | None:
    """Give the share of the load's variance that is a smooth function of the angle, all together.

    The load is that of parameters ``(n_parameters,)``; ``None`` of a joint without load losses,
    and where there is next to no load.
    """
    if all(element.load_loss == "none" for element in chain.elements):
        return None
    load = np.concatenate([load_at_outputs(chain, o, values) for o in observations])
    angle = np.concatenate([o.q[o.filter.centres] for o in observations])
    about = load - load.mean()
    if load.size <= 4 * _DEGREE or not np.ptp(angle) > 0.0 or not about @ about > 0.0:
        return None
    left = load - np.polynomial.Chebyshev.fit(angle, load, _DEGREE)(angle)
    return float(1.0 - (left @ left) / (about @ about))
