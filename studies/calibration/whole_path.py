"""Do intervals hold on the path that users take? SIMULATED benches, from file to summary.

``python studies/calibration/whole_path.py`` makes recordings as files (:mod:`bench`), fits each
with default settings, and counts how often the intervals hold the truth. Writes
``whole_path.json``; ``--recordings N`` and ``--cases A B`` for less.
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
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from bench import CASES, recorded

from bayesfric import Model
from bayesfric.errors import BadInput
from bayesfric.mechanism.derived import derive

HERE = Path(__file__).resolve().parent
SEED = 2026


def one(task: tuple[str, int]) -> dict[str, Any]:
    """Fit one recording, and say of every quantity where the truth lies."""
    name, number = task
    bench = CASES[name]
    seed = np.random.SeedSequence(SEED, spawn_key=(list(CASES).index(name), number))
    rng = np.random.default_rng(seed)
    with TemporaryDirectory() as folder:
        truth, recordings, stuck = recorded(bench, rng, Path(folder))
        begun = time.perf_counter()
        try:
            model = Model(bench.joint, recordings, **bench.tables)
            summary = model.fit(seed=1).summary
        except BadInput as error:
            return {"case": name, "number": number, "refused": str(error)}
    values = np.array([[truth[n] for n in bench.joint.names]])
    true = {**truth, **{q.name: float(q.values[0]) for q in derive(bench.joint, values, 1.0)}}
    rows = {}
    checked = summary.self_check.rows if summary.self_check else {}
    for key, row in summary.rows.items():
        if key in true and "efficiency" not in key:
            low, high = row.interval
            rows[key] = {
                "truth": true[key],
                "mean": row.mean,
                "sd": row.sd,
                "interval": [low, high],
                "verdict": row.verdict,
                "gauge_free": row.gauge_free,
                "self_check": checked[key].as_dict() if key in checked else None,
            }
    return {
        "case": name,
        "number": number,
        "stuck": stuck,
        "seconds": round(time.perf_counter() - begun, 2),
        "status": summary.sampler.status,
        "noise": summary.noise.order,
        "self_check_seconds": summary.self_check.seconds if summary.self_check else None,
        "warnings": list(summary.warnings),
        "doubts": [d.kind for d in summary.doubts],
        "rows": rows,
    }


def foretold(rows: list[dict[str, Any]]) -> str:
    """Say what the self-checks foretold of one quantity, and how corrected intervals did."""
    checked = [row for row in rows if row["self_check"]]
    if not checked:
        return ""
    bias = np.mean([row["self_check"]["bias"] for row in checked])
    coverage = np.mean([row["self_check"]["coverage"] for row in checked])
    hit, z = [], []
    for row in checked:
        # what is not corrected stays as it is
        low, high = row["self_check"].get("corrected_interval") or row["interval"]
        hit.append(low <= row["truth"] <= high)
        width = (row["interval"][1] - row["interval"][0]) / (2.0 * 1.645)
        z.append(((low + high) / 2.0 - row["truth"]) / width)
    return (
        f" | self-check z {bias:+.2f}, {coverage:.0%} | corrected z {np.mean(z):+.2f}, "
        f"{np.mean(hit):.0%}"
    )


def table(found: list[dict[str, Any]]) -> list[str]:
    """Say how each case did, a line for each quantity."""
    lines = []
    for case in dict.fromkeys(one["case"] for one in found):
        runs = [one for one in found if one["case"] == case]
        kept = [one for one in runs if "rows" in one]
        seconds = [one["seconds"] for one in kept]
        statuses = [one["status"] for one in kept]
        stuck = np.mean([one["stuck"] for one in kept])
        lines.append(
            f"== {case}: {len(runs)} recordings, {len(runs) - len(kept)} refused, "
            f"{statuses.count('reliable')} reliable; sticks {stuck:.0%}; "
            f"median {np.median(seconds):.1f} s, longest {max(seconds):.0f} s"
        )
        for verdict in ("data", "weak", "prior"):
            hits, told = [], []
            for key in kept[0]["rows"]:
                rows = [one["rows"][key] for one in kept if key in one["rows"]]
                rows = [row for row in rows if row["verdict"] == verdict]
                if not rows:
                    continue
                hit = [r["interval"][0] <= r["truth"] <= r["interval"][1] for r in rows]
                z = [(r["mean"] - r["truth"]) / r["sd"] for r in rows]
                hits += hit
                told += [r["self_check"]["coverage"] for r in rows if r["self_check"]]
                lines.append(
                    f"   {verdict:6}{key:32} {np.mean(hit):6.0%} of {len(hit):3}  "
                    f"z {np.mean(z):+.2f} +- {np.std(z):.2f}, largest {np.max(np.abs(z)):.1f}"
                    + foretold(rows)
                )
            if hits:
                lines.append(f"   {verdict:6}all {np.mean(hits):.1%} of {len(hits)}")
            if told:
                lines.append(f"   {verdict:6}all, as the self-checks foretold {np.mean(told):.1%}")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--cases", nargs="*", default=list(CASES))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--to", type=Path, default=HERE / "whole_path.json")
    options = parser.parse_args()
    tasks = [(name, n) for name in options.cases for n in range(options.recordings)]
    with ProcessPoolExecutor(options.workers) as pool:
        found = list(pool.map(one, tasks))
    options.to.write_text(json.dumps(found) + "\n", encoding="utf-8")
    print("\n".join(table(found)))


if __name__ == "__main__":
    main()
