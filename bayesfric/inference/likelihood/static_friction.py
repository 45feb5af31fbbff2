"""Likelihood of standstill: the torque lies between the two at which the joint would move.

At standstill friction balances any torque within its limits, those of the inverse model with either
sign of a vanishing speed. A measured torque ``y`` of noise ``e`` contributes the probability that
``y - e`` is between them, and no density: only torques near or beyond a limit are informative.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bayesfric.mechanism import kernels
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.checks import Rest
from bayesfric.recordings.measurement import Inputs

# Speed, rad/s or m/s, far below all other speeds of the model.
_VANISHING = 1e-9
# Smallest log probability.
_LOG_MINIMUM = -700.0


class StaticFriction:
    """Log probability that a joint stays at standstill in one recording."""

    def __init__(self, chain: Joint, rest: Rest, inputs: Inputs) -> None:
        self._chain, self._inputs, self._torque = chain, inputs, rest.torque
        zero = np.zeros_like(rest.q)
        self._directions = [
            chain.samples(rest.q, zero + direction * _VANISHING, zero, inputs, rest.stamps)
            for direction in (1.0, -1.0)
        ]

    def limits(self, values: Array) -> tuple[Array, Array]:
        """Return the torques ``(n, M)`` at which the joint would move backwards and forwards."""
        tables = self._chain.tables(values, self._inputs)
        forwards, backwards = (kernels.inverse_many(*tables, way) for way in self._directions)
        return np.minimum(forwards, backwards), np.maximum(forwards, backwards)

    def log_terms(self, values: Array, noise: Any) -> Array:
        """Return the log probability ``(n, M)`` of standstill; ``noise`` is of shape ``(n, 1)``."""
        low, high = self.limits(values)
        a, b = low - self._torque, high - self._torque
        # the tail without cancellation
        upper = a + b > 0.0
        nearer = np.where(upper, -a, b)
        farther = np.where(upper, -b, a)
        with np.errstate(all="ignore"):
            inner, outer = noise.logcdf(nearer), noise.logcdf(farther)
            log_probability = inner + np.log1p(-np.exp(np.minimum(outer - inner, 0.0)))
        # equal limits leave no probability
        return np.asarray(
            np.maximum(
                np.where(np.isnan(log_probability), _LOG_MINIMUM, log_probability), _LOG_MINIMUM
            )
        )
