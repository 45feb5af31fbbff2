"""emcee as in its documentation: stretch move, one NumPy evaluation per walker.

``emcee_plain.py PROBLEM RESULT [--seconds S] [--warm-up S] [--seed N]``
"""

from __future__ import annotations

import time
from argparse import Namespace
from collections.abc import Callable

import result  # first: it limits the process to one core

# isort: split

import emcee
import numpy as np
import posterior

WALKERS = 32  # as in the documentation, more than twice the dimension
BLOCK = 25  # steps between time checks


def run(sampler: emcee.EnsembleSampler, state: object, seconds: float) -> tuple[object, float]:
    """Sample for a time; return the state and the elapsed seconds."""
    begin = time.perf_counter()
    while (spent := time.perf_counter() - begin) < seconds:
        state = sampler.run_mcmc(state, BLOCK)
    return state, spent


def sample(
    options: Namespace,
    problem: posterior.Posterior,
    log_density: Callable[[np.ndarray], np.ndarray | float],
    walkers: int,
    words: str,
    difference: float,
    **settings: bool,
) -> None:
    """Warm up, sample and write the result."""
    np.random.seed(options.seed)  # noqa: NPY002  (emcee draws its own state from this)
    sampler = emcee.EnsembleSampler(walkers, problem.dimension, log_density, **settings)
    state, warm_up = run(sampler, problem.starts[:walkers], options.warm_up)
    sampler.reset()
    _, seconds = run(sampler, state, options.seconds)
    tau = float(np.max(sampler.get_autocorr_time(quiet=True, tol=0)))
    draws = np.swapaxes(sampler.get_chain(), 0, 1)
    evaluations = draws.shape[0] * draws.shape[1]
    result.write(
        options.result,
        f"emcee, StretchMove, {words}, log parameters",
        result.of_chains(problem.names, draws),
        seconds=seconds,
        warm_up_seconds=warm_up,
        evaluations=evaluations,
        difference=difference,
        versions={"emcee": emcee.__version__},
        walkers=walkers,
        steps=draws.shape[1],
        acceptance=float(sampler.acceptance_fraction.mean()),
        tau=tau,
        ess_from_tau=evaluations / tau,
    )


def main() -> None:
    """Run emcee and write the result."""
    options = result.arguments(__doc__)
    problem = posterior.read(options.problem)
    difference = problem.check(problem.log_density)
    words = "one NumPy evaluation a walker"
    sample(options, problem, problem.log_density, WALKERS, words, difference)


if __name__ == "__main__":
    main()
