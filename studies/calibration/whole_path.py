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
                # with room for the model's error, where a fit sees any: these models are right
                "shown": row.told_interval,
                "wider": row.told_sd / row.sd,
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


def judged(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Sum one case up: how often intervals hold the truth, by verdict and quantity."""
    kept = [one for one in found if "rows" in one]
    verdicts: dict[str, dict[str, Any]] = {}
    for verdict in ("data", "weak"):
        names = dict.fromkeys(
            key for one in kept for key, row in one["rows"].items() if row["verdict"] == verdict
        )
        rows = {
            name: [
                row for one in kept if (row := one["rows"].get(name)) and row["verdict"] == verdict
            ]
            for name in names
        }
        verdicts[verdict] = {name: _quantity(some) for name, some in rows.items()}
        # quantities of one recording err together: the error is that of recordings
        shares = [
            np.mean([_holds(r) for r in one["rows"].values() if r["verdict"] == verdict])
            for one in kept
            if any(r["verdict"] == verdict for r in one["rows"].values())
        ]
        if shares:
            verdicts[verdict]["all"] = {
                "intervals": sum(len(some) for some in rows.values()),
                "coverage": float(np.mean([_holds(r) for some in rows.values() for r in some])),
                "error": float(np.std(shares) / np.sqrt(len(shares))),
            }
    return {
        "recordings": len(found),
        "refused": [one["refused"] for one in found if "refused" in one],
        "reliable": sum(one["status"] == "reliable" for one in kept),
        "doubted": sum(bool(one["doubts"]) for one in kept),
        "stuck": float(np.mean([one["stuck"] for one in kept])),
        "seconds": [float(np.median(x)) for x in ([one["seconds"] for one in kept],)]
        + [max(one["seconds"] for one in kept)],
        "verdicts": verdicts,
    }


def _holds(row: dict[str, Any]) -> bool:
    return bool(row["interval"][0] <= row["truth"] <= row["interval"][1])


def _quantity(rows: list[dict[str, Any]]) -> dict[str, Any]:
    z = np.array([(row["mean"] - row["truth"]) / row["sd"] for row in rows])
    out = {
        "intervals": len(rows),
        "coverage": float(np.mean([_holds(row) for row in rows])),
        "z": float(z.mean()),
        "z_sd": float(z.std()),
        "z_largest": float(np.abs(z).max()),
    }
    out["shown"] = {
        "coverage": float(np.mean([_holds({**row, "interval": row["shown"]}) for row in rows])),
        "wider": float(np.mean([row["wider"] for row in rows])),
    }
    if checked := [row for row in rows if row["self_check"]]:
        told = [row["self_check"] for row in checked]
        # what is not corrected stays as it is
        after = [
            {**row, "interval": row["self_check"].get("corrected_interval") or row["interval"]}
            for row in checked
        ]
        out["foretold"] = {
            "z": float(np.mean([one["bias"] for one in told])),
            "coverage": float(np.mean([one["coverage"] for one in told])),
            "corrected_coverage": float(np.mean([_holds(row) for row in after])),
        }
    return out


def table(case: str, result: dict[str, Any]) -> list[str]:
    """Say how a case did, a line for each quantity."""
    median, longest = result["seconds"]
    lines = [
        f"== {case}: {result['recordings']} recordings, {len(result['refused'])} refused, "
        f"{result['reliable']} reliable; sticks {result['stuck']:.0%}; "
        f"median {median:.1f} s, longest {longest:.0f} s"
    ]
    for verdict, rows in result["verdicts"].items():
        for name, row in rows.items():
            line = f"   {verdict:5} {name:32} {row['coverage']:6.1%} of {row['intervals']:4}"
            if "z" in row:
                line += f"  z {row['z']:+.2f} +- {row['z_sd']:.2f}, largest {row['z_largest']:.1f}"
            else:
                line += f"  +- {row['error']:.1%}"
            if shown := row.get("shown"):
                line += f" | shown {shown['coverage']:.0%}, {shown['wider']:.2f} times as wide"
            if told := row.get("foretold"):
                line += f" | foretold z {told['z']:+.2f}, {told['coverage']:.0%}"
                line += f" | corrected {told['corrected_coverage']:.0%}"
            lines.append(line)
    return lines


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--cases", nargs="*", default=list(CASES))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--to", type=Path, default=HERE / "whole_path.json")
    options = parser.parse_args()
    result = json.loads(options.to.read_text(encoding="utf-8")) if options.to.exists() else {}
    with ProcessPoolExecutor(options.workers) as pool:
        for case in options.cases:
            tasks = [(case, n) for n in range(options.recordings)]
            result[case] = judged(list(pool.map(one, tasks)))
            text = json.dumps(result, indent=1) + "\n"
            options.to.write_text(text, encoding="utf-8")
            print("\n".join(table(case, result[case])), flush=True)


if __name__ == "__main__":
    main()
