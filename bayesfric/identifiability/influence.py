"""How much prior and likelihood each move the posterior: power scaling.

Kallioinen, Paananen, Bürkner and Vehtari, "Detecting and diagnosing prior and likelihood
sensitivity with power-scaling", Statistics and Computing 34:57 (2024). The prior (all
parameters' together), or the likelihood, is raised to a power ``alpha`` near one; the
draws at hand, weighted by ``p^(alpha - 1)``, then stand for the posterior this would give.

Bounds stay where they are whatever the power: what keeps a parameter between them is no
prior in this sense. Whether the data determined a parameter is the verdict's to say.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.inference.fit import Fit

Array = NDArray[np.float64]
Diagnosis = Literal["prior-data conflict", "strong prior", "weak likelihood", "-"]

# From here on the paper calls a posterior sensitive: as if the mean of a normal moved by
# 0.3 of its sd when alpha is doubled.
THRESHOLD = 0.05
# alpha is 1.01 and 1/1.01; weights so close to even need no smoothing of their tail.
_DELTA = 0.01
_DRAWS = 2000
# Fewer draws cannot tell 0.05 from nothing.
_FEWEST = 100


@dataclass(frozen=True)
class Influence:
    """Power-scaling sensitivity of one parameter.

    Attributes
    ----------
    prior, likelihood
        Change of its marginal posterior for each doubling of the power of the prior, or
        of the likelihood, as a normalised cumulative Jensen-Shannon distance; ``nan``
        where the draws do not move.
    """

    prior: float
    likelihood: float

    @property
    def diagnosis(self) -> Diagnosis | None:
        """What the two say together, at the paper's threshold of 0.05.

        ``prior-data conflict``: both move the posterior. ``strong prior``: only the
        prior does. ``weak likelihood``: neither does, as along a direction that no
        torque sees, under a flat prior. ``-``: only the likelihood does, which is as it
        should be. ``None`` where there is no number.
        """
        if not np.isfinite([self.prior, self.likelihood]).all():
            return None
        if self.likelihood >= THRESHOLD:
            return "prior-data conflict" if self.prior >= THRESHOLD else "-"
        return "strong prior" if self.prior >= THRESHOLD else "weak likelihood"


def influence(fit: Fit) -> dict[str, Influence]:
    """Measure what prior and likelihood do to every sampled parameter.

    Parameters
    ----------
    fit
        A finished fit; at most 2000 of its draws, evenly spread, are looked at.

    Returns
    -------
    dict
        By name, in the order of ``fit.posterior.names``.
    """
    draws = fit.posterior.flat(_DRAWS)
    log_prior, log_likelihood = fit.target.log_prior(draws), fit.target.log_likelihood(draws)
    # a draw that rounding put on a bound may have no density; it weighs nothing
    sound = np.isfinite(log_prior) & np.isfinite(log_likelihood)
    if sound.sum() < _FEWEST:
        return dict.fromkeys(fit.posterior.names, Influence(np.nan, np.nan))
    by_prior = sensitivity(draws[sound], log_prior[sound])
    by_likelihood = sensitivity(draws[sound], log_likelihood[sound])
    return {
        name: Influence(float(p), float(q))
        for name, p, q in zip(fit.posterior.names, by_prior, by_likelihood, strict=True)
    }


def sensitivity(draws: Array, log_component: Array) -> Array:
    """Differentiate the distance from the posterior by the binary logarithm of the power.

    Parameters
    ----------
    draws
        ``(n, d)`` posterior draws.
    log_component
        ``(n,)`` log density of what is raised to a power, at each draw; constants do not
        matter.

    Returns
    -------
    ndarray
        ``(d,)``, mean of both directions; ``nan`` for a parameter whose draws are all equal.
    """
    from arviz_stats.base import array_stats  # takes a while, and few commands need it

    powers = (1.0 / (1.0 + _DELTA), 1.0 + _DELTA)
    logs = [(alpha - 1.0) * log_component for alpha in powers]
    weights = [np.exp(w - w.max()) / np.exp(w - w.max()).sum() for w in logs]
    with np.errstate(divide="ignore", invalid="ignore"):
        found = [
            array_stats.power_scale_sense(x[None], *(w[None] for w in weights), *powers)
            if np.ptp(x) > 0.0
            else np.nan
            for x in draws.T
        ]
    return np.array(found, dtype=np.float64)
