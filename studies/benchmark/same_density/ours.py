"""``bayesfric``, complete and without one of its parts."""

from __future__ import annotations

import time
from copy import copy

import numpy as np
from given import Setup
from measured import Measured
from numpy.typing import NDArray

from bayesfric.base.progress import Progress
from bayesfric.inference.coordinates import BoundedCoordinates
from bayesfric.inference.likelihood import TorqueLikelihood
from bayesfric.inference.sampling import Sampling, sample
from bayesfric.inference.target import Target

Array = NDArray[np.float64]


class FullLength(TorqueLikelihood):
    """Likelihood of all samples for every draw, in Numba, several draws a call."""

    def precomputed(self, draws: Array) -> TorqueLikelihood:  # noqa: ARG002
        """Return itself, without moments."""
        return self


class OneByOne(Target):
    """Target that evaluates one walker per call."""

    def __call__(self, u: Array) -> Array:
        """See :class:`Target`."""
        call = super().__call__
        return np.concatenate([call(row[None]) for row in u])


def full(setup: Setup, seed: int) -> Measured:
    """Sample with all parts."""
    return _sampled(setup, setup.target, seed, 512, 200_000.0)


def logarithms(setup: Setup, seed: int) -> Measured:
    """Sample without coordinates: logarithms, and the normal quantile of mu_2."""
    target = copy(setup.target)
    joint_priors = target.priors[: len(target.free)]
    lower, upper = ([getattr(p, side) for p in joint_priors] for side in ("lower", "upper"))
    target.coordinates = BoundedCoordinates(lower, upper)
    return _sampled(setup, target, seed, 512, 20_000.0, max_steps=6000)


def full_length(setup: Setup, seed: int) -> Measured:
    """Sample without moments."""
    target, known = copy(setup.target), setup.target.likelihood
    target.likelihood = FullLength(known.chain, known.observations)
    return _sampled(setup, target, seed, 128, 20_000.0)


def one_by_one(setup: Setup, seed: int) -> Measured:
    """Sample without vectorisation, with fewer walkers."""
    target = copy(setup.target)
    target.__class__ = OneByOne
    return _sampled(setup, target, seed, 64, 10_000.0)


def _sampled(
    setup: Setup, target: Target, seed: int, walkers: int, ess: float, max_steps: int = 20_000
) -> Measured:
    start = setup.start(target)
    marks: dict[str, float] = {}

    def mark(progress: Progress) -> None:
        marks[progress.phase] = time.process_time()

    settings = Sampling(seed=seed, min_ess=ess, walkers=walkers, max_rhat=1.01, max_steps=max_steps)
    begin = time.process_time()
    posterior = sample(target, start, settings, progress=mark)
    e, w, steps, d = posterior.draws.shape
    drawn = posterior.diagnostics.steps * e * w
    return Measured(
        draws=posterior.draws.reshape(e * w, steps, d),
        warm_up=marks["warm-up"] - begin,
        sampling=marks["sampling"] - marks["warm-up"],
        evaluations=drawn,
        note="" if posterior.diagnostics.status == "reliable" else posterior.diagnostics.status,
        walkers=e * w,
    )


ARMS = {
    "ours": full,
    "ours, logarithms for coordinates": logarithms,
    "ours, full-length likelihood": full_length,
    "ours, one evaluation a walker": one_by_one,
}
