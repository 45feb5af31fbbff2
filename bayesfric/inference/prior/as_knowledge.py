"""Priors as point estimates can use them: known values, bounds, data-sheet values."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayesfric.estimates.knowledge import Knowledge
from bayesfric.inference.prior.priors import Prior
from bayesfric.mechanism.joint import Joint

# Distributions that state no value, only a range.
_RANGES = frozenset({"uniform", "loguniform", "halfnorm"})


def as_knowledge(chain: Joint, priors: Mapping[str, Prior]) -> Knowledge:
    """Take from the priors of a mechanism what a point estimate may use.

    A fixed prior is a known value; the support of a prior is a bound. A prior that
    a user gave and that states a value, such as a normal one from a data sheet,
    enters with its mean and standard deviation. Default priors only bound.
    """
    fixed, bounds, told = {}, {}, {}
    for name in chain.names:
        prior = priors[name]
        if prior.fixed:
            fixed[name] = prior.value
            continue
        bounds[name] = prior.limits
        if prior.default or prior.distribution.dist.name in _RANGES:
            continue
        mean, sd = prior.mean(), prior.sd()
        if np.isfinite(mean) and np.isfinite(sd) and sd > 0.0:
            told[name] = (mean, sd)
    return Knowledge(fixed, bounds, told)
