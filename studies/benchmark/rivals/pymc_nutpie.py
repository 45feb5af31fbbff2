"""PyMC's model sampled by nutpie: NUTS in Rust, log parameters.

``pymc_nutpie.py PROBLEM RESULT [--seconds S] [--warm-up N] [--seed N]``; ``--warm-up`` is a
number of draws, and counts into the seconds. Low-rank mass matrix, nutpie's option for
correlated posteriors. Time is divided between warm-up and sampling by leapfrog steps.
"""

from __future__ import annotations

import time

import result  # first: it limits the process to one core

# isort: split

import numpy as np
import nutpie
import posterior
import pymc as pm
import pytensor.tensor as pt


def build(problem: posterior.Posterior) -> pm.Model:
    """Write the posterior of the logarithms as a PyMC model."""
    motor, leg = pt.as_tensor(problem.motor), pt.as_tensor(problem.leg)
    with pm.Model() as model:
        x = pm.Normal("x", problem.prior_mean, problem.prior_sd, shape=problem.dimension)
        p = pt.exp(x)
        lambda1, lambda2 = 1.0 + 0.5 * (p[4] - p[5]), 0.5 * (p[4] + p[5])
        gearbox = leg @ pt.stack([p[9], p[6], p[7], p[8], p[10]])
        residual = problem.torque - motor @ p[:4]
        residual = residual - lambda1 * gearbox - lambda2 * problem.sign * pt.abs(gearbox)
        squares = pt.dot(residual, residual)
        pm.Potential("torque", -0.5 * squares / p[11] ** 2 - problem.torque.size * x[11])
        highest = float(problem.upper[5])  # of mu_2, the only bounded one
        pm.Potential("reversible", pt.switch(x[5] > highest, -np.inf, 0.0))
    return model


def main() -> None:
    """Run nutpie and write the result."""
    options = result.arguments(__doc__)
    problem = posterior.read(options.problem)
    model = build(problem)
    compiled_density = model.compile_logp()
    difference = problem.check(lambda x: compiled_density({"x": x}))
    compiled = nutpie.compile_pymc_model(model, initial_points={"x": problem.starts[0]})
    begin = time.perf_counter()
    running = nutpie.sample(
        compiled,
        draws=1_000_000,
        tune=int(options.warm_up),
        chains=1,
        cores=1,
        seed=options.seed,
        low_rank_modified_mass_matrix=True,
        # at the default 0.8 a trial run had divergences (109 of 2369 draws) and standard
        # deviations far too small along the ridge: faster, but not this posterior
        target_accept=0.95,
        save_warmup=True,
        progress_bar=False,
        blocking=False,
    )
    time.sleep(options.seconds)
    trace = running.abort()
    spent = time.perf_counter() - begin
    if "draw" not in trace.posterior.sizes or trace.posterior.sizes["draw"] < 4:
        raise SystemExit("nutpie did not get past its warm-up; raise --seconds")
    before = float(trace.warmup_sample_stats["n_steps"].sum())
    after = float(trace.sample_stats["n_steps"].sum())
    draws = trace.posterior["x"].to_numpy()
    result.write(
        options.result,
        "PyMC with nutpie, NUTS, low-rank mass matrix, log parameters",
        result.of_chains(problem.names, draws),
        seconds=spent * after / (before + after),
        warm_up_seconds=spent * before / (before + after),
        evaluations=after,
        difference=difference,
        versions={"pymc": pm.__version__, "nutpie": nutpie.__version__},
        draws=draws.shape[1],
        gradients_per_draw=after / draws.shape[1],
        divergent=int(trace.sample_stats["diverging"].sum()),
    )


if __name__ == "__main__":
    main()
