"""emcee and zeus on the vectorised density of ``bayesfric``, in its coordinates."""

from __future__ import annotations

import time
from typing import Any

import emcee
import numpy as np
import zeus
from given import Setup
from measured import Measured

WALKERS = 512
THIN = 10  # thinning, steps
WARM_UP, SAMPLING = 6.0, 15.0  # CPU s
ZEUS_WALKERS = 128


def stretch(setup: Setup, seed: int) -> Measured:
    """Sample by Goodman and Weare's move, emcee's default."""
    return _emcee(setup, seed, [(emcee.moves.StretchMove(), 1.0)])


def differential_evolution(setup: Setup, seed: int) -> Measured:
    """Sample by emcee's DEMove, every tenth step with gamma 1.

    emcee's DESnookerMove is biased in 3.1.6 and not used.
    """
    full_step = emcee.moves.DEMove(gamma0=1.0)
    return _emcee(setup, seed, [(emcee.moves.DEMove(), 0.9), (full_step, 0.1)])


def _emcee(setup: Setup, seed: int, moves: list[Any]) -> Measured:
    d = setup.target.dimension
    np.random.seed(seed)  # noqa: NPY002  (emcee draws its own state from this)
    sampler = emcee.EnsembleSampler(WALKERS, d, setup.target, moves=moves, vectorize=True)
    state: Any = setup.starts(seed)[:WALKERS]

    def run(seconds: float) -> float:
        nonlocal state
        begin = time.process_time()
        while (spent := time.process_time() - begin) < seconds:
            state = sampler.run_mcmc(state, 20, thin_by=THIN)
        return spent

    warm_up = run(WARM_UP)
    sampler.reset()
    spent = run(SAMPLING)
    chain = np.swapaxes(sampler.get_chain(), 0, 1)
    return _measured(setup, chain, warm_up, spent, chain.shape[0] * chain.shape[1] * THIN)


def zeus_slice(setup: Setup, seed: int) -> Measured:
    """Sample by zeus' ensemble slice sampling, its default move."""
    np.random.seed(seed)  # noqa: NPY002
    calls = 0

    def density(u: np.ndarray) -> np.ndarray:
        nonlocal calls
        calls += len(u)
        return setup.target(np.asarray(u))

    def new() -> Any:
        return zeus.EnsembleSampler(
            ZEUS_WALKERS, setup.target.dimension, density, vectorize=True, verbose=False
        )

    begin = time.process_time()
    sampler, state = new(), setup.starts(seed)[:ZEUS_WALKERS]
    while time.process_time() - begin < WARM_UP:
        sampler.run_mcmc(state, 100, progress=False)
        state = sampler.get_last_sample()
        tuned = float(sampler.mu)
    warm_up = time.process_time() - begin
    chains, calls = [], 0
    begin = time.process_time()
    # the tuned scale is fixed
    sampler = zeus.EnsembleSampler(
        ZEUS_WALKERS, setup.target.dimension, density, vectorize=True, verbose=False,
        mu=tuned, tune=False,
    )  # fmt: skip
    while (spent := time.process_time() - begin) < SAMPLING:
        sampler.run_mcmc(state, 200, progress=False)
        state = sampler.get_last_sample()
        chains.append(sampler.get_chain()[-200:])
    chain = np.swapaxes(np.concatenate(chains), 0, 1)
    return _measured(setup, chain, warm_up, spent, calls)


def _measured(setup: Setup, u: Any, warm_up: float, spent: float, evaluations: float) -> Measured:
    draws = setup.target.to_parameters(u.reshape(-1, u.shape[2]))[0].reshape(u.shape)
    return Measured(draws, warm_up, spent, evaluations, walkers=len(u))


ARMS = {
    "emcee StretchMove": stretch,
    "emcee DEMove": differential_evolution,
    "zeus": zeus_slice,
}
