"""Numbers that the data give only together with somebody's prior on another one.

Where a factor common to several numbers changes no torque, the data leave each of them open. A
prior on one, such as a weight that was put on scales, settles the factor, and with it all others.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from bayesfric.identifiability.local import LocalInformation, joined
from bayesfric.inference.prior.priors import Prior
from bayesfric.recordings.arrays import Array

# What is to be told by other priors is at most half as wide as its own, as in
# bayesfric.identifiability.local.verdict, and without its own not much wider than it came out.
_LEFT, _WIDER = 0.5, 1.5
# Without the priors that settle it, a number is at least so many times as wide.
_BETTER = 2.0


def given_by(
    local: LocalInformation,
    priors: Sequence[Prior],
    gradient: Array,
    sd: float,
    prior_sd: float,
    own: int | None = None,
) -> list[str]:
    """Name the told priors that settle a number which the data alone leave open, if some do.

    Parameters
    ----------
    local
        What the data tell near the posterior's median.
    priors
        Those of the free parameters first, in the order of ``local.names``.
    gradient
        ``(d,)`` of the number, by the parameters.
    sd, prior_sd
        What came out for it, and what its prior, or that of what it is made of, says.
    own
        Its place where it is a parameter: its own prior is not what gives it.
    """
    if (np.isfinite(prior_sd) and sd >= _LEFT * prior_sd) or not np.isfinite(gradient).all():
        return []
    few = priors[: len(local.names)]
    with np.errstate(divide="ignore"):
        weights = np.abs(local.units) / np.array([prior.sd() for prior in few])
    weights = np.nan_to_num(weights, nan=0.0, posinf=0.0)
    if own is not None:
        weights[own] = 0.0
    default = np.array([prior.default for prior in few])
    told = [int(i) for i in np.flatnonzero(~default & (weights > 0.0))]

    def left(some: Collection[int]) -> float:
        kept = default | np.isin(np.arange(weights.size), list(some))
        rows = np.diag(np.where(kept, weights, 0.0))
        return joined(local.directions.told, rows).sd(gradient * local.units)

    every = left(told)
    # bounds, or a prior of its own, make what comes out narrower still
    if not every < _WIDER * sd or left(()) < _BETTER * every:
        return []
    best = min(told, key=lambda i: left((i,)))
    if left((best,)) < _WIDER * every:
        return [local.names[best]]
    needed = [i for i in told if left([j for j in told if j != i]) > _WIDER * every]
    return [local.names[i] for i in needed or told]
