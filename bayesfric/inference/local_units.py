"""Units in which a change of every parameter counts alike.

An inertia of 1e-4 kg m² and a viscous coefficient of 10 N m s cannot be compared as they are. In
these units a step of 0.01 is one per cent of either, and directions of the parameter space that
the torque does not determine read as ratios.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.assemble import alpha_way
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array, Flags

# Values below this share of their prior sd are next to zero: those that are zero or
# positive, and those of either sign.
_SMALL = 1e-3
_SMALL_SIGNED = 1e-2


@dataclass(frozen=True, eq=False)
class LocalUnits:
    """What counts as a change of one, in logarithms wherever there is one."""

    names: tuple[str, ...]  # Free parameters of the mechanism
    # What is changed by one: the parameter, or the alpha of a load-dependent friction
    labels: tuple[str, ...]
    # (d,) 1 and -1 for coefficients with alpha_1 and alpha_2, 0 for all others
    ways: NDArray[np.int_]
    # (d,) change of each parameter, SI units, that counts as one: its own value, so that ones are
    # changes of logarithms; the prior's sd where the value is next to zero
    units: Array
    shifted: Flags  # (d,) where it is the prior's sd

    def moved(self, values: Array, step: Array) -> Array:
        """Move parameters by a step in these units, along logarithms.

        Shapes: ``values`` (d,), ``step`` (d,), returns (d,).
        """
        grown = np.exp(np.clip(step, -50.0, 50.0))
        out = np.where(self.shifted, values + step * self.units, values * grown)
        ways = self.ways
        return np.where(ways, ways * ((1.0 + ways * values) / grown - 1.0), out)


def units_of(target: Target, parameters: Array) -> LocalUnits:
    """Say what counts as one at sampled parameters.

    Logarithms of all but load-dependent friction; of that the logarithm of alpha,
    ``alpha_1 = 1/(1 + mu_1)`` or ``alpha_2 = 1/(1 - mu_2)``, in which the paper's scaling (section
    4.2) is one straight line. A value next to zero, as on a bound, has no logarithm worth the
    name: there the prior's sd counts as one.

    Shapes: ``parameters`` (d,).
    """
    chain, values = target.likelihood.chain, parameters[: len(target.free)]
    free = [chain.parameters[chain.names.index(name)] for name in target.free]
    ways = np.array([alpha_way(p) for p in free], dtype=np.int_)
    labels = tuple(
        f"{p.owner}.{p.quantity.replace('load', 'alpha')}" if way else p.name
        for p, way in zip(free, ways, strict=True)
    )
    # alpha_1 = 1/(1 + mu_1) and alpha_2 = 1/(1 - mu_2), endless where the gearbox is irreversible
    alpha = -ways * (1.0 + ways * values)
    alpha = np.where((ways < 0) & (np.abs(alpha) <= 1e-3), 1e-3, alpha)
    sds = np.array([p.sd() for p in target.priors[: len(free)]])
    sds = np.where(np.isfinite(sds), sds, 1.0)
    least = np.array([_SMALL if p.lower == 0.0 else _SMALL_SIGNED for p in free]) * sds
    shifted = (ways == 0) & (np.abs(values) <= least)
    units = np.where(shifted, sds, np.where(ways, alpha, values))
    return LocalUnits(target.free, labels, ways, units, shifted)
