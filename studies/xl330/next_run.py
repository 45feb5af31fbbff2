"""Test the interval for the next run on sixteen MEASURED runs of the XL330.

``python studies/xl330/next_run.py`` fits every run separately, pools all but one in turn, and
checks whether the interval for the next recording holds the run left out. Writes
``next_run.json``.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric import Model
from bayesfric.problem.config import parse_config
from bayesfric.report.comparison.between_runs import RunDraws, between_runs
from bayesfric.report.summary.record import Summary

FOLDER = Path(__file__).resolve().parent
DATA = FOLDER.parents[2] / "shared" / "data" / "xl330-pendulum"


def fitted(name: str) -> tuple[Summary, RunDraws]:
    """Fit one run with the default noise model and without the calibration check."""
    text = (FOLDER / "xl330.toml").read_text(encoding="utf-8").replace("*.json", name)
    text = re.sub(r"\[noise\].*?(?=\n\[)", "[self_check]\nrecordings = 0\n", text, flags=re.S)
    result = Model.from_config(parse_config(text, FOLDER / "xl330.toml")).fit()
    posterior = result.fit.posterior
    flat, rng = posterior.flat(4000), np.random.default_rng(1)
    drawn = {n: p.draw(2000, rng) for n, p in zip(posterior.names, posterior.priors, strict=True)}
    values = {n: flat[:, j] for j, n in enumerate(posterior.names)}
    return result.summary, (values, drawn)


def left_out(runs: dict[str, tuple[Summary, RunDraws]]) -> dict[str, list[dict[str, Any]]]:
    """Pool all runs but one, for each quantity that the excluded run determines."""
    intervals: dict[str, list[dict[str, Any]]] = {}
    for excluded, (summary, _) in runs.items():
        rest = {name: run for name, run in runs.items() if name != excluded}
        pooled = between_runs(
            {name: run[0] for name, run in rest.items()},
            {name: run[1] for name, run in rest.items()},
        )
        for quantity in pooled:
            row = summary.rows.get(quantity.name)
            if row is None or quantity.name.startswith("total"):
                continue
            if row.verdict == "data" or row.doubted:
                # the excluded run has an uncertainty, too
                predicted, half = (
                    quantity.pool.following,
                    0.5 * (row.reported.high - row.reported.low),
                )
                low = predicted.median - np.hypot(predicted.median - predicted.low, half)
                high = predicted.median + np.hypot(predicted.high - predicted.median, half)
                intervals.setdefault(quantity.name, []).append(
                    {
                        "run": excluded,
                        "value": row.middle,
                        "next": [predicted.low, predicted.high],
                        "holds": bool(low <= row.middle <= high),
                    }
                )
    return intervals


def main() -> None:
    """Pool the runs and print a row for each quantity."""
    runs = {path.stem: fitted(path.name) for path in sorted(DATA.glob("*.json"))}
    pooled = between_runs(
        {n: s for n, (s, _) in runs.items()}, {n: d for n, (_, d) in runs.items()}
    )
    intervals = left_out(runs)
    result = {
        quantity.name: {
            "runs": len(quantity.runs),
            "unit": quantity.row.unit,
            "mean": vars(quantity.pool.mean),
            "spread": vars(quantity.pool.spread),
            "next": vars(quantity.pool.following),
            "left_out": intervals.get(quantity.name, []),
        }
        for quantity in pooled
        if not quantity.name.startswith("total")
    }
    (FOLDER / "next_run.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    held = [test["holds"] for row in result.values() for test in row["left_out"]]
    for name, row in result.items():
        mean, following = row["mean"], row["next"]
        print(
            f"| {name} | {row['runs']} | {mean['median']:.4g} [{mean['low']:.4g}, "
            f"{mean['high']:.4g}] | {row['spread']['median']:.2g} | [{following['low']:.4g}, "
            f"{following['high']:.4g}] | {sum(test['holds'] for test in row['left_out'])} of "
            f"{len(row['left_out'])} |"
        )
    print(f"intervals for the next run hold {sum(held)} of {len(held)}")


if __name__ == "__main__":
    main()
