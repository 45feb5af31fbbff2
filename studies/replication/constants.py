"""What the constants of the model discrepancy do to coverage and width. SIMULATED joints.

``python studies/replication/constants.py`` fits one recording of each case of :mod:`lacking`, by
another seed, and takes from each posterior the intervals that other constants would have given it:
of sampled parameters, before anything is called a limit. Writes ``constants.json``; ``--table``
prints what is there.
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack

if __name__ == "__main__":
    for variable in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(variable, "1")

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np
from lacking import BENCHES, CORRECT, EFFECTS, NOT_LISTED, recorded, true_values

import bayesfric.fit.fit
from bayesfric import Model
from bayesfric.inference import discrepancy, missing

HERE = Path(__file__).resolve().parent
SEED = 4100
# Where each constant stands, and what it is tried at; the package's own among them.
TRIED: dict[str, tuple[tuple[Any, ...], str, tuple[float, ...]]] = {
    "share taken": ((discrepancy,), "_TAKEN", (0.25, 0.5, 0.75, 1.0)),
    "typical size": ((missing,), "_TYPICAL", (0.001, 0.003, 0.01)),
    "largest scale": ((missing,), "_LARGEST", (0.1, 0.5)),
    "error of shapes": ((missing,), "_ROUGH", (0.0, 0.1, 0.2, 0.3)),
    "chance": ((discrepancy, missing), "CHANCE", (0.03, 0.1, 0.3)),
}


def one(task: tuple[str, str]) -> dict[str, Any]:
    """Fit one recording; of each constant, which intervals hold and how wide they are."""
    group, name = task
    _, bench = BENCHES[name]
    rng = np.random.default_rng([SEED, *name.encode()])
    asked: list[Any] = []

    def seen(*given: Any) -> Any:
        asked[:] = given
        return discrepancy.discrepancy(*given)

    with TemporaryDirectory() as folder, patch.object(bayesfric.fit.fit, "discrepancy", seen):
        truth, recordings, _ = recorded(bench, rng, Path(folder))
        Model(bench.joint, recordings, **bench.tables).fit(seed=1)
    target, posterior, _ = asked
    draws, true = posterior.flat(), true_values(truth, list(target.free))
    columns = [target.names.index(key) for key in true]
    plain = np.quantile(draws[:, columns], [0.05, 0.95], axis=0)

    def told() -> dict[str, list[float]]:
        room = discrepancy.discrepancy(*asked)
        wide = room.widened(target, draws, np.random.default_rng(0))[:, columns]
        low, high = np.quantile(wide, [0.05, 0.95], axis=0)
        held = (low <= list(true.values())) & (list(true.values()) <= high)
        return {
            "held": held.astype(float).tolist(),
            "wider": ((high - low) / (plain[1] - plain[0])).tolist(),
        }

    result = {}
    for words, (rooms, constant, values) in TRIED.items():
        for value in values:
            with ExitStack() as patches:
                for where in rooms:
                    patches.enter_context(patch.object(where, constant, value))
                result[f"{words} {value:g}"] = told()
    return {"group": group, "case": name, "found": result}


def line(name: str, found: list[dict[str, Any]]) -> str:
    """Sum one constant up, over groups of cases."""
    cells = []
    for group in ("right", "lacking", "not listed"):
        rows = [one["found"][name] for one in found if one["group"] == group]
        held = np.concatenate([row["held"] for row in rows])
        wider = np.concatenate([row["wider"] for row in rows])
        cells += [f"{held.mean():.0%} of {held.size}", f"{np.median(wider):.2f}"]
    return f"| {name} | {' | '.join(cells)} |"


def main() -> None:
    """Fit every case once."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--table", action="store_true")
    asked = parser.parse_args()
    path = HERE / "constants.json"
    if not asked.table:
        groups = {**dict.fromkeys(CORRECT, "right"), **dict.fromkeys(NOT_LISTED, "not listed")}
        tasks = [(groups.get(n, "lacking"), case) for n, cases in EFFECTS.items() for case in cases]
        with ProcessPoolExecutor(asked.workers) as pool:
            found = list(pool.map(one, tasks))
        path.write_text(json.dumps(found) + "\n", encoding="utf-8")
    found = json.loads(path.read_text(encoding="utf-8"))
    for name in found[0]["found"]:
        print(line(name, found))


if __name__ == "__main__":
    main()
