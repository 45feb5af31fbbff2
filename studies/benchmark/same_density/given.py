"""What every arm of ``whose.py`` is given: target, starts, and the long run's quantiles.

A target does not travel between processes, so each arm builds it anew from the draws of a pilot
fit; nobody pays for that, nor for compiling what ``bayesfric`` compiles.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import problem
from numpy.typing import NDArray

from bayesfric.inference.fitting import fit
from bayesfric.inference.sampling.sampling import Sampling
from bayesfric.inference.sampling.start import Start, climb, gauss_newton
from bayesfric.inference.target import Target

Array = NDArray[np.float64]

QUANTILES = (0.05, 0.5, 0.95)
PREPARED = 500  # draws that moments are made around, as many as sampling takes
STARTS = 1024


@dataclass(frozen=True)
class Given:
    """The posterior as ``bayesfric`` samples it."""

    target: Target
    pilot: Array  # (n, 12) parameters
    reference: Array  # (3, 12) quantiles of the long run

    @classmethod
    def read(cls, path: Path) -> Given:
        """Build the target from what :func:`write` left."""
        with np.load(path) as file:
            return cls(built(file["pilot"]), file["pilot"], file["reference"])

    def start(self, target: Target) -> Start:
        """Mode and spread in a target's coordinates, as ``fit`` finds them."""
        rng = np.random.default_rng(7)
        prior = np.stack([one.draw(500, rng) for one in target.priors], axis=1)
        mode = climb(target, target.from_parameters(self.pilot[:50]), climbs=1)
        return gauss_newton(target, mode, target.from_parameters(prior))

    def whitened(self) -> tuple[Array, Array]:
        """Mode ``(12,)`` and Cholesky factor of the normal that ``bayesfric`` itself begins from.

        Coordinates have units, and sds from 1e-7 to 1; gradient samplers walk in whitened ones.
        """
        start = self.start(self.target)
        return start.mode, np.linalg.cholesky(start.covariance)

    def starts(self, seed: int) -> Array:
        """Over-dispersed starts beside the posterior in coordinates, ``(1024, 12)``."""
        rng = np.random.default_rng(seed)
        return self.start(self.target).draw(STARTS, self.target, rng, spread=1.0)


def built(draws: Array) -> Target:
    """Make the target with coordinates and moments for posterior draws ``(n, 12)``."""
    target = problem.target().with_widths(draws.std(axis=0))
    return target.precomputed(target.from_parameters(draws[:PREPARED]))


def write(path: Path, ess: float) -> float:
    """Fit, sample long, and keep what arms need; give the long run's smallest ESS."""
    settings = Sampling(seed=99, min_ess=ess, walkers=512, max_rhat=1.005)
    found = fit(problem.target(), settings).posterior
    flat = found.flat()
    reference = np.quantile(flat, QUANTILES, axis=0)
    pilot = flat[:: len(flat) // 2000][:2000]
    np.savez(path, pilot=np.random.default_rng(3).permutation(pilot), reference=reference)
    return float(found.diagnostics.ess.min())
