"""What sampling leaves: draws, and whether they can be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.inference.prior.priors import Prior

# Independent draws that the ends of a 90 % interval take: they are then right to a tenth of a sd.
_SOUND_ESS = 400.0

Status = Literal["reliable", "tentative", "unusable"]


@dataclass(frozen=True)
class Diagnostics:
    """Whether the sampling can be trusted.

    Attributes
    ----------
    status
        ``reliable``: every criterion met. ``tentative``: stopped early, but the
        ensembles agree roughly. ``unusable``: they do not.
    problems
        One plain sentence each, with the mend; empty when reliable.
    rhat, tau, ess
        Nested R-hat, autocorrelation time in steps and effective sample size of
        each sampled parameter, ``(d,)``.
    acceptance
        Accepted share of proposals of each walker, ``(ensembles, walkers)``.
    ensembles, walkers, warmup, steps
        Shape of the sample before thinning; ``steps`` counts after warm-up.
    thin
        Every ``thin``-th step is kept in the draws.
    not_finite
        Likelihood evaluations that came out as no number, those of warm-up included.
    seconds
        Wall-clock time of sampling.
    not_finite_share
        Share of places beside the posterior where the likelihood is no number; see
        :mod:`bayesfric.inference.sampling.undefined_likelihood`.
    warnings
        What to know of a sample that has converged, with the mend.
    max_rhat
        Largest nested R-hat that was accepted.
    """

    status: Status
    problems: tuple[str, ...]
    rhat: NDArray[np.float64]
    tau: NDArray[np.float64]
    ess: NDArray[np.float64]
    acceptance: NDArray[np.float64]
    ensembles: int
    walkers: int
    warmup: int
    steps: int
    thin: int
    not_finite: int
    seconds: float
    not_finite_share: float = 0.0
    warnings: tuple[str, ...] = ()
    max_rhat: float = 1.01

    def sound(self, rhat: NDArray[np.float64], ess: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether numbers with these diagnostics may be told, whatever the others do."""
        if self.status == "reliable":
            return np.ones(rhat.shape, dtype=np.bool_)
        return np.asarray((rhat <= self.max_rhat) & (ess >= _SOUND_ESS))


@dataclass(frozen=True)
class Posterior:
    """Draws of the sampled parameters.

    Attributes
    ----------
    names
        Sampled parameters, noise scales last.
    priors
        Theirs.
    draws
        ``(ensembles, walkers, steps, d)`` in physical units, thinned.
    log_density
        ``(ensembles, walkers, steps)`` log posterior in sampling coordinates.
    coordinates
        In words, which coordinates were sampled.
    diagnostics
        Of the whole sample, before thinning.
    seed
        Of this sample.
    """

    names: tuple[str, ...]
    priors: tuple[Prior, ...]
    draws: NDArray[np.float64]
    log_density: NDArray[np.float64]
    coordinates: str
    diagnostics: Diagnostics
    seed: int

    def flat(self, most: int | None = None) -> NDArray[np.float64]:
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
    def median(self) -> NDArray[np.float64]:
        """Of every parameter by itself, ``(d,)``."""
        return np.asarray(np.median(self.flat(), axis=0))

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """Draws of one parameter, ``(ensembles, walkers, steps)``."""
        return self.draws[..., self.names.index(name)]
