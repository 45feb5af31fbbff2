"""What of the speed is whose: rivals on the density and in the coordinates of ``bayesfric``.

``python studies/benchmark/whose.py`` in an environment with ``bayesfric`` and
``pip install -r studies/benchmark/same_density/requirements.txt``, about 15 minutes; writes
``whose.json``. On the SIMULATED knee of ``problem.py``. Every arm is a process of its own with one
thread, its rate is in CPU seconds (user and system, all threads), and short ones are repeated in
turn, so that work beside slows all alike. ``--arm NAME`` does one arm over and keeps the others.
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

HERE = Path(__file__).resolve().parent
FOLDER = HERE / "same_density"

# How often each runs; the long ones once.
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
SEED = 1  # of the first repeat; the next count up
REFERENCE_ESS = 5e5
LANES = 2  # arms at a time, one for every core
PACKAGES = ("numpy", "numba", "emcee", "zeus-mcmc", "dynesty", "nutpie", "blackjax", "jax", "arviz")


def run(name: str, given: Path, reference_ess: float, seed: int) -> dict[str, Any]:
    """Run one arm and read what it says; ``failed`` with its last words if it did not get there."""
    out = given.with_name(f"{name} {seed}.json")
    words = [name, str(given), str(out), str(reference_ess), str(seed)]
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, str(FOLDER / "arm.py"), *words],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode or not out.exists():
        return {"failed": (done.stderr.strip().splitlines() or ["no message"])[-1]}
    found: dict[str, Any] = json.loads(out.read_text(encoding="utf-8"))
    return {**found, "seed": seed, "wall_seconds_with_everything": time.perf_counter() - begin}


def summary(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Give the run of the median rate, with all rates beside it."""
    good = [one for one in runs if "failed" not in one]
    if not good:
        return runs[0]
    rates = [one["ess_per_cpu_second"] for one in good]
    middle = min(good, key=lambda one: abs(one["ess_per_cpu_second"] - median(rates)))
    return {
        **middle,
        "rates": rates,
        "right": all(one["right"] for one in good),
        "quantiles_off_by_errors": max(one["quantiles_off_by_errors"] for one in good),
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--arm", choices=tuple(ARMS), action="append")
    chosen = parser.parse_args().arm or list(ARMS)
    for variable in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ[variable] = "1"
    sys.path.insert(0, str(FOLDER))
    import given

    path = HERE / "whose.json"
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "given.npz"
        begin = time.process_time()
        ess = given.write(place, REFERENCE_ESS)
        print("the long run", ess, time.process_time() - begin, flush=True)
        runs: dict[str, list[dict[str, Any]]] = {name: [] for name in chosen}
        jobs = [(n, k) for k in range(max(ARMS.values())) for n in chosen if k < ARMS[n]]
        with ThreadPoolExecutor(LANES) as lanes:
            found = lanes.map(lambda job: run(job[0], place, ess, SEED + job[1]), jobs)
            for (name, _), one in zip(jobs, found, strict=True):
                runs[name].append(one)
                print(name, one, flush=True)
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
