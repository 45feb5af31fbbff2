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
from bayesfric.report.comparison.between_runs import between_runs
from bayesfric.report.summary.record import Summary

FOLDER = Path(__file__).resolve().parent
DATA = FOLDER.parents[2] / "shared" / "data" / "xl330-pendulum"


def fitted(name: str) -> Summary:
    """Fit one run with the default noise model and without the calibration check."""
    text = (FOLDER / "xl330.toml").read_text(encoding="utf-8").replace("*.json", name)
    text = re.sub(r"\[noise\].*?(?=\n\[)", "[self_check]\nrecordings = 0\n", text, flags=re.S)
    return Model.from_config(parse_config(text, FOLDER / "xl330.toml")).fit().summary


def left_out(runs: dict[str, Summary]) -> dict[str, list[dict[str, Any]]]:
    """Pool all runs but one, for each quantity that the excluded run determines."""
    intervals: dict[str, list[dict[str, Any]]] = {}
    for excluded, summary in runs.items():
        rest = {name: run for name, run in runs.items() if name != excluded}
        for line in between_runs(rest):
            row = summary.rows.get(line["name"])
            if row is None or line["name"].startswith("total"):
                continue
            if row.verdict == "data" or row.doubted:
                # the excluded run has an uncertainty, too
                median, half = line["following"], 0.5 * (row.reported.high - row.reported.low)
                ends = [line["following_low"], line["following_high"]]
                low = median - np.hypot(median - ends[0], half)
                high = median + np.hypot(ends[1] - median, half)
                intervals.setdefault(line["name"], []).append(
                    {
                        "run": excluded,
                        "value": row.middle,
                        "next": ends,
                        "holds": bool(low <= row.middle <= high),
                    }
                )
    return intervals


def main() -> None:
    """Pool the runs and print a row for each quantity."""
    runs = {path.stem: fitted(path.name) for path in sorted(DATA.glob("*.json"))}
    intervals = left_out(runs)
    result = {
        line["name"]: {
            "runs": line["runs"],
            "unit": line["unit"],
            **{
                name: {"median": line[key], "low": line[f"{key}_low"], "high": line[f"{key}_high"]}
                for name, key in {"mean": "mean", "spread": "spread", "next": "following"}.items()
            },
            "left_out": intervals.get(line["name"], []),
        }
        for line in between_runs(runs)
        if not line["name"].startswith("total")
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
