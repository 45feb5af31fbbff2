"""Compare fits by the motion that the regressors use, on SIMULATED benches.

``python studies/calibration/motion.py`` fits the recordings of :mod:`bench` with three motions:
the ``encoder``'s, low-passed; ``refined`` by the model, as in ``fit``; and the ``exact`` one,
behind the same filters. It evaluates posteriors as sampled, without calibration check and model
discrepancy. Writes ``motion.json``; ``--recordings N`` and ``--cases A B`` for less, ``--table``
prints the saved result.
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ProcessPoolExecutor

if __name__ == "__main__":
    for variable in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(variable, "1")

import json
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from bench import CASES, recorded

from bayesfric import Model
from bayesfric.base.errors import BadInput
from bayesfric.inference.fitting import fit
from bayesfric.mechanism.derived import derive
from bayesfric.recordings.signals import with_motion
from bayesfric.report.summary.derived_quantities import groups
from bayesfric.report.summary.summary import summarise

FOLDER = Path(__file__).resolve().parent
SEED = 37
MOTIONS = ("encoder", "refined", "exact")
BENCHES = [
    "plain", "slow", "geared", "plain, 100 Hz", "plain, 1 kHz", "geared, encoder at the joint",
    "sticking", "current", "knee", "knee, loaded pair", "late by 0.3 samples",
]  # fmt: skip


def run_case(task: tuple[str, int]) -> dict[str, Any]:
    """Fit one recording with each motion and compare every quantity with the truth."""
    name, number = task
    bench = CASES[name]
    seed = np.random.SeedSequence(SEED, spawn_key=(list(CASES).index(name), number))
    motions: list[Any] = []
    with TemporaryDirectory() as folder:
        rng = np.random.default_rng(seed)
        truth, recordings, _ = recorded(bench, rng, Path(folder), motions)
        begun = time.process_time()
        try:
            model = Model(bench.joint, recordings, **bench.tables)
        except BadInput as error:
            nothing: dict[str, Any] = {motion: {} for motion in MOTIONS}
            return {"case": name, "refused": str(error), "seconds": 0.0} | nothing
        prepared = time.process_time() - begun
    pairs = zip(model.recordings, model.encoder, motions, strict=True)
    exact = [
        with_motion(signals, recording, *(x[: signals.q.size] for x in samples))
        for recording, signals, samples in pairs
    ]
    signals_of = dict(zip(MOTIONS, (model.encoder, model.observations, exact), strict=True))
    values = np.array([[truth[n] for n in bench.joint.names]])
    true = {**truth, **{q.name: float(q.values[0]) for q in derive(bench.joint, values, 1.0)}}
    outcome: dict[str, Any] = {"case": name, "number": number, "seconds": prepared}
    for motion, observations in signals_of.items():
        model.observations, model._estimates = observations, {}  # clear cached estimates
        try:
            outcome[motion] = rows(model, true)
        except BadInput as error:
            outcome[motion] = {}
            outcome["refused"] = str(error)
    return outcome


def rows(model: Model, true: dict[str, float]) -> dict[str, Any]:
    """Sample; return error in sds, coverage and sd of each number with verdict ``data``."""
    start = model.starting_point()
    sampling = model.config.tables.sampling.model_copy(update={"seed": 1, "min_ess": 1000.0})
    result = fit(start.target, sampling, estimates=start.estimates)
    summary = summarise(result, model.references, start.choice, groups(result))
    return {
        key: [
            (row.mean - true[key]) / row.sd,
            bool(row.interval[0] <= true[key] <= row.interval[1]),
            row.sd,
        ]
        for key, row in summary.rows.items()
        if key in true and "efficiency" not in key and row.verdict == "data"
    }


def judged(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Summarise one case by motion and number."""
    summary: dict[str, Any] = {
        "recordings": len(runs),
        "refused": sum("refused" in run for run in runs),
        "seconds": float(np.median([run["seconds"] for run in runs])),
    }
    for motion in MOTIONS:
        names = dict.fromkeys(key for run in runs for key in run[motion])
        numbers = {}
        for key in names:
            pairs = [
                (run[motion][key], run["exact"].get(key)) for run in runs if key in run[motion]
            ]
            z = np.array([row[0] for row, _ in pairs])
            widths = [row[2] / other[2] for row, other in pairs if other]
            numbers[key] = {
                "intervals": len(z),
                "coverage": float(np.mean([row[1] for row, _ in pairs])),
                "z": float(z.mean()),
                "z_rms": float(np.sqrt(np.mean(z**2))),
                "width": float(np.median(widths)) if widths else None,
            }
        shares = [np.mean([row[1] for row in run[motion].values()]) for run in runs if run[motion]]
        held = [row[1] for run in runs for row in run[motion].values()]
        spread = [row[0] ** 2 for run in runs for row in run[motion].values()]
        summary[motion] = {
            "coverage": float(np.mean(held)),
            "error": float(np.std(shares) / np.sqrt(len(shares))),
            "z_rms": float(np.sqrt(np.mean(spread))),
            "numbers": numbers,
        }
    return summary


def table(result: dict[str, Any], least: int = 30) -> Iterator[str]:
    """Yield lines of coverage and errors; the worst number has the largest rms z."""
    yield (
        "| bench | motion | coverage of 90 % intervals | rms z | "
        "worst number: mean z, rms z, the ceiling's | largest mean z | width over exact |"
    )
    yield "|---|---|---|---|---|---|---|"
    for case, runs in result.items():
        exact_rows = runs["exact"]["numbers"]
        for motion in MOTIONS:
            rows = {k: v for k, v in runs[motion]["numbers"].items() if v["intervals"] >= least}
            worst = max(rows, key=lambda k: rows[k]["z_rms"])
            biased = max(rows, key=lambda k: abs(rows[k]["z"]))
            row = rows[worst]
            exact = f"{exact_rows[worst]['z_rms']:.2f}" if worst in exact_rows else "–"
            width = np.median([v["width"] for v in rows.values() if v["width"]])
            yield (
                f"| {case} | {motion} "
                f"| {runs[motion]['coverage']:.1%} ± {runs[motion]['error']:.1%} "
                f"| {runs[motion]['z_rms']:.2f} "
                f"| `{worst}` {row['z']:+.2f}, {row['z_rms']:.2f}, {exact} "
                f"| `{biased}` {rows[biased]['z']:+.2f} | {width:.2f} |"
            )


def main() -> None:
    """Run all cases and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--recordings", type=int, default=100)
    parser.add_argument("--cases", nargs="*", default=BENCHES)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--to", type=Path, default=FOLDER / "motion.json")
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    result = json.loads(options.to.read_text(encoding="utf-8")) if options.to.exists() else {}
    if not options.table:
        with ProcessPoolExecutor(options.workers) as pool:
            for case in options.cases:
                tasks = [(case, n) for n in range(options.recordings)]
                result[case] = judged(list(pool.map(run_case, tasks)))
                text = json.dumps(result, indent=1) + "\n"
                options.to.write_text(text, encoding="utf-8")
                print("\n".join(table({case: result[case]}, min(30, len(tasks)))), flush=True)
    else:
        print("\n".join(table(result)))


if __name__ == "__main__":
    main()
