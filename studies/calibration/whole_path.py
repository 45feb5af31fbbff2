"""Measure the coverage of intervals from file to summary, on SIMULATED benches.

``python studies/calibration/whole_path.py`` writes recordings as files (:mod:`bench`), fits each
with default settings, and counts how often the intervals hold the truth. Writes
``whole_path.json``; ``--recordings N``, ``--cases A B`` for less, ``--seed N`` for others.
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
from bayesfric.base.errors import BadInput
from bayesfric.mechanism.derived import derive
from bayesfric.results.reported import ORDER

FOLDER = Path(__file__).resolve().parent
SEED = 2027


def fit_one(task: tuple[int, str, int]) -> dict[str, Any]:
    """Fit one recording and compare every quantity with the truth."""
    seed, name, number = task
    bench = CASES[name]
    stream = np.random.SeedSequence(seed, spawn_key=(list(CASES).index(name), number))
    rng = np.random.default_rng(stream)
    with TemporaryDirectory() as folder:
        truth, recordings, stuck = recorded(bench, rng, Path(folder))
        start = time.process_time()
        try:
            model = Model(bench.joint, recordings, **bench.tables)
            summary = model.fit(seed=1).summary
        except BadInput as error:
            return {"case": name, "number": number, "refused": str(error)}
    values = np.array([[truth[n] for n in bench.joint.names]])
    true = {**truth, **{q.name: float(q.values[0]) for q in derive(bench.joint, values, 1.0)}}
    checks = summary.self_check["rows"] if summary.self_check else {}
    rows = {}
    for key, row in summary.rows.items():
        reported = row.reported
        if key not in true or "efficiency" in key:
            continue
        rows[key] = {
            "truth": true[key],
            "status": reported.status,
            "value": reported.value,
            "sd": reported.sd,
            "interval": reported.interval,
            # the posterior alone, and its bias by the calibration check
            "posterior": [row.middle, *row.interval, row.sd],
            "bias": checks[key]["bias"] if key in checks else None,
        }
    return {
        "case": name,
        "number": number,
        "stuck": stuck,
        "seconds": round(time.process_time() - start, 2),
        "status": summary.sampler.status,
        "findings": [finding.kind for finding in summary.findings],
        "outcome": summary.verdict.outcome,
        "rows": rows,
    }


def judged(outcomes: list[dict[str, Any]]) -> dict[str, Any]:
    """Summarise one case: coverage of the reported intervals, by status and quantity."""
    fits = [fit for fit in outcomes if "rows" in fit]
    statuses: dict[str, dict[str, Any]] = {}
    for status in ORDER:
        # errors of one recording's quantities are correlated: the standard error is over recordings
        rows_of_fits = [
            [row for row in fit["rows"].values() if row["status"] == status] for fit in fits
        ]
        shares = [np.mean([_held(row) for row in rows]) for rows in rows_of_fits if rows]
        if not shares:
            continue
        names = dict.fromkeys(key for fit in fits for key in fit["rows"])
        by_name = {
            name: [fit["rows"][name] for fit in fits if _status(fit, name) == status]
            for name in names
        }
        statuses[status] = {name: _quantity(rows) for name, rows in by_name.items() if rows}
        statuses[status]["all"] = {
            **_quantity([row for rows in rows_of_fits for row in rows]),
            "error": float(np.std(shares) / np.sqrt(len(shares))),
        }
    seconds = [fit["seconds"] for fit in fits]
    return {
        "recordings": len(outcomes),
        "refused": [fit["refused"] for fit in outcomes if "refused" in fit],
        "reliable": sum(fit["status"] == "reliable" for fit in fits),
        "findings": sum(bool(fit["findings"]) for fit in fits),
        "doubtful": sum(fit["outcome"] == "doubtful" for fit in fits),
        "stuck": float(np.mean([fit["stuck"] for fit in fits])),
        "cpu_seconds": [float(np.median(seconds)), max(seconds)],
        "statuses": statuses,
    }


def _status(fit: dict[str, Any], name: str) -> str | None:
    return fit["rows"][name]["status"] if name in fit["rows"] else None


def _held(row: dict[str, Any]) -> bool:
    return bool(row["interval"][0] <= row["truth"] <= row["interval"][1])


def _quantity(rows: list[dict[str, Any]]) -> dict[str, Any]:
    z = np.array([(row["value"] - row["truth"]) / row["sd"] for row in rows])
    plain = np.array([row["posterior"] for row in rows])  # value, low, high, sd
    truth, ends = (np.array([row[key] for row in rows]) for key in ("truth", "interval"))
    wider = (ends[:, 1] - ends[:, 0]) / (plain[:, 2] - plain[:, 1])
    summary = {
        "intervals": len(rows),
        "coverage": float(np.mean([_held(row) for row in rows])),
        "z": float(z.mean()),
        "z_sd": float(z.std()),
        "z_largest": float(np.abs(z).max()),
        "wider": [float(np.median(wider)), float(np.quantile(wider, 0.9))],
        "posterior_z": float(((plain[:, 0] - truth) / plain[:, 3]).mean()),
        "posterior_coverage": float(np.mean((plain[:, 1] <= truth) & (truth <= plain[:, 2]))),
    }
    if biases := [row["bias"] for row in rows if row["bias"] is not None]:
        summary["foretold"] = float(np.mean(biases))
    return summary


def table(case: str, result: dict[str, Any]) -> list[str]:
    """Return the lines of a case, one for each quantity."""
    median, longest = result["cpu_seconds"]
    lines = [
        f"== {case}: {result['recordings']} recordings, {len(result['refused'])} refused, "
        f"{result['reliable']} reliable, {result['findings']} with findings; "
        f"sticks {result['stuck']:.0%}; median {median:.1f} CPU s, longest {longest:.0f}"
    ]
    for status, rows in result["statuses"].items():
        for name, row in rows.items():
            lines.append(
                f"   {status:12} {name:32} {row['coverage']:6.1%} of {row['intervals']:4}  "
                f"z {row['z']:+.2f} sd {row['z_sd']:.2f}, largest {row['z_largest']:.1f}; "
                f"wider {row['wider'][0]:.2f}, {row['wider'][1]:.2f}; "
                f"posterior {row['posterior_coverage']:.0%}, z {row['posterior_z']:+.2f}, "
                f"predicted bias {row.get('foretold', 0.0):+.2f}"
            )
    return lines


def main() -> None:
    """Run all cases and print their lines."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--recordings", type=int, default=100)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--cases", nargs="*", default=list(CASES))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--to", type=Path, default=FOLDER / "whole_path.json")
    options = parser.parse_args()
    result = json.loads(options.to.read_text(encoding="utf-8")) if options.to.exists() else {}
    with ProcessPoolExecutor(options.workers) as pool:
        for case in options.cases:
            tasks = [(options.seed, case, n) for n in range(options.recordings)]
            result[case] = judged(list(pool.map(fit_one, tasks)))
            text = json.dumps(result, indent=1) + "\n"
            options.to.write_text(text, encoding="utf-8")
            print("\n".join(table(case, result[case])), flush=True)


if __name__ == "__main__":
    main()
