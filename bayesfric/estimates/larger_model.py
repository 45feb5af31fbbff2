"""Whether a larger model is the better one."""

from __future__ import annotations

import math

from bayesfric.estimates.point_estimate import Estimate
from bayesfric.mechanism.quantities import QUANTITIES

# Quantities that shape others, and those that cannot be negative.
_SHAPES = {name for name, row in QUANTITIES.items() if row.role == "form"}
_POSITIVE = {name for name, row in QUANTITIES.items() if row.lower == 0.0}


def better(larger: Estimate, smaller: Estimate) -> bool:
    """Whether what a larger model has beside a smaller one is worth it, known, and beside it.

    By the Bayesian information criterion. Of what shapes it, and of its size, 90 % intervals
    leave out zero; and no loss or inertia that was known comes to reach zero, as what is new
    has then taken its place.
    """
    here, before = ({v.name: v for v in one.parameters} for one in (larger, smaller))
    replaced = [
        name
        for name in here.keys() & before.keys()
        if before[name].quantity in _POSITIVE and before[name].known and not here[name].known
    ]
    new = [v for name, v in here.items() if name not in before]
    shapes = [v.known for v in new if v.quantity in _SHAPES]
    sizes = [v.known for v in new if v.quantity not in _SHAPES]
    more, n = len(larger.point) - len(smaller.point), larger.n_outputs
    gain = 2.0 * n * math.log(smaller.residual_rms / larger.residual_rms)
    known = all(shapes) and (any(sizes) or not sizes)
    return known and not replaced and gain > more * math.log(n)
