"""What samples at standstill say: torque lies between the two at which the joint would move.

At standstill friction takes whatever is applied, up to its limits: the inverse model with either
sign of a vanishing speed. The torque is the cause there and standstill the outcome, so a measured
torque ``y`` of noise ``e`` contributes the probability that ``y - e`` is between the limits, and no
density. Under it a joint with more static friction rests no less probably: only torques near or
beyond a limit tell anything.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bayesfric.mechanism import kernels
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.inputs import Inputs
from bayesfric.recordings.moving import Rest

# A speed beside which every other speed of the model is large, rad/s or m/s.
_VANISHING = 1e-9
# Log probability below which nothing is told apart.
_LEAST = -700.0


class StaticFriction:
    """Log probability that a joint stays where it stood still in one recording."""

    def __init__(self, chain: Joint, rest: Rest, inputs: Inputs) -> None:
        self._chain, self._inputs, self._torque = chain, inputs, rest.torque
        still = np.zeros_like(rest.q)
        self._ways = [
            chain.samples(rest.q, still + way * _VANISHING, still, inputs, rest.stamps)
            for way in (1.0, -1.0)
        ]

    def limits(self, values: Array) -> tuple[Array, Array]:
        """Torques at which the joint would move backwards and forwards.

        Shapes: ``values`` (n, n_parameters), returns (n, M).
        """
        tables = self._chain.tables(values, self._inputs)
        forwards, backwards = (kernels.inverse_many(*tables, way) for way in self._ways)
        return np.minimum(forwards, backwards), np.maximum(forwards, backwards)

    def log_terms(self, values: Array, noise: Any) -> Array:
        """Log probability of each standstill output.

        Shapes: ``values`` (n, n_parameters), ``noise`` (n, 1), returns (n, M).
        """
        low, high = self.limits(values)
        a, b = low - self._torque, high - self._torque
        # of the two tails the one in which nothing cancels
        upper = a + b > 0.0
        near = np.where(upper, -a, b)
        far = np.where(upper, -b, a)
        with np.errstate(all="ignore"):
            inner, outer = noise.logcdf(near), noise.logcdf(far)
            found = inner + np.log1p(-np.exp(np.minimum(outer - inner, 0.0)))
        # where both limits are one, nothing rests
        return np.asarray(np.maximum(np.where(np.isnan(found), _LEAST, found), _LEAST))
