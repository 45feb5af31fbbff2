"""Run every rival in its own virtual environment, one after the other, on one core.

``python studies/benchmark/run_rivals.py PYTHON [full|quick]`` with the interpreter of an
environment made by ``pip install -r studies/benchmark/requirements.txt``.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

RIVALS = Path(__file__).resolve().parent / "rivals"


@dataclass(frozen=True)
class Budget:
    """Time limit of a rival."""

    seconds: float  # of sampling; of everything for dynesty and nutpie
    warm_up: float  # seconds for emcee, draws for the two NUTS, live points for dynesty


BUDGETS: Mapping[str, Mapping[str, Budget]] = {
    # about 21 minutes by these numbers; the NUTS warm-up of NumPyro comes on top
    "full": {
        "emcee_plain": Budget(240.0, 60.0),
        "emcee_vectorised": Budget(150.0, 40.0),
        "numpyro_nuts": Budget(240.0, 500),
        "dynesty_nested": Budget(240.0, 300),
        "pymc_nutpie": Budget(180.0, 500),
    },
    # about 2.5 minutes: a smoke test, its rates are not meaningful
    "quick": {
        "emcee_plain": Budget(12.0, 3.0),
        "emcee_vectorised": Budget(12.0, 3.0),
        "numpyro_nuts": Budget(12.0, 150),
        "dynesty_nested": Budget(30.0, 50),
        "pymc_nutpie": Budget(30.0, 100),
    },
}


def run_rivals(
    problem_path: Path,
    python: Path | str,
    budget: Literal["full", "quick"] | Mapping[str, Budget],
    seed: int = 1,
) -> dict[str, dict[str, Any]]:
    """Run the rivals; return their results by script name, ``{"failed": message}`` for an error.

    ``budget`` is ``full``, ``quick`` or budgets by script name; other scripts are not run.
    """
    budgets = BUDGETS[budget] if isinstance(budget, str) else budget
    results: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, allowance in budgets.items():
            path = Path(folder) / f"{name}.json"
            completed = subprocess.run(
                [
                    str(python),
                    str(RIVALS / f"{name}.py"),
                    str(problem_path),
                    str(path),
                    f"--seconds={allowance.seconds}",
                    f"--warm-up={allowance.warm_up}",
                    f"--seed={seed}",
                ],
                capture_output=True,
                text=True,
                check=False,
            )
            if completed.returncode == 0:
                results[name] = json.loads(path.read_text(encoding="utf-8"))
            else:
                errors = completed.stderr.strip().splitlines() or ["no message"]
                results[name] = {"failed": errors[-1]}
    return results


def disagreement(
    rival: Mapping[str, Any], reference: Mapping[str, tuple[float, float]]
) -> dict[str, float]:
    """Return the largest errors of a rival's means and sds over its Monte Carlo errors.

    A sampler that misses the reference by many of its errors did not sample the posterior,
    independent of its ESS: dynesty with too few live points, and NUTS with divergences.
    """
    rows = {name: row for name, row in rival["parameters"].items() if row["mean_error"]}
    return {
        "mean": max(abs(r["mean"] - reference[n][0]) / r["mean_error"] for n, r in rows.items()),
        "sd": max(abs(r["sd"] - reference[n][1]) / r["sd_error"] for n, r in rows.items()),
    }


def main() -> None:
    """Run all rivals and print their results."""
    import problem  # only this needs bayesfric

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "problem.npz"
        problem.write(path)
        results = run_rivals(path, sys.argv[1], "quick" if "quick" in sys.argv else "full")
    print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
