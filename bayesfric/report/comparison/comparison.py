"""Side by side: every method, every run's posterior and what is known from elsewhere.

A number that the data leave open has no standard deviation and no interval here,
whatever a file says: it says so in words. Nor is it measured against anything.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from bayesfric.errors import BadInput
from bayesfric.estimates.point_estimate import METHODS, Kind, Method
from bayesfric.mechanism.parameter import scales_with_torque, turned
from bayesfric.mechanism.quantities import QUANTITIES
from bayesfric.report.comparison.cell import Cell, estimate_cell, left_open, posterior_cell
from bayesfric.report.summary.record import Readable, Summary, of_noise, quantity_of
from bayesfric.report.summary.reported import put_reported
from bayesfric.report.summary.rows import PosteriorRow, ReferenceRow
from bayesfric.report.text_templates import listed

REFERENCE = "reference"
# Standard deviations of the posterior beyond which an estimate is another one.
_FAR = 3.0
# What a total of least squares is that goes by a parameter's name.
_OF_ALL = "with the share of %s in it"
_NOTHING_SHARED = (
    "No quantity is told by two of these runs, or each doubts what it tells: whether they agree "
    "cannot be said."
)
_GAIN, _AS_TOLD = "drive.gain", "of the torque as told, without its gain"


@dataclass(frozen=True)
class Column:
    """A method, a posterior, or values from elsewhere."""

    label: str  # as printed, unique
    kind: Literal["estimate", "posterior", "reference"]
    run: str  # name of the run; empty for references
    method: Method | None = None  # of an estimate
    told: str = ""  # what its numbers take for granted
    # of measured minus modelled; `None` where it is not known
    residual_rms: float | None = None
    residual_unit: str = ""
    widened: bool = False  # whether its sds and intervals have room for the model's error


@dataclass(frozen=True)
class Row:
    """One quantity; ``cells`` by column label, those that have it.

    ``symbol`` is LaTeX without dollar signs, empty where no file tells it.
    ``gauge_free`` is whether scaling leg parameters and alpha together leaves it, ``of_motion``
    whether another motion of the same joint has another value.
    """

    name: str
    unit: str
    symbol: str
    meaning: str
    kind: Kind
    gauge_free: bool
    cells: Mapping[str, Cell]
    of_motion: bool = False


@dataclass(frozen=True)
class Comparison:
    """Quantities by columns."""

    # in the order to print them
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    baseline: str | None  # label of the posterior that disagreement is measured against, if any
    notes: tuple[str, ...]  # what a reader must know besides, one sentence each
    # names of the rows in which an estimate of the first posterior's run is far from it
    contested: tuple[str, ...] = ()
    # why numbers are doubtful, by run of which some are, a clause each
    reasons: Mapping[str, list[str]] = field(default_factory=dict)
    # the first notes: in what other runs are far from the first
    runs_apart: tuple[str, ...] = ()
    # the next notes: in what they differ beyond noise, and not beyond room for the models' errors
    beyond_noise: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> Row:
        for row in self.rows:
            if row.name == name:
                return row
        raise KeyError(name)


@dataclass
class _Facts:
    """What is gathered about one quantity."""

    unit: str
    told_by: str
    kind: Kind
    symbol: str = ""
    meaning: str = ""
    # whether no scaling changes it: as files say, and as may be guessed where none does
    said: list[bool] = field(default_factory=list)
    guessed: list[bool] = field(default_factory=list)
    cells: dict[str, Cell] = field(default_factory=dict)
    of_motion: bool = False
    # words of each run's posterior, which state for example the load of an efficiency
    meanings: dict[str, str] = field(default_factory=dict)

    @property
    def gauge_free(self) -> bool:
        return all(self.said or self.guessed)

    @property
    def found(self) -> bool:
        """Whether any column holds more than what was taken as known."""
        return any(cell.status != "known" for cell in self.cells.values())


def comparison(summaries: Mapping[str, Readable], *, estimates: bool | None = None) -> Comparison:
    """Put the results of one or several runs side by side.

    Parameters
    ----------
    summaries
        What each ``summary.json`` holds, by name of the run.
    estimates
        Whether to show the runs' point estimates; if left out, of a single run only.

    Returns
    -------
    Comparison
        Totals first, then what no scaling of leg parameters and alpha changes, then
        the rest. A run shows an estimate of one of the rest only where all of its columns
        that have it determine it: otherwise their scales differ and compare nothing. What
        did not converge, estimate or posterior, says so and leaves the others as they are.

    Raises
    ------
    BadInput
        Where a summary lacks something or holds something else, where units differ,
        or where a run has no quantity in common with any other.

    Notes
    -----
    Disagreement is ``(value - median)/sd`` with both of the first posterior; of what is skewed
    that sd is the one on the side of the other, and of a limit what its distance makes of one. The
    variance of another posterior, and of a reference that has one, is added to that
    of the first; runs on the same recording are not independent, and disagree more
    than that says. An estimate of the same run saw the same data, so variances do not
    add: the larger of the two standard deviations counts.
    """
    runs = on_one_turn({name: Summary.read(one, name) for name, one in summaries.items()})
    shown = len(runs) == 1 if estimates is None else estimates
    facts: dict[str, _Facts] = {}
    columns: list[Column] = []
    for name, run in runs.items():
        _gather(facts, name, run)
    for name, run in runs.items():
        mine = list(_columns(name, run, alone=len(runs) == 1, estimates=shown))
        columns += mine
        labels = [column.label for column in mine]
        posteriors = [column.label for column in mine if column.kind == "posterior"]
        for column in mine:
            for quantity, cell in _cells(column, run):
                if not of_noise(quantity):
                    facts[quantity].cells[column.label] = cell
        for fact in facts.values():
            if not fact.gauge_free:
                _withhold(fact.cells, labels, posteriors)
    _check_common(facts, runs, columns)
    notes = [
        f"The posterior of {name} is {run.sampler.status}: "
        + ("it has converged, but is doubted." if run.only_doubted else "it has not converged.")
        for name, run in runs.items()
        if run.sampler.status != "reliable"
    ]
    notes += _meanings(facts)
    notes += _of_motion(facts, runs)
    reference = _add_references(facts, runs, notes)
    if reference is not None:
        columns.append(reference)
    baseline = next((c for c in columns if c.kind == "posterior"), None)
    rows = [
        Row(
            name=name,
            unit=fact.unit,
            symbol=fact.symbol,
            meaning=fact.meaning,
            kind=fact.kind,
            gauge_free=fact.gauge_free,
            cells=_measured(fact, columns, baseline),
            of_motion=fact.of_motion,
        )
        for name, fact in facts.items()
        if fact.found
    ]
    rows.sort(key=_order)  # keeps the order of the files within each group
    between, beyond = map(tuple, _runs_apart(runs, rows, columns))
    if len(runs) > 1 and not any(_told_twice(row, columns) for row in rows):
        notes.insert(0, _NOTHING_SHARED)
    apart = {
        c.label: [
            row.name
            for row in rows
            if (one := row.cells.get(c.label)) is not None
            and one.status == "determined"
            and abs(one.disagreement or 0.0) > _FAR
        ]
        for c in columns
        if c.kind == "estimate" and baseline is not None and c.run == baseline.run
    }
    notes += [
        f"{label} differs from the posterior by more than {_FAR:g} sd in {', '.join(names)}: the "
        "two take different things for granted, and of one of them they do not hold."
        for label, names in apart.items()
        if names
    ]
    return Comparison(
        tuple(columns),
        tuple(rows),
        baseline.label if baseline else None,
        (*between, *beyond, *notes),
        tuple(row.name for row in rows if any(row.name in names for names in apart.values())),
        {name: run.reasons for name, run in runs.items() if run.reasons},
        between,
        beyond,
    )


def _order(row: Row) -> int:
    if row.kind == "total":
        return 0
    if row.gauge_free:
        return 1 if row.kind == "derived" else 2
    return 3 if row.kind == "parameter" else 4


def _gather(facts: dict[str, _Facts], run: str, summary: Summary) -> None:
    """Collect what each quantity is, also from estimates that are not shown."""

    def tell(name: str, row: Any, kind: Kind, gauge_free: bool | None) -> _Facts:
        fact = facts.setdefault(name, _Facts(row.unit, run, kind))
        if row.unit != fact.unit:
            raise BadInput(
                f"{run}: {name}",
                f"is in {row.unit or 'no unit'!r}, but in {fact.unit or 'no unit'!r} in "
                f"{fact.told_by}",
                "compare runs of the same kind of joint",
            )
        fact.symbol = fact.symbol or getattr(row, "symbol", "")
        fact.meaning = fact.meaning or getattr(row, "meaning", "")
        if gauge_free is not None:
            fact.said.append(gauge_free)
        return fact

    for method in sorted(summary.estimates, key=METHODS.index):
        for name, value in summary.estimates[method].parameters.items():
            tell(name, value, value.kind or _kind(name, summary), value.gauge_free)
    for group in (summary.derived, summary.parameters):
        for name, row in group.items():
            if of_noise(name):
                continue
            fact = tell(name, row, _kind(name, summary), row.gauge_free)
            fact.meanings[run] = row.meaning
            fact.of_motion |= row.of_motion
            # the joint's own symbol before that of what least squares sees
            fact.symbol = row.symbol or fact.symbol
            # the data alone leave what a scaling changes without any sd
            fact.guessed.append(group is summary.derived or row.data_sd is not None)
    for name, known in summary.fixed.items():
        tell(name, known, "parameter", None)


def _kind(name: str, summary: Summary) -> Kind:
    if name.partition(".")[0] == "total":
        return "total"
    return "parameter" if name in summary.parameters else "derived"


def _columns(run: str, summary: Summary, *, alone: bool, estimates: bool) -> Iterator[Column]:
    before = "" if alone else f"{run}: "
    for method in METHODS:
        if estimates and method in summary.estimates:
            told = summary.estimates[method]
            yield Column(
                f"{before}{method}",
                "estimate",
                run,
                method,
                "; ".join(filter(None, [told.assumption, *told.notes])),
                told.residual_rms,
                told.residual_unit,
            )
    if summary.parameters or summary.derived:
        lag = summary.noise.residual_lag1
        yield Column(
            f"{before}posterior",
            "posterior",
            run,
            None,
            f"{summary.likelihood.method}; noise {summary.noise.model}"
            + (f"; its residuals' lag-1 correlation is {lag:.2f}" if lag is not None else ""),
            summary.fit.residual_rms,
            summary.fit.unit,
            summary.widened,
        )


def _cells(column: Column, summary: Summary) -> Iterator[tuple[str, Cell]]:
    if column.kind == "posterior":
        for name, row in summary.rows.items():
            yield name, posterior_cell(row, summary.accounts, summary.sampler.status)
        for name, known in summary.fixed.items():
            yield name, Cell(known.value, "known", remark="taken as known")
        return
    if column.method is not None:
        estimate = summary.estimates[column.method]
        bent = _bent(summary) if column.method == "least-squares" else None
        for name, value in estimate.parameters.items():
            cell = estimate_cell(value, estimate.converged)
            why = "" if bent is None else _of_total(summary, name, value.unit, bent)
            yield name, replace(cell, alike=False, remark=cell.remark or why) if why else cell


def _of_total(summary: Summary, name: str, unit: str, bent: list[str]) -> str:
    """Say why a total of least squares is not what a posterior has by its name; else nothing."""
    if _GAIN in summary.parameters and scales_with_torque(unit):
        return _AS_TOLD
    return _OF_ALL % listed(bent) if bent and name in summary.parameters else ""


def _bent(summary: Summary) -> list[str]:
    """Name what bends the totals of least squares: load losses, or what shapes other terms."""
    known = {name for name, row in summary.fixed.items() if row.value != 0.0}
    rows = (QUANTITIES.get(quantity_of(name)) for name in {*summary.parameters, *known})
    return sorted({row.bent_by for row in rows if row is not None and row.bends}, reverse=True)


def _withhold(cells: dict[str, Cell], labels: list[str], posteriors: list[str]) -> None:
    """Show an estimate that a scaling changes only where no column of the run leaves it open.

    A posterior's own verdict stands: it knows the priors, which settle what the data leave open.
    """
    mine = {label: cells[label] for label in labels if label in cells}
    # of a posterior or a search that is none, nothing follows for the others
    open_ = (label for label, c in mine.items() if c.status == "undetermined" and c.converged)
    first = next(open_, None)
    for label, cell in mine.items():
        shown = cell.status in ("undetermined", "known") or label in posteriors
        if first is not None and not shown:
            cells[label] = left_open(cell.value, None, f" (see {first})")


def _check_common(
    facts: Mapping[str, _Facts], runs: Mapping[str, Summary], columns: list[Column]
) -> None:
    has: dict[str, set[str]] = {run: set() for run in runs}
    for column in columns:
        has[column.run] |= {
            name
            for name, fact in facts.items()
            if column.label in fact.cells and fact.cells[column.label].status != "known"
        }
    # of two, the second is the one out of place
    for run, names in reversed(has.items()):
        if not names:
            raise BadInput(run, "holds no result to compare", "name a finished run")
        others = set[str]().union(*(theirs for other, theirs in has.items() if other != run))
        if len(has) > 1 and not names & others:
            raise BadInput(
                run,
                "has no quantity in common with the other runs",
                "compare runs whose mechanisms share elements",
            )


def _meanings(facts: Mapping[str, _Facts]) -> Iterator[str]:
    for name, fact in facts.items():
        said = {run: words for run, words in fact.meanings.items() if words}
        if len(set(said.values())) > 1:
            each = ", ".join(f"{words!r} in {run}" for run, words in said.items())
            yield f"{name} is not the same everywhere: {each}."


def _of_motion(facts: Mapping[str, _Facts], runs: Mapping[str, Summary]) -> Iterator[str]:
    names = [name for name, fact in facts.items() if fact.of_motion]
    if names:
        several = len(runs) > 1
        yield (
            f"{', '.join(names)}: what a fit without load losses would find along "
            f"{'each' if several else 'the'} run's own motion; another motion of the same joint "
            "gives other values"
            + (", so runs are not measured against each other by them." if several else ".")
        )


def _told_twice(row: Row, columns: list[Column]) -> bool:
    """Whether two runs tell a quantity, or its limit, and do not doubt it themselves."""
    cells = [row.cells.get(c.label) for c in columns if c.kind == "posterior"]
    told = [c for c in cells if c and c.status in ("determined", "limit") and not c.doubted]
    return len(told) > 1


def _runs_apart(
    runs: Mapping[str, Summary], rows: list[Row], columns: list[Column]
) -> tuple[list[str], list[str]]:
    """Say in what other runs' posteriors are too far from the first to be of one joint.

    The second list says where they differ beyond noise, but not beyond room for the models' errors.
    What a run doubts itself, as of a delay or too wide a band, is no news of the joint.
    """
    posteriors = [c for c in columns if c.kind == "posterior"]
    said: tuple[list[str], list[str]] = [], []
    for column in posteriors[1:]:
        first, far, beyond = posteriors[0], list[str](), list[str]()
        for row in rows:
            cell, base = row.cells.get(column.label), row.cells.get(first.label)
            if cell is None or base is None or cell.disagreement is None:
                continue
            apart = f"{row.name} ({cell.disagreement:+.1f} sd"
            if abs(cell.disagreement) > _FAR:
                far += [] if cell.doubted or base.doubted else [f"{apart})"]
                continue
            a, b = (runs[run].joint.get(row.name) for run in (first.run, column.run))
            if not (a and b and a.sd and b.sd) or a.period or not (a.widened or b.widened):
                continue
            own = (b.middle - a.middle) / math.hypot(a.sd, b.sd)
            beyond += [f"{apart}, {own:+.1f} were the models right)"] if abs(own) > _FAR else []
        if far:
            said[0].append(
                f"{column.run} and {first.run} disagree in {', '.join(far)}: joint, motion or "
                "what the model lacks is not the same in both, and the intervals of one do not "
                "hold for the other."
            )
        if beyond:
            said[1].append(
                f"{column.run} and {first.run} are further apart than by noise in "
                f"{', '.join(beyond)}, which is put down to the model's error. Where both motions "
                "are alike they may share that error, and then this is a real difference."
            )
    return said


def _add_references(
    facts: Mapping[str, _Facts], runs: Mapping[str, Summary], notes: list[str]
) -> Column | None:
    """Add the column of values from elsewhere, where they concern anything that is shown."""
    found: dict[str, tuple[str, ReferenceRow]] = {}
    for run, summary in runs.items():
        for name, row in summary.references.items():
            if name not in facts or not facts[name].found:
                notes.append(f"{row.source} gives {name}, which no run estimates.")
                continue
            if row.unit != facts[name].unit:
                raise BadInput(
                    f"{run}: references.{name}",
                    f"is in {row.unit or 'no unit'!r}, but in "
                    f"{facts[name].unit or 'no unit'!r} in {facts[name].told_by}",
                    "give it in the quantity's unit",
                )
            first, told = found.setdefault(name, (run, row))
            if told != row:
                notes.append(
                    f"{name} is {told.value:.5g} ({told.source}) in {first}, which is shown, but "
                    f"{row.value:.5g} ({row.source}) in {run}."
                )
    for name, (_, row) in found.items():
        facts[name].cells[REFERENCE] = Cell(row.value, "known", sd=row.sd, remark=row.source)
    sources = dict.fromkeys(row.source for _, row in found.values())
    return Column(REFERENCE, "reference", "", None, ", ".join(sources)) if found else None


def _measured(fact: _Facts, columns: list[Column], baseline: Column | None) -> dict[str, Cell]:
    """Put the cells into the columns' order and measure them against the first posterior."""
    ordered = {c.label: fact.cells[c.label] for c in columns if c.label in fact.cells}
    base = ordered.get(baseline.label) if baseline else None
    if baseline is None or base is None or base.status not in ("determined", "limit"):
        return ordered
    for column in columns:
        cell = ordered.get(column.label)
        if cell is None or column is baseline or not cell.alike:
            continue
        # two motions need not agree
        if fact.of_motion and column.run not in ("", baseline.run):
            continue
        # an estimate has other limits than a posterior
        if column.kind == "estimate" and "limit" in (base.status, cell.status):
            continue
        sd = base.sd_towards(cell.value)
        # what a run took as known is no finding, and what is open agrees with anything
        if sd and (cell.status in ("determined", "bound", "limit") or column.kind == "reference"):
            own = cell.sd_towards(base.value) or 0.0
            # two estimates from one recording share its noise: their variances do not add
            same = column.kind == "estimate" and column.run == baseline.run
            scale = max(sd, own) if same else math.hypot(sd, own)
            apart = (cell.value - base.value) / scale
            ordered[column.label] = replace(cell, disagreement=apart)
    return ordered


def on_one_turn(runs: Mapping[str, Summary]) -> dict[str, Summary]:
    """Bring every number of an angle by whole turns next to the first run's: 3.13 to -3.13."""
    towards: dict[str, float] = {}
    for run in runs.values():
        for name, row in run.parameters.items():
            if row.period is not None:
                towards.setdefault(name, row.middle)

    def turn(rows: Mapping[str, Any]) -> dict[str, Any]:
        return {n: _turned(r, towards[n]) if n in towards else r for n, r in rows.items()}

    found = {}
    for key, run in runs.items():
        estimates = {
            method: one.model_copy(update={"parameters": turn(one.parameters)})
            for method, one in run.estimates.items()
        }
        tables = {key: turn(getattr(run, key)) for key in ("parameters", "fixed", "references")}
        found[key] = run.model_copy(update=tables | {"estimates": estimates})
    return {key: put_reported(run) for key, run in (found if towards else runs).items()}


def _turned(row: Any, towards: float) -> Any:
    middle = row.middle if isinstance(row, PosteriorRow) else row.value
    by = float(turned(middle, towards) - middle)
    told = row.model_dump(exclude_none=True)
    moved = {key: told[key] + by for key in ("mean", "median", "value", "bound") if key in told}
    ends = ("interval", "model_error_interval", "span")
    moved |= {key: [end + by for end in told[key]] for key in ends if key in told}
    if isinstance(row, PosteriorRow):
        moved["reported"] = None  # concluded anew, of what was turned
    return row.model_copy(update=moved)
