"""How much wider what data tell becomes where their residuals go together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.information import CORRELATED, Information, lag_one
from bayesfric.estimates.torque import places
from bayesfric.identifiability.local import LocalInformation, jacobian_of
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.target import Target

Array = NDArray[np.float64]


class Correlated:
    """Sds for residuals that are correlated over those for independent ones, as estimates have.

    Of what the noise model leaves: where that has a memory, its innovations. One for a simulated
    position, whose likelihood has the correlation of the torque's noise, and with samples at rest.
    """

    def __init__(self, target: Target, parameters: Array, local: LocalInformation) -> None:
        self._information: Information | None = None
        likelihood, k = target.likelihood, len(target.free)
        if not isinstance(likelihood, TorqueLikelihood):
            return
        scales = target.noise.scales(parameters[None, k:])[0]
        predicted = likelihood.predict(target.chain_values(parameters[None]))
        left = [o.measured - p[0] for o, p in zip(likelihood.outputs, predicted, strict=True)]
        residual = np.concatenate(likelihood.innovations(left, scales))
        where = places(likelihood.observations)
        # of residuals that do not go together a robust sd is a noisier one, no more
        if not lag_one(residual, np.diff(where) == 1) > CORRELATED:
            return
        jacobian = jacobian_of(target, parameters, local.units) / local.units
        if len(jacobian) != residual.size:
            return
        found = local.directions
        theory = None if found.known_null is None else (found.known_null.T * local.units)
        self._information = Information(
            jacobian,
            residual,
            np.abs(local.units),
            places=where,
            tolerance=found.tolerance,
            known_null=theory,
        )

    @property
    def found(self) -> bool:
        """Whether there is any correlation left."""
        return self._information is not None

    def times(self, gradient: Array) -> float:
        """By how much the sd of a function with a gradient ``(d,)`` is larger, at least one."""
        if self._information is None:
            return 1.0
        plain, robust = self._information.sds(gradient)
        told = np.isfinite(plain) and np.isfinite(robust) and plain > 0.0
        return max(robust / plain, 1.0) if told else 1.0


def widened(expected_sd: float, data_sd: float, times: float) -> float:
    """Widen the sd from data and prior where that from the data is so many ``times`` larger.

    What the prior adds to the precision stays.
    """
    if not (np.isfinite(data_sd) and np.isfinite(expected_sd)) or expected_sd <= 0.0:
        return expected_sd
    added = max(expected_sd**-2 - data_sd**-2, 0.0)
    return float((added + (times * data_sd) ** -2) ** -0.5)
