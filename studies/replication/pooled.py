"""Does pooling hold where the model lacks a term that all recordings share? SIMULATED.

``python studies/replication/pooled.py`` makes five recordings of one joint, whose viscous friction
differs by a tenth from one to the next, each with the same thing missing in the model that is
fitted; ``bayesfric pool`` then says what is common, what varies, and the next recording's value.
Counted is how often its 90 % intervals hold, whole path, from files on. Writes ``pooled.json``;
``--sets N`` of each, ``--cases A B`` for less.
"""

from __future__ import annotations

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

if __name__ == "__main__":
    for variable in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(variable, "1")

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
for folder in ("calibration", "diagnostics"):
    sys.path.insert(0, str(HERE.parent / folder))

from bench import Bench, as_recorded
from joints import BENCHES, recorded
from lacking import true_values

from bayesfric import Model, pool
from bayesfric.population.population import Interval

SEED, RECORDINGS, VARIES, SPREAD = 43, 5, "motor.viscous", 0.1
CASES = (
    "arm", "torque constant sags by 0.05", "load loss 0.15", "Stribeck rise 0.4",
    "a loss with the root of speed 0.15", "a spring 0.1", "viscous by angle",
)  # fmt: skip


def pool_one(task: tuple[str, int]) -> dict[str, Any]:
    """Pool one set of recordings; of each number whether its interval holds the truth."""
    name, number = task
    bench = BENCHES[name][1]
    assert isinstance(bench, Bench)
    rng = np.random.default_rng([SEED, *name.encode(), number])
    common = bench.truth(rng)
    mean, size = common[VARIES], SPREAD * common[VARIES]
    drawn = mean + size * rng.standard_normal(RECORDINGS + 1)
    with TemporaryDirectory() as folder:
        recordings = []
        for k, value in enumerate(drawn[:-1].tolist()):
            own = replace(bench, values={**common, VARIES: value}, spread=0.0)
            recorded(own, rng, Path(folder))
            path = Path(folder) / "recording-0.csv"  # a file each
            recordings.append(
                as_recorded(own, own.drives[0], path.rename(path.with_stem(f"run-{k}")))
            )
        model = Model(
            bench.joint, recordings, **bench.tables, pooling={"vary": {VARIES: "recording"}}
        )
        pooled = pool(model, seed=number)
    true = true_values(common, [p.name for p in pooled.shared])
    (varying,) = pooled.varying
    return {
        "outcome": pooled.outcome,
        "shared": {p.name: _holds(p.value, true[p.name]) for p in pooled.shared if p.name in true},
        "mean": _holds(varying.jointly.mean, mean),
        "spread": _holds(varying.jointly.spread, size),
        "spread over the true one": varying.jointly.spread.median / size,
        "next": _holds(varying.jointly.following, float(drawn[-1])),
        "runs": [
            _holds(run, value)
            for run, value in zip(varying.jointly.runs, drawn[:-1].tolist(), strict=True)
        ],
    }


def _holds(interval: Interval, true: float) -> bool:
    return bool(interval.low <= true <= interval.high)


def line(name: str, results: list[dict[str, Any]]) -> str:
    """Sum one case up."""
    shared = [held for result in results for held in result["shared"].values()]
    runs = [held for result in results for held in result["runs"]]
    parts = [f"{np.mean(shared):.0%} of {len(shared)}", f"{np.mean(runs):.0%} of {len(runs)}"]
    for key in ("mean", "spread", "next"):
        parts.append(f"{sum(result[key] for result in results)} of {len(results)}")
    size = np.median([result["spread over the true one"] for result in results])
    return f"| {name} | {' | '.join(parts)} | {size:.2f} |"


def main() -> None:
    """Pool what is asked for, and keep it case by case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=10)
    parser.add_argument("--cases", nargs="*", default=list(CASES))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--to", type=Path, default=HERE / "pooled.json")
    asked = parser.parse_args()
    result = json.loads(asked.to.read_text()) if asked.to.exists() else {}
    with ProcessPoolExecutor(asked.workers) as pool:
        for case in asked.cases:
            result[case] = list(pool.map(pool_one, [(case, k) for k in range(asked.sets)]))
            asked.to.write_text(json.dumps(result, indent=1) + "\n")
            print(line(case, result[case]), flush=True)


if __name__ == "__main__":
    main()
