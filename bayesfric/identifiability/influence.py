"""How much prior and likelihood each move the posterior: power scaling.

Kallioinen, Paananen, Bürkner and Vehtari, "Detecting and diagnosing prior and likelihood
sensitivity with power-scaling", Statistics and Computing 34:57 (2024). The prior (all
parameters' together), or the likelihood, is raised to a power ``alpha`` near one; the
draws at hand, weighted by ``p^(alpha - 1)``, then stand for the posterior this would give.

ArviZ has the same, under one name before 1.0 and another after; this serves both, and
gives no number, but no warning either, where draws do not move.

Bounds stay where they are whatever the power: what keeps a parameter between them is no
prior in this sense. Whether the data determined a parameter is the verdict's to say.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.inference.fitting import Fit

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

    Change of its marginal posterior for each doubling of the power of the prior, or of the
    likelihood, as a normalised cumulative Jensen-Shannon distance; ``nan`` where draws stand still.
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
    """Measure what prior and likelihood do to every sampled parameter, by its name.

    At most 2000 of the fit's draws, evenly spread, are looked at.
    """
    draws = fit.posterior.flat(_DRAWS)
    components = np.stack([fit.target.log_prior(draws), fit.target.log_likelihood(draws)])
    # a draw that rounding put on a bound may have no density; it weighs nothing
    sound = np.isfinite(components).all(axis=0)
    found = np.full((2, draws.shape[1]), np.nan)
    if sound.sum() >= _FEWEST:
        found = np.stack([sensitivity(draws[sound], one[sound]) for one in components])
    names = fit.posterior.names
    return {name: Influence(*pair) for name, pair in zip(names, found.T.tolist(), strict=True)}


def sensitivity(draws: Array, log_component: Array) -> Array:
    """Differentiate the distance from the posterior by the binary logarithm of the power.

    Of draws ``(n, d)`` and the log density ``(n,)`` of what is raised to a power, up to a
    constant. Gives ``(d,)``, the mean of both directions; ``nan`` where draws are all equal.
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
