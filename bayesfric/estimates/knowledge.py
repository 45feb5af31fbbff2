"""What is known of the parameters before anything is fitted: values, bounds, data sheets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.parameter import turned
from bayesfric.recordings.arrays import Array


@dataclass(frozen=True)
class Knowledge:
    """Known values, bounds and data-sheet values of a chain's parameters, by name, in SI units."""

    # Values taken as known; these parameters are not estimated
    fixed: Mapping[str, float] = field(default_factory=dict)
    # Lower and upper limit of others; the support where left out
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    # Mean and standard deviation of others, as a data sheet or a prior gives them: one more
    # residual each
    told: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def free(self, chain: Joint) -> tuple[str, ...]:
        """Names of the parameters to estimate, in the chain's order."""
        return tuple(name for name in chain.names if name not in self.fixed)

    def limits(self, chain: Joint) -> tuple[Array, Array]:
        """Lower and upper limits of the free parameters. Shapes: returns lower, upper (d,)."""
        support = {p.name: (p.lower, p.upper) for p in chain.parameters}
        pairs = [self.bounds.get(name, support[name]) for name in self.free(chain)]
        return np.array([low for low, _ in pairs]), np.array([high for _, high in pairs])

    def on_turn(self, chain: Joint, values: Array) -> Array:
        """Bring the angles of free parameters to the turn their limits lie on.

        Shapes: values (d,); returns (d,).
        """
        described = {p.name: p for p in chain.parameters}
        out = values.copy()
        for j, (name, low, high) in enumerate(
            zip(self.free(chain), *self.limits(chain), strict=True)
        ):
            if described[name].circular:
                middle = (low + high) / 2.0 if np.isfinite(high - low) else 0.0
                out[j] = turned(float(values[j]), middle)
        return out

    def inside(self, chain: Joint, values: Array) -> Array:
        """Put free parameters ``(d,)`` within their limits, angles on the turn of these first."""
        return np.clip(self.on_turn(chain, values), *self.limits(chain))

    def rows(self, chain: Joint) -> tuple[Array, Array]:
        """Write values with a standard deviation as residuals ``(mean - value)/sd``.

        Shapes: returns rows (k, d), targets (k,).
        """
        free = self.free(chain)
        told = [name for name in free if name in self.told]
        means, sds = np.array([self.told[name] for name in told]).reshape(-1, 2).T
        rows = np.eye(len(free))[[free.index(name) for name in told]]
        return rows / sds[:, None], means / sds
