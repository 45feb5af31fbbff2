"""Do intervals hold where the model lacks a term? SIMULATED joints of the diagnostics' benches.

``python studies/replication/lacking.py`` fits recordings of :mod:`joints`, each with one thing that
the model does not have and is not given, in three sizes and two motions (a torque that is
commanded, and a path that a position loop follows), and counts how often intervals hold the true
values of what model and joint share. Writes ``lacking.json``; ``--recordings N`` of each,
``--effects A B`` for less; ``--table`` prints what is there.
"""

from __future__ import annotations

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor

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

from joints import BENCHES, RIGHT, SIZES, UNLISTED, recorded

from bayesfric import Model

SEED = 41
MOTIONS = ("", "closed loop, ")
CORRECT = (*RIGHT[:6], "arm", "closed loop")
NOT_LISTED = tuple(motion + name for name in UNLISTED for motion in MOTIONS)
EFFECTS: dict[str, tuple[str, ...]] = {
    **{name: (name,) for name in CORRECT},
    **{
        f"{motion}{name}": tuple(motion + case for case in cases)
        for name, cases in SIZES.items()
        for motion in MOTIONS
    },
}


def true_values(truth: dict[str, float], names: list[str]) -> dict[str, float]:
    """Give what the model's own parameters are of the joint that moved."""
    found = {name: truth[name] for name in names if name in truth}
    if "load.inertia" not in names and "motor.inertia" in found:
        found["motor.inertia"] += truth.get("load.inertia", 0.0)
    if "motor.viscous_positive" in truth:
        both = [truth[f"motor.viscous_{way}"] for way in ("positive", "negative")]
        found["motor.viscous"] = float(np.mean(both))
    return found


def one(task: tuple[str, int]) -> dict[str, Any]:
    """Fit one recording as its model is written."""
    name, number = task
    _, bench = BENCHES[name]
    rng = np.random.default_rng([SEED, *name.encode(), number])
    with TemporaryDirectory() as folder:
        truth, recordings, _ = recorded(bench, rng, Path(folder))
        summary = Model(bench.joint, recordings, **bench.tables).fit(seed=number).summary
    rows = []
    for key, true in true_values(truth, list(summary.joint)).items():
        row = summary.joint[key]
        told = row.reported
        if told is None or told.status == "unidentified":
            continue
        low, high = told.interval
        rows.append(
            {
                "name": key,
                "status": told.status,
                "plain": bool(row.interval[0] <= true <= row.interval[1]),
                "held": bool(low <= true <= high),
                "wider": (high - low) / (row.interval[1] - row.interval[0]),
                "z": float((told.value - true) / told.sd),
                "posterior_z": float((row.middle - true) / row.sd),
            }
        )
    found = [finding.kind for finding in summary.findings]
    return {"outcome": summary.verdict.outcome, "findings": found, "rows": rows}


def line(name: str, found: list[dict[str, Any]]) -> str:
    """Sum one effect up."""
    rows = [row for one in found for row in one["rows"]]
    off = [not one["findings"] and any(abs(row["z"]) > 2.0 for row in one["rows"]) for one in found]
    wider = [row["wider"] for row in rows]
    good = sum(one["outcome"] != "doubtful" for one in found)
    return (
        f"| {name} | {len(rows)} | {np.mean([r['plain'] for r in rows]):.0%} "
        f"| {np.mean([r['held'] for r in rows]):.0%} | {np.median(wider):.2f} "
        f"| {np.quantile(wider, 0.9):.2f} | {np.sqrt(np.mean([r['z'] ** 2 for r in rows])):.2f} "
        f"| {sum(off)} of {len(found)} | {good} of {len(found)} |"
    )


def main() -> None:
    """Fit what is asked for, and keep it case by case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=10)
    parser.add_argument("--effects", nargs="*", default=list(EFFECTS))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--to", type=Path, default=HERE / "lacking.json")
    parser.add_argument("--table", action="store_true")
    told = parser.parse_args()
    result = json.loads(told.to.read_text()) if told.to.exists() else {}
    with ProcessPoolExecutor(told.workers) as pool:
        for effect in told.effects:
            for case in EFFECTS[effect]:
                if not told.table:
                    tasks = [(case, k) for k in range(told.recordings)]
                    result[case] = list(pool.map(one, tasks))
                    told.to.write_text(json.dumps(result, indent=1) + "\n")
            print(line(effect, [f for case in EFFECTS[effect] for f in result[case]]), flush=True)


if __name__ == "__main__":
    main()
