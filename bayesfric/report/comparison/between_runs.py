"""Pool several runs by what each reports: their population, and the next recording."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayesfric.mechanism.quantities import QUANTITIES, quantity_of
from bayesfric.population.population import Population, population
from bayesfric.report.summary.record import PosteriorRow, Summary, first_angles, of_noise, unwrapped


def shared_quantities(runs: Mapping[str, Summary]) -> dict[str, dict[str, PosteriorRow]]:
    """Give the rows by run of each quantity that the data of two runs determine.

    Also of what is doubted for other reasons than its prior; of a number on its bound the data give
    a limit only, which cannot be pooled.
    """
    angles = first_angles(summary.parameters for summary in runs.values())
    shared: dict[str, dict[str, PosteriorRow]] = {}
    for run, summary in runs.items():
        if summary.sampler.status == "unusable":
            continue
        for name, row in summary.rows.items():
            determined = row.at_bound is None and (row.undoubted or row.verdict) == "data"
            if determined and row.sd and row.converged and not of_noise(name):
                shared.setdefault(name, {})[run] = unwrapped(row, angles.get(name))
    return {name: rows for name, rows in shared.items() if len(rows) > 1}


def pooled(name: str, rows: Mapping[str, PosteriorRow]) -> Population:
    """Give the population of one quantity, by mean and printed sd of each run."""
    quantity = QUANTITIES.get(quantity_of(name))
    means, sds = zip(*((row.mean, row.reported.sd) for row in rows.values()), strict=True)
    level = next(iter(rows.values())).level
    return population(means, sds, level, lower=-np.inf if quantity is None else quantity.lower)


def between_runs(runs: Mapping[str, Summary]) -> list[dict[str, Any]]:
    """Tabulate populations of runs on different recordings, a row for each quantity.

    Not of what another motion changes: runs of one joint may differ in it.
    """
    table = []
    for name, rows in shared_quantities(runs).items():
        if any(row.of_motion for row in rows.values()):
            continue
        row, pool = next(iter(rows.values())), pooled(name, rows)
        line: dict[str, Any] = {"name": name, "unit": row.unit, "symbol": row.symbol}
        line |= {"meaning": row.meaning, "runs": len(rows), "level": row.level}
        line["doubted"] = sum(bool(row.doubted) for row in rows.values())
        for key in ("mean", "spread", "following"):
            for end, x in vars(getattr(pool, key)).items():
                line[key if end == "median" else f"{key}_{end}"] = x
        table.append(line | {"q": pool.q, "p_value": pool.p_value, "agree": pool.agree})
    return table
