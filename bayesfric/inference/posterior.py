"""Draws of the posterior and their convergence diagnostics.

Walkers of one ensemble are not independent chains; ensembles are, and are compared.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.inference.priors import Prior
from bayesfric.recordings.arrays import Array

# Independent draws from which ends of a 90 % interval are right to a tenth of a standard deviation.
_SOUND_ESS = 400.0

Status = Literal["reliable", "tentative", "unusable"]


@dataclass(frozen=True)
class Diagnostics:
    """Convergence diagnostics; arrays are ``(d,)`` over the sampled parameters."""

    # reliable: all criteria met; tentative: not all, but the ensembles roughly agree
    status: Status
    # a sentence with a hint for each criterion that is not met
    problems: tuple[str, ...]
    # nested R-hat
    rhat: Array
    tau: Array  # integrated autocorrelation time, steps
    ess: Array  # effective sample size
    acceptance: Array  # (ensembles, walkers) acceptance fraction
    ensembles: int
    walkers: int
    # steps of warm-up, steps after it, and thinning
    warmup: int
    steps: int
    thin: int
    # non-finite likelihood evaluations with warm-up, and their share of the proposals after it
    not_finite: int
    seconds: float  # wall-clock time
    not_finite_share: float = 0.0
    # doubts of a converged sample, such as walkers that never moved
    warnings: tuple[str, ...] = ()
    max_rhat: float = 1.01  # criterion of the settings

    def sound(self, rhat: Array, ess: Array) -> NDArray[np.bool_]:
        """Flag numbers that may be reported even if others did not converge."""
        if self.status == "reliable":
            return np.ones(rhat.shape, dtype=np.bool_)
        return np.asarray((rhat <= self.max_rhat) & (ess >= _SOUND_ESS))


@dataclass(frozen=True)
class Posterior:
    """Draws of the sampled parameters, noise scales last."""

    # of the d sampled parameters: the mechanism's free ones, then the noise scales
    names: tuple[str, ...]
    priors: tuple[Prior, ...]
    draws: Array  # (ensembles, walkers, steps, d) in SI units, thinned
    # (ensembles, walkers, steps) log posterior density in the sampler's coordinates
    log_density: Array
    diagnostics: Diagnostics  # before thinning
    seed: int  # later steps derive their streams from it

    def flat(self, most: int | None = None) -> Array:
        """Return at most ``most`` draws ``(n, d)``, without walkers that never moved."""
        moved = self.diagnostics.acceptance > 0.0
        draws = self.draws if moved.all() or not moved.any() else self.draws[moved]
        flat = draws.reshape(-1, self.draws.shape[-1])
        if most is None or most >= len(flat):
            return flat
        return np.asarray(flat[np.linspace(0, len(flat) - 1, most).astype(int)])

    def prior_draws(self, number: int, key: int) -> Array:
        """Draw from the priors, ``(number, d)``, with a random stream ``key``."""
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(key,)))
        return np.stack([prior.draw(number, rng) for prior in self.priors], axis=1)

    @cached_property
    def median(self) -> Array:
        """Median of every parameter, ``(d,)``, SI units."""
        return np.asarray(np.median(self.flat(), axis=0))

    def __getitem__(self, name: str) -> Array:
        """Draws of one parameter, ``(ensembles, walkers, steps)``."""
        return self.draws[..., self.names.index(name)]
