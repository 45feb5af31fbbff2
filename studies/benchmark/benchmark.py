"""Compare sampling speed with other samplers on a SIMULATED knee.

``python studies/benchmark/benchmark.py [--rivals PYTHON] [--budget full|quick]`` measures
``bayesfric`` at 10^4 and 10^6 samples, with white and AR(2) noise, and its preparation; then, with
an environment of the rivals (``pip install -r studies/benchmark/requirements.txt``),
every rival on the same posterior in the same run. One core for each. Writes ``result.json``.
"""

from __future__ import annotations

import argparse
import os

for variable in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[variable] = "1"
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import problem
from run_rivals import disagreement, run_rivals

from bayesfric.base.progress import Progress
from bayesfric.estimates.input_error import input_error
from bayesfric.estimates.least_squares import least_squares
from bayesfric.estimates.point_estimate import Estimation, Knowledge
from bayesfric.inference.fitting import fit, target_of
from bayesfric.inference.likelihood import TorqueLikelihood
from bayesfric.inference.moments import fast_moments
from bayesfric.inference.noise import Autoregressive
from bayesfric.inference.priors import read_prior
from bayesfric.inference.sampling import Sampling
from bayesfric.inference.target import Target

# any first moment: it fixes the scale that no torque determines, and starts the search
KNOWLEDGE = Knowledge(fixed={"load.first_moment": problem.PRIOR_MEDIANS["load.first_moment"]})
FOLDER = Path(__file__).resolve().parent


def target(n: int, order: int) -> Target:
    """Build the benchmark's posterior with noise of this order."""
    white = problem.target(n)
    if order == 0:
        return white
    white_likelihood = white.likelihood
    likelihood = TorqueLikelihood(
        white_likelihood.chain, white_likelihood.observations, Autoregressive(order)
    )
    priors = dict(problem.priors())
    for k in range(1, order + 1):
        priors[f"noise.pacf_{k}"] = read_prior(
            f"noise.pacf_{k}", [-1.0, 1.0], lower=-1.0, upper=1.0
        )
    return target_of(likelihood, priors, "shared")


def ours(n: int, order: int, ess: float) -> dict[str, Any]:
    """Sample once, after compilation and including estimation, and return rates."""
    posterior = target(n, order)
    likelihood = posterior.likelihood
    begin = time.perf_counter()
    # from point estimates, as the command does, here of the first samples at negligible cost
    first_samples = [problem.observation(10_000)]
    start = input_error(likelihood.chain, first_samples, KNOWLEDGE, Estimation(starts=2, seed=1))
    estimates = (least_squares(likelihood.chain, likelihood.observations), start)
    marks: dict[str, float] = {}

    def mark(progress: Progress) -> None:
        marks[progress.phase] = time.perf_counter()

    settings = Sampling(seed=1, min_ess=ess, walkers=512, max_rhat=1.005)
    result = fit(posterior, settings, estimates=estimates, progress=mark)
    end = time.perf_counter()
    diagnostics = result.posterior.diagnostics
    sampling = marks["sampling"] - marks["warm-up"]
    drawn = diagnostics.ensembles * diagnostics.walkers * diagnostics.steps
    flat = result.posterior.flat()
    return {
        "samples": n,
        "noise": f"AR({order})" if order else "white",
        "status": diagnostics.status,
        "ess": float(diagnostics.ess.min()),
        "tau": float(diagnostics.tau.max()),
        "acceptance": float(diagnostics.acceptance.mean()),
        "rhat": float(diagnostics.rhat.max()),
        "seconds": end - begin,
        "sampling_seconds": sampling,
        "ess_per_second": float(diagnostics.ess.min()) / sampling,
        "ess_per_second_with_everything": float(diagnostics.ess.min()) / (end - begin),
        "microseconds_a_draw": 1e6 * sampling / drawn,
        "mean": dict(zip(result.posterior.names, flat.mean(axis=0).tolist(), strict=True)),
        "sd": dict(zip(result.posterior.names, flat.std(axis=0).tolist(), strict=True)),
    }


def preparation(n: int, order: int) -> float:
    """Return the number of samples reduced to moments per second, after compilation."""
    posterior = target(n, order)
    true = np.array([problem.truth()[name] for name in posterior.likelihood.chain.names])
    rng = np.random.default_rng(1)
    draws = true * np.exp(0.02 * rng.standard_normal((300, true.size)))
    observations = posterior.likelihood.observations
    fast_moments(posterior.likelihood.chain, observations, draws, order)
    begin = time.perf_counter()
    fast_moments(posterior.likelihood.chain, observations, draws, order)
    return n / (time.perf_counter() - begin)


def main() -> None:
    """Run all samplers and save the result."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rivals", type=Path, default=None)
    parser.add_argument("--budget", choices=("full", "quick"), default="full")
    parser.add_argument("--ess", type=float, default=200_000.0)
    options = parser.parse_args()
    ours(10_000, 0, 1000.0)  # compiles
    ours(10_000, 2, 1000.0)
    rows = {
        f"{n:.0e} {order}": ours(n, order, options.ess)
        for n, order in ((10_000, 0), (10_000, 2), (1_000_000, 0), (1_000_000, 2))
    }
    for name, row in rows.items():
        print(name, {k: v for k, v in row.items() if k not in ("mean", "sd")}, flush=True)
    result: dict[str, Any] = {
        "simulated": True,
        "ours": rows,
        "preparation_samples_per_second": {
            str(order): preparation(1_000_000, order) for order in (0, 1, 2)
        },
    }
    print(result["preparation_samples_per_second"], flush=True)
    if options.rivals is not None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "problem.npz"
            problem.write(path)
            result["rivals"] = run_rivals(path, options.rivals, options.budget)
        white = rows["1e+04 0"]
        reference = {n: (white["mean"][n], white["sd"][n]) for n in white["mean"]}
        for name, rival in result["rivals"].items():
            if "failed" not in rival:
                rival["disagreement"] = disagreement(rival, reference)
            print(name, {k: v for k, v in rival.items() if k != "parameters"}, flush=True)
    (FOLDER / "result.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
