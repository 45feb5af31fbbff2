"""What sampling leaves: draws, and whether they can be trusted."""

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

    # reliable: every criterion met; tentative: stopped early, but the ensembles agree roughly
    status: Status
    problems: tuple[str, ...]  # one plain sentence each, with the mend; empty when reliable
    rhat: Array  # nested R-hat
    tau: Array  # autocorrelation time in steps
    ess: Array  # effective sample size
    acceptance: Array  # accepted share of proposals, (ensembles, walkers)
    ensembles: int
    walkers: int
    warmup: int
    steps: int  # after warm-up, before thinning
    thin: int  # which steps are kept in the draws
    not_finite: int  # likelihoods that came out as no number, those of warm-up included
    seconds: float  # wall-clock time of sampling
    not_finite_share: float = 0.0  # of the proposals after warm-up
    warnings: tuple[str, ...] = ()  # on a sample that has converged, with the mend
    max_rhat: float = 1.01  # largest nested R-hat that was accepted

    def sound(self, rhat: Array, ess: Array) -> NDArray[np.bool_]:
        """Whether numbers with these diagnostics may be told, whatever the others do."""
        if self.status == "reliable":
            return np.ones(rhat.shape, dtype=np.bool_)
        return np.asarray((rhat <= self.max_rhat) & (ess >= _SOUND_ESS))


@dataclass(frozen=True)
class Posterior:
    """Draws of the sampled parameters, noise scales last."""

    names: tuple[str, ...]
    priors: tuple[Prior, ...]
    draws: Array  # (ensembles, walkers, steps, d), in physical units, thinned
    log_density: Array  # in sampling coordinates, (ensembles, walkers, steps)
    diagnostics: Diagnostics  # of the whole sample, before thinning
    seed: int

    def flat(self, most: int | None = None) -> Array:
        """All draws, ``(n, d)``; for quantiles, never for convergence checks.

        With ``most``, at most so many of them, evenly spread. Walkers that never moved are
        left out, unless none did: what they repeat is where they were put.
        """
        moved = self.diagnostics.acceptance > 0.0
        draws = self.draws if moved.all() or not moved.any() else self.draws[moved]
        flat = draws.reshape(-1, self.draws.shape[-1])
        if most is None or most >= len(flat):
            return flat
        return np.asarray(flat[np.linspace(0, len(flat) - 1, most).astype(int)])

    @cached_property
    def median(self) -> Array:
        """Of every parameter by itself, ``(d,)``."""
        return np.asarray(np.median(self.flat(), axis=0))

    def __getitem__(self, name: str) -> Array:
        """Draws of one parameter, ``(ensembles, walkers, steps)``."""
        return self.draws[..., self.names.index(name)]
