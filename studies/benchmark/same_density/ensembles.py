"""emcee and zeus on the vectorised density of ``bayesfric``, in its coordinates."""

from __future__ import annotations

import time
from typing import Any

import emcee
import numpy as np
import zeus
from given import Given
from measured import Measured

WALKERS = 512
THIN = 10  # steps between those that are kept
WARM_UP, SAMPLING = 6.0, 15.0  # CPU s
ZEUS_WALKERS = 128


def stretch(given: Given, seed: int) -> Measured:
    """Goodman and Weare's move, emcee's default."""
    return _emcee(given, seed, [(emcee.moves.StretchMove(), 1.0)])


def differential_evolution(given: Given, seed: int) -> Measured:
    """Take emcee's DEMove, every tenth step the whole difference.

    Not with emcee's DESnookerMove, which in 3.1.6 samples something else.
    """
    whole = emcee.moves.DEMove(gamma0=1.0)
    return _emcee(given, seed, [(emcee.moves.DEMove(), 0.9), (whole, 0.1)])


def _emcee(given: Given, seed: int, moves: list[Any]) -> Measured:
    d = given.target.dimension
    np.random.seed(seed)  # noqa: NPY002  (emcee draws its own state from this)
    sampler = emcee.EnsembleSampler(WALKERS, d, given.target, moves=moves, vectorize=True)
    state: Any = given.starts(seed)[:WALKERS]

    def run(seconds: float) -> float:
        nonlocal state
        begin = time.process_time()
        while (spent := time.process_time() - begin) < seconds:
            state = sampler.run_mcmc(state, 20, thin_by=THIN)
        return spent

    warm_up = run(WARM_UP)
    sampler.reset()
    spent = run(SAMPLING)
    kept = np.swapaxes(sampler.get_chain(), 0, 1)
    return _measured(given, kept, warm_up, spent, kept.shape[0] * kept.shape[1] * THIN)


def zeus_slice(given: Given, seed: int) -> Measured:
    """Take zeus' ensemble slice sampling, its default move."""
    np.random.seed(seed)  # noqa: NPY002
    calls = 0

    def density(u: np.ndarray) -> np.ndarray:
        nonlocal calls
        calls += len(u)
        return given.target(np.asarray(u))

    def new() -> Any:
        return zeus.EnsembleSampler(
            ZEUS_WALKERS, given.target.dimension, density, vectorize=True, verbose=False
        )

    begin = time.process_time()
    sampler, state = new(), given.starts(seed)[:ZEUS_WALKERS]
    while time.process_time() - begin < WARM_UP:
        sampler.run_mcmc(state, 100, progress=False)
        state = sampler.get_last_sample()
        tuned = float(sampler.mu)
    warm_up = time.process_time() - begin
    chains, calls = [], 0
    begin = time.process_time()
    # what it learned of the scale is handed on, and no longer learned
    sampler = zeus.EnsembleSampler(
        ZEUS_WALKERS, given.target.dimension, density, vectorize=True, verbose=False,
        mu=tuned, tune=False,
    )  # fmt: skip
    while (spent := time.process_time() - begin) < SAMPLING:
        sampler.run_mcmc(state, 200, progress=False)
        state = sampler.get_last_sample()
        chains.append(sampler.get_chain()[-200:])
    kept = np.swapaxes(np.concatenate(chains), 0, 1)
    return _measured(given, kept, warm_up, spent, calls)


def _measured(given: Given, u: Any, warm_up: float, spent: float, evaluations: float) -> Measured:
    draws = given.target.to_parameters(u.reshape(-1, u.shape[2]))[0].reshape(u.shape)
    return Measured(draws, warm_up, spent, evaluations, walkers=len(u))


ARMS = {
    "emcee StretchMove": stretch,
    "emcee DEMove": differential_evolution,
    "zeus": zeus_slice,
}
