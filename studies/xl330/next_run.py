"""Does the population of runs hold the next one? MEASURED: sixteen runs of the XL330.

``python studies/xl330/next_run.py`` fits every run by itself, pools all but one in turn, and asks
whether the interval for the next recording holds what the one left out says. Writes
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

HERE = Path(__file__).resolve().parent
DATA = HERE.parents[2] / "shared" / "data" / "xl330-pendulum"


def fitted(name: str) -> tuple[Summary, RunDraws]:
    """Fit one run with the noise chosen by its residuals, nothing simulated."""
    text = (HERE / "xl330.toml").read_text(encoding="utf-8").replace("*.json", name)
    text = re.sub(r"\[noise\].*?(?=\n\[)", "[self_check]\nrecordings = 0\n", text, flags=re.S)
    result = Model.from_config(parse_config(text, HERE / "xl330.toml")).fit()
    posterior = result.fit.posterior
    flat, rng = posterior.flat(4000), np.random.default_rng(1)
    drawn = {n: p.draw(2000, rng) for n, p in zip(posterior.names, posterior.priors, strict=True)}
    values = {n: flat[:, j] for j, n in enumerate(posterior.names)}
    return result.summary, RunDraws(values, drawn)


def left_out(runs: dict[str, tuple[Summary, RunDraws]]) -> dict[str, list[dict[str, Any]]]:
    """Pool all runs but one, for each quantity that one determines itself."""
    found: dict[str, list[dict[str, Any]]] = {}
    for out, (summary, _) in runs.items():
        others = {name: one for name, one in runs.items() if name != out}
        pooled = between_runs(
            {name: one[0] for name, one in others.items()},
            {name: one[1] for name, one in others.items()},
        )
        for one in pooled:
            row = summary.rows.get(one.name)
            if row is None or one.name.startswith("total"):
                continue
            if row.verdict == "data" or row.doubted:
                # the run is not known exactly either
                middle, half = one.pool.following, 0.5 * (row.printed.high - row.printed.low)
                low = middle.median - np.hypot(middle.median - middle.low, half)
                high = middle.median + np.hypot(middle.high - middle.median, half)
                found.setdefault(one.name, []).append(
                    {
                        "run": out,
                        "value": row.middle,
                        "next": [middle.low, middle.high],
                        "holds": bool(low <= row.middle <= high),
                    }
                )
    return found


def main() -> None:
    runs = {path.stem: fitted(path.name) for path in sorted(DATA.glob("*.json"))}
    every = between_runs({n: s for n, (s, _) in runs.items()}, {n: d for n, (_, d) in runs.items()})
    found = left_out(runs)
    result = {
        one.name: {
            "runs": len(one.runs),
            "unit": one.row.unit,
            "mean": vars(one.pool.mean),
            "spread": vars(one.pool.spread),
            "next": vars(one.pool.following),
            "left_out": found.get(one.name, []),
        }
        for one in every
        if not one.name.startswith("total")
    }
    (HERE / "next_run.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    held = [one["holds"] for row in result.values() for one in row["left_out"]]
    for name, row in result.items():
        mean, following = row["mean"], row["next"]
        print(
            f"| {name} | {row['runs']} | {mean['median']:.4g} [{mean['low']:.4g}, "
            f"{mean['high']:.4g}] | {row['spread']['median']:.2g} | [{following['low']:.4g}, "
            f"{following['high']:.4g}] | {sum(one['holds'] for one in row['left_out'])} of "
            f"{len(row['left_out'])} |"
        )
    print(f"intervals for the next run hold {sum(held)} of {len(held)}")


if __name__ == "__main__":
    main()
