"""Units in which changes of all parameters are comparable, mostly relative ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.assemble import alpha_sign
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array, Flags


@dataclass(frozen=True, eq=False)
class LocalUnits:
    """Unit change of each parameter, in logarithms where possible."""

    names: tuple[str, ...]  # free parameters
    # the parameter, or the alpha of a load-dependent friction
    labels: tuple[str, ...]
    # (d,) 1 and -1 for coefficients with alpha_1 and alpha_2, else 0
    ways: NDArray[np.int_]
    # (d,) unit change, SI units: the value itself (logarithms), or the prior's standard deviation
    # if it is nearly zero
    units: Array
    shifted: Flags  # (d,) whether it is the prior's standard deviation

    def moved(self, values: Array, step: Array) -> Array:
        """Move parameters ``(d,)`` by a step ``(d,)`` in these units."""
        factor = np.exp(np.clip(step, -50.0, 50.0))
        out = np.where(self.shifted, values + step * self.units, values * factor)
        ways = self.ways
        return np.where(ways, ways * ((1.0 + ways * values) / factor - 1.0), out)


def units_of(target: Target, parameters: Array) -> LocalUnits:
    """Return the units at sampled parameters ``(d,)``.

    For load-dependent friction the logarithm of ``alpha_1 = 1/(1 + mu_1)`` or ``alpha_2 = 1/(1 -
    mu_2)``, in which the paper's scaling (section 4.2) is a straight line.
    """
    chain, values = target.likelihood.chain, parameters[: len(target.free)]
    free = [chain.parameters[chain.names.index(name)] for name in target.free]
    ways = np.array([alpha_sign(p) for p in free], dtype=np.int_)
    labels = tuple(
        f"{p.owner}.{p.quantity.replace('load', 'alpha')}" if way else p.name
        for p, way in zip(free, ways, strict=True)
    )
    # alpha_2 is infinite if the gearbox is irreversible
    alpha = -ways * (1.0 + ways * values)
    alpha = np.where((ways < 0) & (np.abs(alpha) <= 1e-3), 1e-3, alpha)
    sds = np.array([p.sd() for p in target.priors[: len(free)]])
    sds = np.where(np.isfinite(sds), sds, 1.0)
    # shares of the prior standard deviation below which a value counts as zero
    least = np.array([1e-3 if p.lower == 0.0 else 1e-2 for p in free]) * sds
    shifted = (ways == 0) & (np.abs(values) <= least)
    units = np.where(shifted, sds, np.where(ways, alpha, values))
    return LocalUnits(target.free, labels, ways, units, shifted)
