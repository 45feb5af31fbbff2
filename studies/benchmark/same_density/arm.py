"""Run one arm of ``whose.py``: ``arm.py NAME GIVEN RESULT REFERENCE_ESS SEED``."""

from __future__ import annotations

import os
import sys

for _variable in ("OMP", "OPENBLAS", "MKL", "NUMBA", "RAYON"):
    os.environ[f"{_variable}_NUM_THREADS"] = "1"
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
import importlib
import json
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
warnings.filterwarnings("ignore", "\\s*ArviZ is undergoing", FutureWarning)

from given import Setup

MODULES = {
    "ours": ("ours",),
    "ensembles": ("emcee", "zeus"),
    "one_at_a_time": ("dynesty", "nutpie"),
    "in_jax": ("blackjax",),
}


def main() -> None:
    """Run the arm and write its result."""
    name, setup_path, result_path, ess, seed = sys.argv[1:]
    module = next(m for m, begin in MODULES.items() if name.startswith(begin))
    setup = Setup.read(Path(setup_path))
    setup.target(setup.target.from_parameters(setup.pilot))  # compile before timing
    outcome = importlib.import_module(module).ARMS[name](setup, int(seed))
    summary = outcome.summary(setup.target.names, setup.reference, float(ess))
    Path(result_path).write_text(json.dumps(summary), encoding="utf-8")


if __name__ == "__main__":
    main()
