"""What sampling leaves: draws of the posterior, and whether they can be trusted.

The sampler runs several ensembles of walkers. Walkers of one ensemble propose from each other
and are not independent chains; ensembles are, and convergence is judged by comparing them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.inference.prior.priors import Prior
from bayesfric.recordings.arrays import Array

# Independent draws that the ends of a 90 % interval take: they are then right to a tenth of a sd.
_SOUND_ESS = 400.0

Status = Literal["reliable", "tentative", "unusable"]


@dataclass(frozen=True)
class Diagnostics:
    """Whether the sampling can be trusted; arrays are of every sampled parameter, ``(d,)``."""

    # reliable where every criterion is met, tentative where sampling ended before, but the
    # ensembles roughly agree, unusable otherwise
    status: Status
    # One sentence for each criterion that is not met, with a hint; empty when reliable
    problems: tuple[str, ...]
    # (d,) nested R-hat: between-ensemble against within-ensemble variance, 1 where they agree
    rhat: Array
    tau: Array  # (d,) integrated autocorrelation time in steps
    ess: Array  # (d,) effective sample size, walkers times steps over tau
    acceptance: Array  # (ensembles, walkers) accepted share of each walker's proposals
    ensembles: int
    walkers: int
    # Steps of warm-up, steps after it, and how many of these one kept draw stands for
    warmup: int
    steps: int
    thin: int
    # How often the likelihood was no number, warm-up included; and the share of the proposals after
    # warm-up
    not_finite: int
    seconds: float  # Wall-clock time
    not_finite_share: float = 0.0
    # Sentences on a sample that may have converged all the same, such as walkers that never moved
    warnings: tuple[str, ...] = ()
    max_rhat: float = 1.01  # Largest rhat that the settings accepted

    def sound(self, rhat: Array, ess: Array) -> NDArray[np.bool_]:
        """Tell which numbers may be reported, whatever the diagnostics of others are."""
        if self.status == "reliable":
            return np.ones(rhat.shape, dtype=np.bool_)
        return np.asarray((rhat <= self.max_rhat) & (ess >= _SOUND_ESS))


@dataclass(frozen=True)
class Posterior:
    """Draws of the sampled parameters, noise scales last."""

    # Of the d sampled parameters: the free ones of the mechanism, then those of the noise
    names: tuple[str, ...]
    priors: tuple[Prior, ...]
    draws: Array  # (ensembles, walkers, steps, d) in SI units, thinned
    # (ensembles, walkers, steps) log posterior density in the sampler's coordinates, that is with
    # the Jacobian; up to a constant
    log_density: Array
    diagnostics: Diagnostics  # Of the whole sample, before thinning
    seed: int  # That everything random came from; later steps derive their own streams from it

    def flat(self, most: int | None = None) -> Array:
        """Lay all draws side by side, for quantiles, never for convergence checks.

        Walkers that never moved are left out, unless none did: what they repeat is where they were
        put.

        Shapes: returns (n, d).
        """
        moved = self.diagnostics.acceptance > 0.0
        draws = self.draws if moved.all() or not moved.any() else self.draws[moved]
        flat = draws.reshape(-1, self.draws.shape[-1])
        if most is None or most >= len(flat):
            return flat
        return np.asarray(flat[np.linspace(0, len(flat) - 1, most).astype(int)])

    def prior_draws(self, number: int, key: int) -> Array:
        """Draw from the priors, ``(number, d)``; ``key`` is that of the random numbers."""
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(key,)))
        return np.stack([prior.draw(number, rng) for prior in self.priors], axis=1)

    @cached_property
    def median(self) -> Array:
        """Median of every parameter by itself, ``(d,)``, SI units."""
        return np.asarray(np.median(self.flat(), axis=0))

    def __getitem__(self, name: str) -> Array:
        """Draws of one parameter, ``(ensembles, walkers, steps)``."""
        return self.draws[..., self.names.index(name)]
