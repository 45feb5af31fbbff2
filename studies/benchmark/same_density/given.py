"""Common setup of all arms of ``whose.py``: target, starts, and quantiles of a long run.

Each arm builds the target in its process, from the draws of a pilot fit. Neither this nor
``bayesfric``'s compilation is timed.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import problem
from numpy.typing import NDArray

from bayesfric.inference.fitting import fit
from bayesfric.inference.sampling import Sampling
from bayesfric.inference.start import Start, climb, gauss_newton
from bayesfric.inference.target import Target

Array = NDArray[np.float64]

QUANTILES = (0.05, 0.5, 0.95)
PREPARED = 500  # draws for the moments, as many as sampling uses
STARTS = 1024


@dataclass(frozen=True)
class Setup:
    """The posterior as ``bayesfric`` samples it."""

    target: Target
    pilot: Array  # (n, 12) parameters
    reference: Array  # (3, 12) quantiles of the long run

    @classmethod
    def read(cls, path: Path) -> Setup:
        """Build the target from the file of :func:`write`."""
        with np.load(path) as file:
            return cls(built(file["pilot"]), file["pilot"], file["reference"])

    def start(self, target: Target) -> Start:
        """Return mode and spread in a target's coordinates, as in ``fit``."""
        rng = np.random.default_rng(7)
        prior = np.stack([density.draw(500, rng) for density in target.priors], axis=1)
        mode = climb(target, target.from_parameters(self.pilot[:50]), climbs=1)
        return gauss_newton(target, mode, target.from_parameters(prior))

    def whitened(self) -> tuple[Array, Array]:
        """Return mode ``(12,)`` and Cholesky factor of the normal that ``bayesfric`` starts from.

        Gradient samplers need whitened coordinates: standard deviations differ by up to 1e7.
        """
        start = self.start(self.target)
        return start.mode, np.linalg.cholesky(start.covariance)

    def starts(self, seed: int) -> Array:
        """Draw over-dispersed starts in coordinates, ``(1024, 12)``."""
        rng = np.random.default_rng(seed)
        return self.start(self.target).draw(STARTS, self.target, rng, spread=1.0)


def built(draws: Array) -> Target:
    """Build the target with coordinates and moments for posterior draws ``(n, 12)``."""
    target = problem.target().with_widths(draws.std(axis=0))
    return target.precomputed(target.from_parameters(draws[:PREPARED]))


def write(path: Path, ess: float) -> float:
    """Sample a long run and save the setup; return its smallest ESS."""
    settings = Sampling(seed=99, min_ess=ess, walkers=512, max_rhat=1.005)
    posterior = fit(problem.target(), settings).posterior
    flat = posterior.flat()
    reference = np.quantile(flat, QUANTILES, axis=0)
    pilot = flat[:: len(flat) // 2000][:2000]
    np.savez(path, pilot=np.random.default_rng(3).permutation(pilot), reference=reference)
    return float(posterior.diagnostics.ess.min())
