"""What several runs say together: the population, and the next recording."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

from bayesfric.mechanism.quantities import QUANTITIES
from bayesfric.population.population import (
    Interval,
    Likelihood,
    Population,
    likelihood,
    normal,
    population,
)
from bayesfric.report.comparison.comparison import on_one_turn
from bayesfric.report.comparison.run_draws import RunDraws
from bayesfric.report.summary.record import Summary, of_noise, quantity_of
from bayesfric.report.summary.rows import PosteriorRow
from bayesfric.report.words import csv_text

_NONE = Interval(0.0, 0.0, 0.0)
# Fewer runs whose data determine a quantity are no population.
_LEAST = 2


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
    tables = {
        name: run.rows
        for name, run in on_one_turn(runs).items()
        if run.sampler.status != "unusable"
    }
    if len(tables) < 2:
        return
    for name in dict.fromkeys(name for table in tables.values() for name in table):
        rows = {
            run: table[name]
            for run, table in tables.items()
            if name in table and table[name].sd and _converged(table[name])
        }
        if of_noise(name) or sum(map(_told, rows.values())) < _LEAST:
            continue
        each = {
            run: _likelihood(name, row, runs[run].rows[name], (draws or {}).get(run))
            for run, row in rows.items()
        }
        kept = {run: one for run, one in each.items() if one is not None}
        yield Told(name, {run: rows[run] for run in kept}, kept)


def _converged(row: PosteriorRow) -> bool:
    return row.reported is not None and row.reported.how.converged


def _told(row: PosteriorRow) -> bool:
    """Whether the data determine it: also what is doubted, for other reasons than its prior.

    Of a number on its bound they tell a limit only, which is no value to pool.
    """
    if row.at_bound is not None:
        return False
    # older files do not tell what else would be said of what is doubted
    return (row.undoubted or ("data" if row.doubted else row.verdict)) == "data"


def _likelihood(
    name: str, row: PosteriorRow, stored: PosteriorRow, draws: RunDraws | None
) -> Likelihood | None:
    """Give a run's likelihood; an angle's draws follow its row to the others' turn."""
    found = RunDraws() if draws is None else draws
    known = name in found.values
    if not _told(row) and (row.verdict == "prior" or not known or name not in found.prior):
        return None
    if not known:
        return normal(row.mean, row.told_sd)
    by = row.middle - stored.middle
    prior = found.prior.get(name)
    return likelihood(found.values[name] + by, row.told_sd, None if prior is None else prior + by)


def between_runs_csv(found: Sequence[PooledQuantity]) -> str:
    """Lay pooled values out as CSV text, every number in full."""
    lines = [
        {"name": one.name, "unit": one.told.unit, "runs": len(one.runs), "doubted": one.doubted}
        | {"level": one.told.level}
        | asdict(one.pool.mean)
        | _ends("between_sd", one.pool.spread)
        | _ends("next", one.pool.following)
        | {"q": one.pool.q, "p_value": one.pool.p_value, "agree": one.pool.agree}
        for one in found
    ]
    between, following = (list(_ends(key, _NONE)) for key in ("between_sd", "next"))
    columns = ["name", "unit", "runs", "doubted", "level", "median", "low", "high", *between]
    return csv_text(lines, [*columns, *following, "q", "p_value", "agree"])


def _ends(key: str, interval: Interval) -> dict[str, float]:
    return {key: interval.median, f"{key}_low": interval.low, f"{key}_high": interval.high}
