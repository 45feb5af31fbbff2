"""Dynesty's static nested sampling with its defaults for this dimension.

``dynesty_nested.py PROBLEM RESULT [--seconds S] [--warm-up N] [--seed N]``; ``--warm-up`` is
the number of live points here, as nested sampling has no warm-up. All its time counts.
It stops after ``--seconds``; ``settled`` states whether it was done.
"""

from __future__ import annotations

import time

import result  # first: it limits the process to one core

# isort: split

import dynesty
import numpy as np
import posterior
from scipy.special import ndtr, ndtri

BLOCK = 200  # iterations between time checks
DLOGZ = 0.1  # evidence left in the live points


def main() -> None:
    """Run dynesty and write the result."""
    options = result.arguments(__doc__)
    problem = posterior.read(options.problem)
    sd = problem.prior_sd
    highest = ndtr((problem.upper - problem.prior_mean) / sd)

    def prior_transform(u: np.ndarray) -> np.ndarray:
        return problem.prior_mean + sd * ndtri(u * highest)

    def log_density(x: np.ndarray) -> float:
        # through the transform's inverse, so that it is checked too
        u = ndtr((x - problem.prior_mean) / sd) / highest
        step = 1e-4 * u * (1.0 - u)
        slope = (prior_transform(u + step) - prior_transform(u - step)) / (2.0 * step)
        return problem.log_likelihood(prior_transform(u)) - float(np.log(slope).sum())

    difference = problem.check(log_density)
    begin = time.perf_counter()
    sampler = dynesty.NestedSampler(
        problem.log_likelihood,
        prior_transform,
        problem.dimension,
        nlive=int(options.warm_up),
        rstate=np.random.default_rng(options.seed),
    )
    finished = False
    iterations = 0
    while not finished and time.perf_counter() - begin < options.seconds:
        sampler.run_nested(dlogz=DLOGZ, maxiter=BLOCK, add_live=False, print_progress=False)
        finished = sampler.it - iterations < BLOCK
        iterations = sampler.it
    sampler.run_nested(dlogz=DLOGZ, maxiter=0, add_live=True, print_progress=False)
    seconds = time.perf_counter() - begin
    results = sampler.results
    result.write(
        options.result,
        "dynesty, static nested sampling",
        result.of_weights(problem.names, results.samples, results.logwt),
        seconds=seconds,
        warm_up_seconds=0.0,
        evaluations=int(np.sum(results.ncall)),
        difference=difference,
        versions={"dynesty": dynesty.__version__},
        live_points=int(options.warm_up),
        settled=finished,
        log_evidence=float(results.logz[-1]),
        log_evidence_error=float(results.logzerr[-1]),
    )


if __name__ == "__main__":
    main()
