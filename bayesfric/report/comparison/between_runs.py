"""What several runs say together, by their draws: the population, and the next recording."""

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
from bayesfric.report.comparison.cell import next_to, turns_of
from bayesfric.report.summary.conclusions import put_reported
from bayesfric.report.summary.record import Summary, of_noise
from bayesfric.report.summary.rows import PosteriorRow
from bayesfric.report.words import csv_text

# Fewer runs whose data determine a quantity are no population.
_LEAST = 2
# More draws change no interval that could be seen.
_MOST = 200_000


@dataclass(frozen=True)
class RunDraws:
    """What a run drew."""

    # `(n,)` draws in the quantity's unit, by its name: the sampled parameters and the derived
    # quantities that no scaling of leg parameters and alpha changes
    values: Mapping[str, Array] = field(default_factory=dict)
    # of the parameters' priors, `(m,)` each
    prior: Mapping[str, Array] = field(default_factory=dict)


def read_draws(run: Path, summary: Summary) -> RunDraws:
    """Read the draws of what a run's checked summary tells; none where there are none to read.

    Those with room for the model's error where the run holds such, as its tables do. Totals as
    least squares would see them need the recordings and are never among them.
    """
    known = {**summary.parameters, **summary.derived}
    names = [name for name, row in known.items() if row.gauge_free is not False]
    try:
        with open_hdf5(run / "posterior.nc") as file:
            groups = ("widened",) if "widened" in file else ("posterior", "derived")
            stored = [file[group] for group in groups if group in file]
            found = {
                name: _flat(group[name]) for group in stored for name in names if name in group
            }
            before = file.get("prior", {})
            prior = {name: _flat(before[name]) for name in found if name in before}
    except BadInput:
        return RunDraws()
    return RunDraws({name: x for name, x in found.items() if np.isfinite(x).any()}, prior)


def _flat(stored: Any) -> Array:
    """Lay chains and draws of a data set out in a row, evenly thinned where there are many."""
    x = np.asarray(read_array(stored), dtype=np.float64).ravel()
    if x.size == 0:
        raise ValueError("no draws")
    return x[:: -(-x.size // _MOST)]


@dataclass(frozen=True)
class Told:
    """What several runs say of one quantity, each by itself."""

    name: str
    runs: Mapping[str, PosteriorRow]
    likelihoods: Mapping[str, Likelihood]

    @property
    def told(self) -> PosteriorRow:
        """What the first run says of it: unit, symbol, meaning, level."""
        return next(iter(self.runs.values()))

    @property
    def doubted(self) -> int:
        """In how many runs it is doubted."""
        return sum(bool(row.doubted) for row in self.runs.values())


@dataclass(frozen=True)
class PooledQuantity(Told):
    """One quantity that the data of two runs or more determine; ``runs`` are the rows pooled."""

    pool: Population


def between_runs(
    runs: Mapping[str, Summary], draws: Mapping[str, RunDraws] | None = None
) -> list[PooledQuantity]:
    """Pool every quantity that the data of two runs, on recordings of their own, determine.

    See :func:`told_by_runs` for what counts. What another motion changes is not pooled: runs of one
    joint may differ in it.
    """
    found = []
    for one in told_by_runs(runs, draws):
        if not any(row.of_motion for row in one.runs.values()):
            pool = population(list(one.likelihoods.values()), one.told.level)
            found.append(PooledQuantity(**vars(one), pool=_possible(one.name, pool)))
    return found


def _possible(name: str, pool: Population) -> Population:
    """Cut ends that the normal model puts where a quantity cannot be; they hold the same."""
    row = QUANTITIES.get(quantity_of(name))
    if row is None:
        return pool

    def cut(one: Interval) -> Interval:
        ends = (max(x, row.lower) for x in (one.median, one.low, one.high))
        return Interval(*ends)

    return replace(pool, mean=cut(pool.mean), following=cut(pool.following))


def told_by_runs(
    runs: Mapping[str, Summary], draws: Mapping[str, RunDraws] | None = None
) -> Iterator[Told]:
    """Give what runs say of every quantity that the data of two of them determine.

    By the runs' ``draws`` where there are any, else as if posteriors were normal. A run whose prior
    has a say counts by its draws over those of its prior, and not at all without them: one prior
    would count several times. Nor does what the data leave open, and a run whose ensembles disagree
    or stand still: it has no posterior.
    """
    turns = turns_of(runs.values())
    tables = {
        run: {name: next_to(row, turns.get(name)) for name, row in put_reported(one).rows.items()}
        for run, one in runs.items()
        if one.sampler.status != "unusable"
    }
    if len(tables) < 2:
        return
    for name in dict.fromkeys(name for table in tables.values() for name in table):
        rows = {
            run: row
            for run, table in tables.items()
            if (row := table.get(name)) and row.sd and row.reported and row.reported.how.converged
        }
        if of_noise(name) or sum(map(_told, rows.values())) < _LEAST:
            continue
        each = {
            run: _likelihood(name, row, runs[run].rows[name], (draws or {}).get(run))
            for run, row in rows.items()
        }
        kept = {run: one for run, one in each.items() if one is not None}
        yield Told(name, {run: rows[run] for run in kept}, kept)


def _told(row: PosteriorRow) -> bool:
    """Whether the data determine it: also what is doubted, for other reasons than its prior.

    Of a number on its bound they tell a limit only, which is no value to pool.
    """
    if row.at_bound is not None:
        return False
    return (row.undoubted or row.verdict) == "data"


def _likelihood(
    name: str, row: PosteriorRow, stored: PosteriorRow, draws: RunDraws | None
) -> Likelihood | None:
    """Give a run's likelihood; an angle's draws follow its row to the others' turn."""
    found = RunDraws() if draws is None else draws
    known = name in found.values
    if not _told(row) and (row.verdict == "prior" or not known or name not in found.prior):
        return None
    if not known:
        return normal(row.mean, row.told.sd)
    by = row.middle - stored.middle
    prior = found.prior.get(name)
    return likelihood(found.values[name] + by, row.told.sd, None if prior is None else prior + by)


def between_runs_csv(found: Sequence[PooledQuantity]) -> str:
    """Lay pooled values out as CSV text, every number in full."""
    lines = []
    for one in found:
        line: dict[str, Any] = {"name": one.name, "unit": one.told.unit, "runs": len(one.runs)}
        line |= {"doubted": one.doubted, "level": one.told.level}
        for key in ("mean", "spread", "following"):
            for end, x in vars(getattr(one.pool, key)).items():
                line[key if end == "median" else f"{key}_{end}"] = x
        pool = one.pool
        lines.append(line | {"q": pool.q, "p_value": pool.p_value, "agree": pool.agree})
    return csv_text(lines, list(lines[0]) if lines else ["name"])
