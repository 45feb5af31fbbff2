"""Compute and write the results of a rival, in the same way for all."""

from __future__ import annotations

import json
import os
import time
import warnings
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any

# One core each, set before any library starts its threads.
_THREADS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "RAYON_NUM_THREADS",
)
os.environ.update(dict.fromkeys(_THREADS, "1"))
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

warnings.filterwarnings("ignore", "\\s*ArviZ is undergoing", FutureWarning)

import arviz as az
import numpy as np

# Longer chains are thinned to this before ESS is computed: enough for every autocorrelation time
# here.
_LONGEST = 4000
# Windows of Sokal's estimator: the variance of tau is about 2 (2 M + 1) / n, with M = 5 tau.
_SOKAL = 10.0
# Largest R-hat of chains with a meaningful ESS.
_SETTLED = 1.01
_KEYS = ("mean", "sd", "mean_error", "sd_error", "ess", "rhat")


def arguments(description: str | None) -> Namespace:
    """Read the command line, common to all rivals."""
    parser = ArgumentParser(description=description)
    parser.add_argument("problem", type=Path)
    parser.add_argument("result", type=Path)
    parser.add_argument("--seconds", type=float, default=60.0, help="of sampling after warm-up")
    parser.add_argument("--warm-up", type=float, default=20.0, help="s, or see the script")
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args()


def of_chains(names: tuple[str, ...], draws: np.ndarray) -> dict[str, Any]:
    """Summarise chains of logarithms, ``(chains, draws, d)``.

    ESS is ArviZ's rank-normalised bulk ESS, which is the same for a parameter and its logarithm;
    means and standard deviations are the parameter's.
    """
    thin = -(-draws.shape[1] // _LONGEST)
    thinned = np.exp(draws[:, ::thin])
    rows = {}
    for j, name in enumerate(names):
        x = np.ascontiguousarray(thinned[:, :, j])
        rows[name] = _of_one(x) if np.ptp(x) > 0.0 else dict.fromkeys(_KEYS, None) | {"ess": 0.0}
    return rows


def _of_one(x: np.ndarray) -> dict[str, float]:
    sd = float(x.std(ddof=1))
    # not az.mcse: of ArviZ 0.23.4, it fails on NumPy 2.4 for standard deviations
    squares = (x - x.mean()) ** 2
    return {
        "mean": float(x.mean()),
        "sd": sd,
        "mean_error": sd / float(az.ess(x, method="mean")) ** 0.5,
        "sd_error": float(squares.std() / az.ess(squares, method="mean") ** 0.5 / (2.0 * sd)),
        "ess": float(az.ess(x, method="bulk")),
        "rhat": float(az.rhat(x if x.shape[0] > 1 else _parts(x[0]))),
    }


def _parts(chain: np.ndarray) -> np.ndarray:
    """Cut a single chain into four, for R-hat."""
    quarter = chain.size // 4
    return chain[: 4 * quarter].reshape(4, quarter)


def of_weights(names: tuple[str, ...], draws: np.ndarray, log_weights: np.ndarray) -> dict:
    """Summarise weighted logarithms, ``(n, d)`` and ``(n,)``.

    ESS is Kish's, ``(sum w)² / sum w²``, which ignores dependence between draws.
    """
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    ess = float(1.0 / (weights @ weights))
    rows = {}
    for j, name in enumerate(names):
        x = np.exp(draws[:, j])
        mean = float(weights @ x)
        variance = float(weights @ (x - mean) ** 2)
        fourth = float(weights @ (x - mean) ** 4)
        rows[name] = {
            "mean": mean,
            "sd": variance**0.5,
            "mean_error": float(weights**2 @ (x - mean) ** 2) ** 0.5,
            "sd_error": (max(fourth - variance**2, 0.0) / ess / (4.0 * variance)) ** 0.5,
            "ess": ess,
            "rhat": None,
        }
    return rows


def write(
    path: Path,
    sampler: str,
    parameters: Mapping[str, Mapping[str, Any]],
    *,
    seconds: float,
    warm_up_seconds: float,
    evaluations: float,
    difference: float,
    versions: Mapping[str, str],
    settled: bool | None = None,
    **extra: Any,
) -> None:
    """Write the result of a rival.

    ``parameters`` come from :func:`of_chains` or :func:`of_weights`. ``seconds`` and
    ``evaluations`` are of sampling alone, ``warm_up_seconds`` of compilation and warm-up.
    ``settled`` is by R-hat unless given; without convergence the rate is at best an upper bound,
    as ArviZ counts walkers that never mixed as one draw each.
    """
    worst = min(parameters, key=lambda name: parameters[name]["ess"])
    ess = float(parameters[worst]["ess"])
    rate = ess / seconds
    rhats = [row["rhat"] for row in parameters.values()]
    largest = max(rhats) if None not in rhats else None
    if settled is None:
        settled = largest is not None and largest < _SETTLED
    result = {
        "sampler": sampler,
        "ess": ess,
        "worst": worst,
        "settled": settled,
        "rhat": largest,
        "seconds": seconds,
        "warm_up_seconds": warm_up_seconds,
        "ess_per_second": rate,
        # an ESS of ten is uncertain by a factor of about two
        "ess_per_second_relative_error": (_SOKAL / ess) ** 0.5 if ess > 0.0 else None,
        "ess_per_second_with_warm_up": ess / (seconds + warm_up_seconds),
        "cpu_seconds_in_all": time.process_time(),
        "evaluations": evaluations,
        "microseconds_per_evaluation": 1e6 * seconds / evaluations,
        "log_density_difference": difference,
        "versions": {"numpy": np.__version__, "arviz": az.__version__, **versions},
        "cores": 1,
        **extra,
        "parameters": parameters,
    }
    path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
