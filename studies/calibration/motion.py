"""Which motion are a model's columns made of? SIMULATED benches, from file to posterior.

``python studies/calibration/motion.py`` fits the recordings of :mod:`bench` with three motions:
the ``encoder``'s, low-passed; ``refined`` by the model, as ``fit`` takes it; and the ``exact`` one,
which no encoder tells, behind the same filters. What is counted are posteriors as sampled: no
self-check, no room for the model's error. Writes ``motion.json``; ``--recordings N`` and
``--cases A B`` for less, ``--table`` prints what is there.
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
from bayesfric.problem.problem import starting_point
from bayesfric.recordings.observation import with_motion
from bayesfric.report.summary.derived_quantities import groups
from bayesfric.report.summary.summary import summarise

HERE = Path(__file__).resolve().parent
SEED = 37
MOTIONS = ("encoder", "refined", "exact")
BENCHES = [
    "plain", "slow", "geared", "plain, 100 Hz", "plain, 1 kHz", "geared, encoder at the joint",
    "sticking", "current", "knee", "knee, loaded pair", "late by 0.3 samples",
]  # fmt: skip


def one(task: tuple[str, int]) -> dict[str, Any]:
    """Fit one recording with each motion, and say of every quantity where the truth lies."""
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
            nothing: dict[str, Any] = {way: {} for way in MOTIONS}
            return {"case": name, "refused": str(error), "seconds": 0.0} | nothing
        prepared = time.process_time() - begun
    pairs = zip(model.recordings, model.encoder, motions, strict=True)
    known = [with_motion(o, r, *(x[: o.q.size] for x in m)) for r, o, m in pairs]
    ways = dict(zip(MOTIONS, (model.encoder, model.observations, known), strict=True))
    values = np.array([[truth[n] for n in bench.joint.names]])
    true = {**truth, **{q.name: float(q.values[0]) for q in derive(bench.joint, values, 1.0)}}
    found: dict[str, Any] = {"case": name, "number": number, "seconds": prepared}
    for way, observations in ways.items():
        model.observations, model._estimates = observations, {}  # those made are of others
        try:
            found[way] = rows(model, true)
        except BadInput as error:
            found[way] = {}
            found["refused"] = str(error)
    return found


def rows(model: Model, true: dict[str, float]) -> dict[str, Any]:
    """Sample, and give what is determined: error in sds, whether the interval holds, and sd."""
    begun = starting_point(model)
    sampling = model.config.tables.sampling.model_copy(update={"seed": 1, "min_ess": 1000.0})
    found = fit(begun.target, sampling, estimates=begun.estimates)
    summary = summarise(found, model.references(), begun.choice, groups(found))
    return {
        key: [
            (row.mean - true[key]) / row.sd,
            bool(row.interval[0] <= true[key] <= row.interval[1]),
            row.sd,
        ]
        for key, row in summary.rows.items()
        if key in true and "efficiency" not in key and row.verdict == "data"
    }


def judged(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Sum one case up, by motion and number."""
    out: dict[str, Any] = {
        "recordings": len(found),
        "refused": sum("refused" in one for one in found),
        "seconds": float(np.median([one["seconds"] for one in found])),
    }
    for way in MOTIONS:
        names = dict.fromkeys(key for one in found for key in one[way])
        numbers = {}
        for key in names:
            both = [(one[way][key], one["exact"].get(key)) for one in found if key in one[way]]
            z = np.array([row[0] for row, _ in both])
            wide = [row[2] / other[2] for row, other in both if other]
            numbers[key] = {
                "intervals": len(z),
                "coverage": float(np.mean([row[1] for row, _ in both])),
                "z": float(z.mean()),
                "z_rms": float(np.sqrt(np.mean(z**2))),
                "width": float(np.median(wide)) if wide else None,
            }
        shares = [np.mean([row[1] for row in one[way].values()]) for one in found if one[way]]
        held = [row[1] for one in found for row in one[way].values()]
        spread = [row[0] ** 2 for one in found for row in one[way].values()]
        out[way] = {
            "coverage": float(np.mean(held)),
            "error": float(np.std(shares) / np.sqrt(len(shares))),
            "z_rms": float(np.sqrt(np.mean(spread))),
            "numbers": numbers,
        }
    return out


def table(result: dict[str, Any], least: int = 30) -> Iterator[str]:
    """Print coverage and errors; the worst number is that with the largest rms."""
    yield (
        "| bench | motion | coverage of 90 % intervals | rms z | "
        "worst number: mean z, rms z, the ceiling's | largest mean z | width over exact |"
    )
    yield "|---|---|---|---|---|---|---|"
    for case, one in result.items():
        ceiling = one["exact"]["numbers"]
        for way in MOTIONS:
            some = {k: v for k, v in one[way]["numbers"].items() if v["intervals"] >= least}
            worst = max(some, key=lambda k: some[k]["z_rms"])
            off = max(some, key=lambda k: abs(some[k]["z"]))
            w = some[worst]
            exact = f"{ceiling[worst]['z_rms']:.2f}" if worst in ceiling else "–"
            wide = np.median([v["width"] for v in some.values() if v["width"]])
            yield (
                f"| {case} | {way} | {one[way]['coverage']:.1%} ± {one[way]['error']:.1%} "
                f"| {one[way]['z_rms']:.2f} | `{worst}` {w['z']:+.2f}, {w['z_rms']:.2f}, {exact} "
                f"| `{off}` {some[off]['z']:+.2f} | {wide:.2f} |"
            )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--recordings", type=int, default=100)
    parser.add_argument("--cases", nargs="*", default=BENCHES)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--to", type=Path, default=HERE / "motion.json")
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    result = json.loads(options.to.read_text(encoding="utf-8")) if options.to.exists() else {}
    if not options.table:
        with ProcessPoolExecutor(options.workers) as pool:
            for case in options.cases:
                tasks = [(case, n) for n in range(options.recordings)]
                result[case] = judged(list(pool.map(one, tasks)))
                text = json.dumps(result, indent=1) + "\n"
                options.to.write_text(text, encoding="utf-8")
                print("\n".join(table({case: result[case]}, min(30, len(tasks)))), flush=True)
    else:
        print("\n".join(table(result)))


if __name__ == "__main__":
    main()
