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
    """What one rival may spend.

    Attributes
    ----------
    seconds
        Of sampling. dynesty and nutpie get it for everything they do.
    warm_up
        Seconds for emcee, draws for the two NUTS, live points for dynesty.
    """

    seconds: float
    warm_up: float


BUDGETS: Mapping[str, Mapping[str, Budget]] = {
    # about 21 minutes by these numbers; the NUTS warm-up of NumPyro comes on top
    "full": {
        "emcee_plain": Budget(240.0, 60.0),
        "emcee_vectorised": Budget(150.0, 40.0),
        "numpyro_nuts": Budget(240.0, 500),
        "dynesty_nested": Budget(240.0, 300),
        "pymc_nutpie": Budget(180.0, 500),
    },
    # about two and a half minutes: shows that everything runs, no rate of it is to be quoted
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
    """Let rivals sample the problem.

    Parameters
    ----------
    problem_path
        What ``problem.write`` wrote.
    python
        Interpreter of the rivals' environment.
    budget
        ``full``, ``quick``, or budgets by script name; a script left out is not run.
    seed
        Of every rival.

    Returns
    -------
    dict
        By script name what ``rivals/result.py`` writes; ``{"failed": ...}`` with the last line
        of its complaint for a rival that did not get there.
    """
    budgets = BUDGETS[budget] if isinstance(budget, str) else budget
    found: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, spend in budgets.items():
            out = Path(folder) / f"{name}.json"
            done = subprocess.run(
                [
                    str(python),
                    str(RIVALS / f"{name}.py"),
                    str(problem_path),
                    str(out),
                    f"--seconds={spend.seconds}",
                    f"--warm-up={spend.warm_up}",
                    f"--seed={seed}",
                ],
                capture_output=True,
                text=True,
                check=False,
            )
            if done.returncode == 0:
                found[name] = json.loads(out.read_text(encoding="utf-8"))
            else:
                complaint = done.stderr.strip().splitlines() or ["no message"]
                found[name] = {"failed": complaint[-1]}
    return found


def disagreement(
    rival: Mapping[str, Any], reference: Mapping[str, tuple[float, float]]
) -> dict[str, float]:
    """Compare a rival's means and sds with better known ones.

    A sampler that claims many draws and misses by many of its own errors did not sample the
    posterior, whatever its ESS: dynesty with too few live points does that here, and so does NUTS
    that diverges.

    Parameters
    ----------
    rival
        From :func:`run_rivals`.
    reference
        Mean and sd of each parameter, known much better than the rival's.

    Returns
    -------
    dict
        ``mean`` and ``sd``: largest differences over the rival's own Monte Carlo errors.
    """
    rows = {name: row for name, row in rival["parameters"].items() if row["mean_error"]}
    return {
        "mean": max(abs(r["mean"] - reference[n][0]) / r["mean_error"] for n, r in rows.items()),
        "sd": max(abs(r["sd"] - reference[n][1]) / r["sd_error"] for n, r in rows.items()),
    }


def main() -> None:
    import problem  # only this needs bayesfric

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "problem.npz"
        problem.write(path)
        found = run_rivals(path, sys.argv[1], "quick" if "quick" in sys.argv else "full")
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
