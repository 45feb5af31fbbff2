"""Pool several runs by their draws: the population, and the next recording."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.base.safe_read import open_hdf5, read_array
from bayesfric.mechanism.parameter import quantity_of
from bayesfric.mechanism.quantities import QUANTITIES
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

# Runs whose data determine a quantity, for a population.
_MIN_RUNS = 2
# More draws do not change an interval visibly.
_MAX_DRAWS = 200_000


@dataclass(frozen=True)
class RunDraws:
    """Draws of a run."""

    # `(n,)` draws in the quantity's unit, by its name: the sampled parameters and the derived
    # quantities that no scaling of leg parameters and alpha changes
    values: Mapping[str, Array] = field(default_factory=dict)
    # of the parameters' priors, `(m,)` each
    prior: Mapping[str, Array] = field(default_factory=dict)


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
        return RunDraws()
    return RunDraws({name: x for name, x in draws.items() if np.isfinite(x).any()}, prior)


def _flat(stored: Any) -> Array:
    """Flatten chains and draws of a data set, evenly thinned where there are many."""
    x = np.asarray(read_array(stored), dtype=np.float64).ravel()
    if x.size == 0:
        raise ValueError("no draws")
    return x[:: -(-x.size // _MAX_DRAWS)]


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


@dataclass(frozen=True)
class PooledQuantity(SharedQuantity):
    """One quantity that the data of two runs or more determine; ``runs`` are the rows pooled."""

    pool: Population


def between_runs(
    runs: Mapping[str, Summary], draws: Mapping[str, RunDraws] | None = None
) -> list[PooledQuantity]:
    """Pool every quantity that the data of two runs, on different recordings, determine.

    See :func:`shared_quantities` for what counts. What another motion changes is not pooled: runs
    of one joint may differ in it.
    """
    pooled = []
    for quantity in shared_quantities(runs, draws):
        if not any(row.of_motion for row in quantity.runs.values()):
            pool = population(list(quantity.likelihoods.values()), quantity.row.level)
            pooled.append(PooledQuantity(**vars(quantity), pool=_possible(quantity.name, pool)))
    return pooled


def _possible(name: str, pool: Population) -> Population:
    """Cut ends that the normal model puts where a quantity cannot be; they hold the same."""
    row = QUANTITIES.get(quantity_of(name))
    if row is None:
        return pool

    def cut(interval: Interval) -> Interval:
        return Interval(
            *(max(x, row.lower) for x in (interval.median, interval.low, interval.high))
        )

    return replace(pool, mean=cut(pool.mean), following=cut(pool.following))


def shared_quantities(
    runs: Mapping[str, Summary], draws: Mapping[str, RunDraws] | None = None
) -> Iterator[SharedQuantity]:
    """Give every quantity that the data of two runs determine, with each run's likelihood.

    By the runs' ``draws`` where there are any, else as if posteriors were normal. A run whose prior
    matters counts by its draws over those of its prior, and not at all without them: one prior
    would count several times. Nor does what the data leave open, or a run that is unusable: it has
    no posterior.
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
        if of_noise(name) or sum(map(_determined, rows.values())) < _MIN_RUNS:
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
    if row.at_bound is not None:
        return False
    return (row.undoubted or row.verdict) == "data"


def _likelihood(
    name: str, row: PosteriorRow, stored: PosteriorRow, draws: RunDraws | None
) -> Likelihood | None:
    """Give a run's likelihood; an angle's draws follow its row to the others' turn."""
    draws = RunDraws() if draws is None else draws
    drawn = name in draws.values
    if not _determined(row) and (row.verdict == "prior" or not drawn or name not in draws.prior):
        return None
    if not drawn:
        return normal(row.mean, row.reported.sd)
    by = row.middle - stored.middle
    prior = None if name not in draws.prior else draws.prior[name] + by
    return likelihood(draws.values[name] + by, row.reported.sd, prior)


def between_runs_csv(pooled: Sequence[PooledQuantity]) -> str:
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
