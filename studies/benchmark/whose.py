"""Compare samplers on the density and in the coordinates of ``bayesfric``.

``python studies/benchmark/whose.py`` in an environment with ``bayesfric`` and
``pip install -r studies/benchmark/same_density/requirements.txt``, about 15 minutes; writes
``whose.json``. On the SIMULATED knee of ``problem.py``. Every arm is a process with one
thread, its rate is in CPU seconds (user and system, all threads). Short arms are repeated in
turn, so that other load slows all equally. ``--arm NAME`` repeats one arm only.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Any

FOLDER = Path(__file__).resolve().parent
SAME_DENSITY = FOLDER / "same_density"

# Number of runs; long arms run once.
ARMS = {
    "dynesty": 1,
    "ours": 3,
    "ours, full-length likelihood": 3,
    "ours, one evaluation a walker": 1,
    "ours, logarithms for coordinates": 1,
    "blackjax HMC": 3,
    "blackjax NUTS": 1,
    "nutpie NUTS": 3,
    "emcee DEMove": 1,
    "emcee StretchMove": 1,
    "zeus": 1,
}
SEED = 1  # of the first run, incremented for each repeat
REFERENCE_ESS = 5e5
LANES = 2  # arms at a time, one for every core
PACKAGES = ("numpy", "numba", "emcee", "zeus-mcmc", "dynesty", "nutpie", "blackjax", "jax", "arviz")


def run(name: str, problem_path: Path, reference_ess: float, seed: int) -> dict[str, Any]:
    """Run one arm and read its result; ``failed`` with the last error line if it has none."""
    path = problem_path.with_name(f"{name} {seed}.json")
    arguments = [name, str(problem_path), str(path), str(reference_ess), str(seed)]
    begin = time.perf_counter()
    completed = subprocess.run(
        [sys.executable, str(SAME_DENSITY / "arm.py"), *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    if completed.returncode or not path.exists():
        return {"failed": (completed.stderr.strip().splitlines() or ["no message"])[-1]}
    result: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return {**result, "seed": seed, "wall_seconds_with_everything": time.perf_counter() - begin}


def summary(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the run of the median rate, with all rates."""
    completed = [run for run in runs if "failed" not in run]
    if not completed:
        return runs[0]
    rates = [run["ess_per_cpu_second"] for run in completed]
    median_run = min(completed, key=lambda run: abs(run["ess_per_cpu_second"] - median(rates)))
    return {
        **median_run,
        "rates": rates,
        "right": all(run["right"] for run in completed),
        "quantiles_off_by_errors": max(run["quantiles_off_by_errors"] for run in completed),
    }


def main() -> None:
    """Run the arms and save the result."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--arm", choices=tuple(ARMS), action="append")
    chosen = parser.parse_args().arm or list(ARMS)
    for variable in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ[variable] = "1"
    sys.path.insert(0, str(SAME_DENSITY))
    import given

    path = FOLDER / "whose.json"
    with tempfile.TemporaryDirectory() as folder:
        problem_path = Path(folder) / "given.npz"
        begin = time.process_time()
        ess = given.write(problem_path, REFERENCE_ESS)
        print("the long run", ess, time.process_time() - begin, flush=True)
        runs: dict[str, list[dict[str, Any]]] = {name: [] for name in chosen}
        jobs = [(n, k) for k in range(max(ARMS.values())) for n in chosen if k < ARMS[n]]
        with ThreadPoolExecutor(LANES) as lanes:
            outcomes = lanes.map(lambda job: run(job[0], problem_path, ess, SEED + job[1]), jobs)
            for (name, _), outcome in zip(jobs, outcomes, strict=True):
                runs[name].append(outcome)
                print(name, outcome, flush=True)
    before = json.loads(path.read_text(encoding="utf-8"))["arms"] if path.exists() else {}
    result = {
        "simulated": True,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores shared with other work; each arm "
        "in one thread; CPU seconds",
        "reference_ess": ess,
        "versions": {"python": platform.python_version(), **{p: version(p) for p in PACKAGES}},
        "arms": {**before, **{name: summary(runs[name]) for name in runs}},
    }
    path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
