"""Pool several runs by their draws: the population, and the next recording."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.base.safe_read import open_hdf5, read_array
from bayesfric.mechanism.quantities import QUANTITIES, quantity_of
from bayesfric.population.population import (
    Interval,
    Likelihood,
    Population,
    likelihood,
    normal,
    population,
)
from bayesfric.recordings.arrays import Array
from bayesfric.report.summary.record import PosteriorRow, Summary, first_angles, of_noise, unwrapped
from bayesfric.report.words import csv_text

# Draws `(n,)` of a run's quantities by name, and of its parameters' priors.
RunDraws = tuple[Mapping[str, Array], Mapping[str, Array]]


def read_draws(run: Path, summary: Summary) -> RunDraws:
    """Read the draws of the quantities in a run's summary; none where there are none to read.

    Those with model discrepancy where the run holds such, as its tables do. Totals of least squares
    need the recordings and are never among them.
    """
    names = [name for name, row in summary.rows.items() if row.gauge_free is not False]
    try:
        with open_hdf5(run / "posterior.nc") as file:
            groups = ("widened",) if "widened" in file else ("posterior", "derived")
            stored = [file[group] for group in groups if group in file]
            draws = {
                name: _flat(group[name]) for group in stored for name in names if name in group
            }
            stored_prior = file.get("prior", {})
            prior = {name: _flat(stored_prior[name]) for name in draws if name in stored_prior}
    except BadInput:
        return {}, {}
    return {name: x for name, x in draws.items() if np.isfinite(x).any()}, prior


def _flat(stored: Any) -> Array:
    """Flatten chains and draws of a data set, evenly thinned to what an interval needs."""
    x = np.asarray(read_array(stored), dtype=np.float64).ravel()
    return x[:: max(1, -(-x.size // 200_000))]


@dataclass(frozen=True)
class SharedQuantity:
    """One quantity in several runs, each separately."""

    name: str
    runs: Mapping[str, PosteriorRow]
    likelihoods: Mapping[str, Likelihood]

    @property
    def row(self) -> PosteriorRow:
        """That of the first run, for unit, symbol, meaning, level."""
        return next(iter(self.runs.values()))

    @property
    def doubted(self) -> int:
        """In how many runs it is doubted."""
        return sum(bool(row.doubted) for row in self.runs.values())

    @cached_property
    def pool(self) -> Population:
        """The population that the runs are drawn from, cut at the quantity's bound."""
        pool = population(list(self.likelihoods.values()), self.row.level)
        row = QUANTITIES.get(quantity_of(self.name))
        least = -np.inf if row is None else row.lower
        # the normal model puts ends where the quantity cannot be; cut they hold the same
        mean, following = (
            Interval(**{end: max(x, least) for end, x in vars(interval).items()})
            for interval in (pool.mean, pool.following)
        )
        return replace(pool, mean=mean, following=following)


def between_runs(
    runs: Mapping[str, Summary], draws: Mapping[str, RunDraws] | None = None
) -> list[SharedQuantity]:
    """Give the quantities of runs on different recordings that can be pooled.

    Not what another motion changes: runs of one joint may differ in it.
    """
    return [
        quantity
        for quantity in shared_quantities(runs, draws)
        if not any(row.of_motion for row in quantity.runs.values())
    ]


def shared_quantities(
    runs: Mapping[str, Summary], draws: Mapping[str, RunDraws] | None = None
) -> Iterator[SharedQuantity]:
    """Give every quantity that the data of two runs determine, with each run's likelihood.

    By the runs' ``draws`` where there are any, else as if posteriors were normal. A run whose prior
    matters counts by its draws over those of its prior, or not at all: one prior would count
    several times.
    """
    angles = first_angles(summary.parameters for summary in runs.values())
    tables = {
        run: {n: unwrapped(row, angles.get(n)) for n, row in summary.rows.items()}
        for run, summary in runs.items()
        if summary.sampler.status != "unusable"
    }
    if len(tables) < 2:
        return
    for name in dict.fromkeys(name for table in tables.values() for name in table):
        rows = {
            run: row
            for run, table in tables.items()
            if (row := table.get(name)) and row.sd and row.converged
        }
        if of_noise(name) or sum(map(_determined, rows.values())) < 2:
            continue
        likelihoods = {
            run: _likelihood(name, row, runs[run].rows[name], (draws or {}).get(run))
            for run, row in rows.items()
        }
        usable = {run: x for run, x in likelihoods.items() if x is not None}
        yield SharedQuantity(name, {run: rows[run] for run in usable}, usable)


def _determined(row: PosteriorRow) -> bool:
    """Whether the data determine it: also what is doubted, for other reasons than its prior.

    Of a number on its bound they give a limit only, which cannot be pooled.
    """
    return row.at_bound is None and (row.undoubted or row.verdict) == "data"


def _likelihood(
    name: str, row: PosteriorRow, stored: PosteriorRow, draws: RunDraws | None
) -> Likelihood | None:
    """Give a run's likelihood; an angle's draws follow its row to the others' turn."""
    values, prior = (table.get(name) for table in draws or ({}, {}))
    if not _determined(row) and (row.verdict == "prior" or values is None or prior is None):
        return None
    if values is None:
        return normal(row.mean, row.reported.sd)
    by = row.middle - stored.middle
    return likelihood(values + by, row.reported.sd, None if prior is None else prior + by)


def between_runs_csv(pooled: Sequence[SharedQuantity]) -> str:
    """Write pooled values as CSV, every number in full."""
    lines = []
    for quantity in pooled:
        row, pool = quantity.row, quantity.pool
        line: dict[str, Any] = {"name": quantity.name, "unit": row.unit, "runs": len(quantity.runs)}
        line |= {"doubted": quantity.doubted, "level": row.level}
        for key in ("mean", "spread", "following"):
            for end, x in vars(getattr(pool, key)).items():
                line[key if end == "median" else f"{key}_{end}"] = x
        lines.append(line | {"q": pool.q, "p_value": pool.p_value, "agree": pool.agree})
    return csv_text(lines, list(lines[0]) if lines else ["name"])
