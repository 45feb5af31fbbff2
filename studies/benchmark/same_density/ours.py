"""``bayesfric``, whole and with one of its parts switched off."""

from __future__ import annotations

import time
from copy import copy

import numpy as np
from given import Given
from measured import Measured
from numpy.typing import NDArray

from bayesfric.base.progress import Progress
from bayesfric.inference.coordinates import BoundedCoordinates
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.sampling.sampling import Sampling, sample
from bayesfric.inference.target import Target

Array = NDArray[np.float64]


class FullLength(TorqueLikelihood):
    """Every sample for every draw, in Numba, several draws a call."""

    def precomputed(self, draws: Array) -> TorqueLikelihood:  # noqa: ARG002
        """Stay as it is."""
        return self


class OneByOne(Target):
    """One call for every walker, as a sampler makes that knows no vectorised densities."""

    def __call__(self, u: Array) -> Array:
        """See :class:`Target`."""
        call = super().__call__
        return np.concatenate([call(row[None]) for row in u])


def whole(given: Given, seed: int) -> Measured:
    """Nothing switched off."""
    return _sampled(given, given.target, seed, 512, 200_000.0)


def logarithms(given: Given, seed: int) -> Measured:
    """Switch the coordinates off: the logarithm of each parameter, normal quantile of mu_2."""
    target = copy(given.target)
    own = target.priors[: len(target.free)]
    target.coordinates = BoundedCoordinates([p.lower for p in own], [p.upper for p in own])
    return _sampled(given, target, seed, 512, 20_000.0, max_steps=6000)


def full_length(given: Given, seed: int) -> Measured:
    """Switch the moments off."""
    target, known = copy(given.target), given.target.likelihood
    target.likelihood = FullLength(known.chain, known.observations)
    return _sampled(given, target, seed, 128, 20_000.0)


def one_by_one(given: Given, seed: int) -> Measured:
    """Switch vectorising off; with fewer walkers, which cost nothing more each here."""
    target = copy(given.target)
    target.__class__ = OneByOne
    return _sampled(given, target, seed, 64, 10_000.0)


def _sampled(
    given: Given, target: Target, seed: int, walkers: int, ess: float, max_steps: int = 20_000
) -> Measured:
    start = given.start(target)
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
    "ours": whole,
    "ours, logarithms for coordinates": logarithms,
    "ours, full-length likelihood": full_length,
    "ours, one evaluation a walker": one_by_one,
}
