"""Measure the autocorrelation time of plain emcee on bayesfric's faster likelihood.

The stretch move's autocorrelation time in steps does not depend on the implementation of the
density. Plain emcee (``rivals/emcee_plain.py``) is too slow to run for many autocorrelation times;
here ``bayesfric`` computes the same density in the same coordinates, with the same number of
walkers. ESS a second of plain emcee is then ``walkers / tau / seconds a step`` with its measured
seconds a step.

``python studies/benchmark/stretch_time.py [SECONDS]``
"""

from __future__ import annotations

import sys
import time

import emcee
import numpy as np
import problem

from bayesfric.inference.target import Target

BLOCK = 1000  # steps between time checks
THIN = 10


def stretch_time(
    target: Target, seconds: float, *, walkers: int = 32, seed: int = 1
) -> dict[str, float]:
    """Measure the largest autocorrelation time ``tau`` in log parameters, in steps.

    ``relative_error`` is Sokal's; the first quarter of the steps is dropped. Over fewer than some
    fifty ``tau`` the estimate is too small, not just uncertain.
    """
    begin = time.perf_counter()
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    start = problem.starts(target, walkers, rng)

    def log_density(x: np.ndarray) -> np.ndarray:
        return problem.log_density_of_logarithms(target, x)

    np.random.seed(seed)  # noqa: NPY002  (emcee draws its own state from this)
    sampler = emcee.EnsembleSampler(walkers, start.shape[1], log_density, vectorize=True)
    state: object = start
    while time.perf_counter() - begin < seconds:
        state = sampler.run_mcmc(state, BLOCK // THIN, thin_by=THIN, skip_initial_state_check=True)
    chain = sampler.get_chain()
    chain = chain[chain.shape[0] // 4 :]
    tau = THIN * float(np.max(emcee.autocorr.integrated_time(chain, quiet=True, tol=0)))
    steps = THIN * chain.shape[0]
    return {
        "tau": tau,
        "steps": float(steps),
        "walkers": float(walkers),
        "relative_error": float((10.0 * tau / (steps * walkers)) ** 0.5),
        "acceptance": float(sampler.acceptance_fraction.mean()),
    }


if __name__ == "__main__":
    print(stretch_time(problem.target(), float(sys.argv[1]) if len(sys.argv) > 1 else 120.0))
