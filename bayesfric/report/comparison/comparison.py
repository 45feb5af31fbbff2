"""Side by side: every method, every run's posterior and what is known from elsewhere.

A number that the data leave open has no standard deviation and no interval here,
whatever a file says: it says so in words. Nor is it measured against anything.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from io import StringIO
from typing import Any, Literal

from bayesfric.base.errors import BadInput
from bayesfric.base.templates import capital
from bayesfric.estimates.point_estimate import METHODS, Kind, Method
from bayesfric.mechanism.parameter import quantity_of, scales_with_torque, turned
from bayesfric.mechanism.quantities import QUANTITIES
from bayesfric.report.comparison.cell import Cell, estimate_cell, left_open, posterior_cell
from bayesfric.report.numbers import TEXT
from bayesfric.report.summary.conclusions import put_reported
from bayesfric.report.summary.record import Readable, Summary, of_noise
from bayesfric.report.summary.rows import PosteriorRow, ReferenceRow
from bayesfric.report.words import csv_text, filled, line_of, listed

REFERENCE = "reference"
# Standard deviations of the posterior beyond which an estimate is another one.
_FAR = 3.0
_GAIN = "drive.gain"
# Keys of rows that whole turns move.
_PLACES, _SPANS = ("mean", "median", "value", "bound"), ("interval", "model_error_interval", "span")
# Of a terminal, and of a cell's line: at least [0.00046688, 0.00046933], and words on few lines.
_WIDTH = 120
_NARROWEST, _WIDEST = 24, 30
_PLAIN = "†"
_COLUMNS = ["name", "unit", "symbol", "meaning", "kind", "gauge_free", "column", "run",
    "column_kind", "status", "value", "sd", "sd_uncorrelated", "accounts_for_correlation", "low",
    "high", "level", "span_low", "span_high", "limit", "disagreement", "remark"]  # fmt: skip


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


@dataclass
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
    told_by: str = ""  # the first run that tells its unit
    gauge_free: bool | None = None
    cells: dict[str, Cell] = field(default_factory=dict)
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
    contested: tuple[str, ...]
    # why numbers are doubtful, by run of which some are, a clause each
    reasons: Mapping[str, list[str]]
    # the first notes: in what other runs are far from the first, then in what they differ beyond
    # noise, and not beyond room for the models' errors
    runs_apart: tuple[str, ...]

    def __getitem__(self, name: str) -> Row:
        return {row.name: row for row in self.rows}[name]

    @property
    def several(self) -> bool:
        """Whether it is of several runs."""
        return len({column.run for column in self.columns} - {""}) > 1


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
    rows: dict[str, Row] = {}
    columns: list[Column] = []
    for name, run in runs.items():
        mine = []
        for column in _columns(f"{name}: " if len(runs) > 1 else "", name, run):
            # what a number is, estimates say that are not shown, too
            visible = shown or column.method is None
            mine += [column] if visible else []
            for quantity, one, cell in _told(column, run):
                row = _row(rows, quantity, one, run, name)
                if visible:
                    row.cells[column.label] = cell
        if not mine:
            raise BadInput(name, "holds no result to compare", "name a finished run")
        columns += mine
    for row in rows.values():
        if row.gauge_free is None:
            # the data alone leave what a scaling changes without any sd
            told = [run.parameters[row.name] for run in runs.values() if row.name in run.parameters]
            row.gauge_free = all(one.data_sd is not None for one in told)
        if not row.gauge_free:
            for name in runs:
                _leave_open(row, [column for column in columns if column.run == name])
    _check_common(rows.values(), columns)
    notes = list(_of_runs(runs, rows))
    sources, more = _add_references(rows, runs)
    if sources:
        columns.append(Column(REFERENCE, "reference", "", told=", ".join(sources)))
    baseline = next((c for c in columns if c.kind == "posterior"), None)
    found = [row for row in rows.values() if any(c.status != "known" for c in row.cells.values())]
    found.sort(key=_order)  # keeps the order of the files within each group
    for row in found:
        _measure(row, columns, baseline)
    apart = _runs_apart(runs, found, columns)
    if len(runs) > 1 and not any(_told_twice(row, columns) for row in found):
        notes.insert(0, _note("nothing shared"))
    far = _far_estimates(found, columns, baseline)
    notes += more + [_note("far estimate", label=one, names=names) for one, names in far.items()]
    return Comparison(
        tuple(columns),
        tuple(found),
        baseline.label if baseline else None,
        (*apart, *notes),
        tuple(row.name for row in found if any(row.name in names for names in far.values())),
        {name: run.reasons for name, run in runs.items() if run.reasons},
        apart,
    )


def _note(kind: str, **values: Any) -> str:
    """Say what must be known besides; names are all given."""
    values = {key: ", ".join(x) if isinstance(x, list) else x for key, x in values.items()}
    return f"{capital(line_of(kind, values))}."


def _order(row: Row) -> int:
    if row.kind == "total":
        return 0
    if row.gauge_free:
        return 1 if row.kind == "derived" else 2
    return 3 if row.kind == "parameter" else 4


def _columns(before: str, run: str, summary: Summary) -> Iterator[Column]:
    for method in METHODS:
        if method in summary.estimates:
            one = summary.estimates[method]
            told = "; ".join(filter(None, [one.assumption, *one.notes]))
            rms = one.residual_rms, one.residual_unit
            yield Column(f"{before}{method}", "estimate", run, method, told, *rms)
    if summary.parameters or summary.derived:
        lag, rms = summary.noise.residual_lag1, (summary.fit.residual_rms, summary.fit.unit)
        told = f"{summary.likelihood.method}; noise {summary.noise.model}"
        told += f"; its residuals' lag-1 correlation is {lag:.2f}" if lag is not None else ""
        yield Column(f"{before}posterior", "posterior", run, None, told, *rms, summary.widened)


def _told(column: Column, summary: Summary) -> Iterator[tuple[str, Any, Cell]]:
    """All that a column tells of its joint: name, row of the file, and what is said of it."""
    if column.method is None:
        for name, row in summary.rows.items():
            if not of_noise(name):
                yield name, row, posterior_cell(row, summary.accounts)
        for name, known in summary.fixed.items():
            if not of_noise(name):
                yield name, known, Cell(known.value, "known", remark="taken as known")
        return
    estimate = summary.estimates[column.method]
    for name, value in estimate.parameters.items():
        cell = estimate_cell(value, estimate.converged)
        why = _of_total(summary, name, value.unit) if column.method == "least-squares" else ""
        yield name, value, replace(cell, alike=False, remark=cell.remark or why) if why else cell


def _row(rows: dict[str, Row], name: str, one: Any, summary: Summary, run: str) -> Row:
    """Give the row of a quantity, with what one more file says it is."""
    known = name in summary.parameters or name in summary.fixed
    kind: Kind = "parameter" if known else "derived"
    kind = getattr(one, "kind", None) or ("total" if name.startswith("total.") else kind)
    row = rows.setdefault(name, Row(name, one.unit, "", "", kind, run))
    _check_unit(f"{run}: {name}", one.unit, row)
    posterior = isinstance(one, PosteriorRow)
    # the joint's own symbol before that of what least squares sees
    row.symbol = one.symbol if posterior and one.symbol else row.symbol or one.symbol
    row.meaning = row.meaning or one.meaning
    row.of_motion |= posterior and one.of_motion
    if (free := getattr(one, "gauge_free", None)) is not None:
        row.gauge_free = free and row.gauge_free is not False
    return row


def _check_unit(where: str, unit: str, row: Row) -> None:
    if unit != row.unit:
        what = f"is in {unit or 'no unit'!r}, but in {row.unit or 'no unit'!r} in {row.told_by}"
        raise BadInput(where, what, "compare runs of the same kind of joint, in one unit")


def _leave_open(row: Row, columns: list[Column]) -> None:
    """Leave an estimate of a scale open where another of the run's columns does."""
    mine = [(column, row.cells[column.label]) for column in columns if column.label in row.cells]
    # of a posterior or a search that is none, nothing follows for the others
    open_ = [c.label for c, cell in mine if cell.status == "undetermined" and cell.converged]
    for column, cell in mine if open_ else ():
        # a posterior's own verdict stands: it knows the priors, which settle what is open
        if column.kind == "estimate" and cell.status not in ("undetermined", "known"):
            row.cells[column.label] = left_open(cell.value, None, f" (see {open_[0]})")


def _of_total(summary: Summary, name: str, unit: str) -> str:
    """Say why a total of least squares is not what a posterior has by its name; else nothing."""
    if _GAIN in summary.parameters and scales_with_torque(unit):
        return "of the torque as told, without its gain"
    # load losses bend the totals, or what shapes other terms
    known = {one for one, row in summary.fixed.items() if row.value != 0.0}
    rows = (QUANTITIES.get(quantity_of(one)) for one in {*summary.parameters, *known})
    bent = sorted({row.bent_by for row in rows if row is not None and row.bends}, reverse=True)
    share = f"with the share of {listed(bent)} in it"
    return share if bent and name in summary.parameters else ""


def _check_common(rows: Iterable[Row], columns: list[Column]) -> None:
    """Refuse runs that tell nothing, or nothing that another tells, but what was taken as known."""
    has: dict[str, set[str]] = {column.run: set() for column in columns}
    for row in rows:
        for column in columns:
            if column.label in row.cells and row.cells[column.label].status != "known":
                has[column.run].add(row.name)
    # of two, the second is the one out of place
    for run, names in reversed(has.items()):
        others = set[str]().union(*(theirs for other, theirs in has.items() if other != run))
        if len(has) > 1 and not names & others:
            what = "has no quantity in common with the other runs"
            raise BadInput(run, what, "compare runs whose mechanisms share elements")


def _of_runs(runs: Mapping[str, Summary], rows: Mapping[str, Row]) -> Iterator[str]:
    """Say which runs are not to be relied on, where words differ, and what is the motion's."""
    for name, run in runs.items():
        if run.sampler.status != "reliable":
            yield _note("unsure run", run=name, status=run.sampler.status)
    for name in dict.fromkeys(name for run in runs.values() for name in run.rows):
        said = {key: run.rows[name].meaning for key, run in runs.items() if name in run.rows}
        said = {key: words for key, words in said.items() if words and not of_noise(name)}
        if len(set(said.values())) > 1:
            each = [f"{words!r} in {key}" for key, words in said.items()]
            yield _note("meanings", name=name, each=each)
    if names := [name for name, row in rows.items() if row.of_motion]:
        yield _note("of motion", names=names, several=len(runs) > 1)


def _told_twice(row: Row, columns: list[Column]) -> bool:
    """Whether two runs tell a quantity, or its limit, and do not doubt it themselves."""
    cells = [row.cells.get(c.label) for c in columns if c.kind == "posterior"]
    told = [c for c in cells if c and c.status in ("determined", "limit") and not c.doubted]
    return len(told) > 1


def _far_estimates(
    rows: list[Row], columns: list[Column], baseline: Column | None
) -> dict[str, list[str]]:
    """Name what estimates of the first posterior's run give otherwise, by label."""
    mine = [c for c in columns if c.kind == "estimate" and baseline and c.run == baseline.run]
    far = {
        c.label: [
            row.name
            for row in rows
            if (one := row.cells.get(c.label)) is not None
            and one.status == "determined"
            and abs(one.disagreement or 0.0) > _FAR
        ]
        for c in mine
    }
    return {label: names for label, names in far.items() if names}


def _runs_apart(
    runs: Mapping[str, Summary], rows: list[Row], columns: list[Column]
) -> tuple[str, ...]:
    """Say in what other runs' posteriors are too far from the first to be of one joint.

    Then where they differ beyond noise, but not beyond room for the models' errors. What a run
    doubts itself, as of a delay or too wide a band, is no news of the joint.
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
            if not (a and b and a.sd and b.sd) or a.period or not (a.wide or b.wide):
                continue
            own = (b.middle - a.middle) / math.hypot(a.sd, b.sd)
            beyond += [f"{apart}, {own:+.1f} were the models right)"] if abs(own) > _FAR else []
        for kind, names, into in zip(
            ("runs apart", "beyond noise"), (far, beyond), said, strict=True
        ):
            into += [_note(kind, run=column.run, first=first.run, names=names)] if names else []
    return (*said[0], *said[1])


def _add_references(
    rows: Mapping[str, Row], runs: Mapping[str, Summary]
) -> tuple[list[str], list[str]]:
    """Add values from elsewhere to what is shown; give their sources, and what must be known."""
    found: dict[str, tuple[str, ReferenceRow]] = {}
    notes = []
    for run, summary in runs.items():
        for name, row in summary.references.items():
            if name not in rows or all(c.status == "known" for c in rows[name].cells.values()):
                notes.append(_note("no such number", source=row.source, name=name))
                continue
            _check_unit(f"{run}: references.{name}", row.unit, rows[name])
            first, told = found.setdefault(name, (run, row))
            if told != row:
                values = [
                    f"{x.value:.5g} ({x.source}) in {at}" for at, x in ((first, told), (run, row))
                ]
                notes.append(
                    _note("references differ", name=name, shown=values[0], other=values[1])
                )
    for name, (_, row) in found.items():
        rows[name].cells[REFERENCE] = Cell(row.value, "known", sd=row.sd, remark=row.source)
    return list(dict.fromkeys(row.source for _, row in found.values())), notes


def _measure(row: Row, columns: list[Column], baseline: Column | None) -> None:
    """Put the cells into the columns' order and measure them against the first posterior."""
    row.cells = {c.label: row.cells[c.label] for c in columns if c.label in row.cells}
    base = row.cells.get(baseline.label) if baseline else None
    if baseline is None or base is None or base.status not in ("determined", "limit"):
        return
    for column in columns:
        cell = row.cells.get(column.label)
        if cell is None or column is baseline or not cell.alike:
            continue
        # two motions need not agree
        if row.of_motion and column.run not in ("", baseline.run):
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
            apart = (cell.value - base.value) / (max(sd, own) if same else math.hypot(sd, own))
            row.cells[column.label] = replace(cell, disagreement=apart)


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
    moved: dict[str, Any] = {key: told[key] + by for key in _PLACES if key in told}
    moved |= {key: [end + by for end in told[key]] for key in _SPANS if key in told}
    if isinstance(row, PosteriorRow):
        moved["reported"] = None  # concluded anew, of what was turned
    return row.model_copy(update=moved)


def comparison_text(found: Comparison, width: int = _WIDTH) -> Iterator[str]:
    """Lay a comparison out for a terminal; columns that do not fit come in further blocks."""
    from rich.box import SIMPLE_HEAD  # a page does without
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(width=width, file=StringIO(), color_system=None)
    left = max((len(row.name) for row in found.rows), default=0)
    each = max(1, (width - left) // (_NARROWEST + 2))
    for first in range(0, len(found.columns), each):
        columns = found.columns[first : first + each]
        shown = Table(box=SIMPLE_HEAD, pad_edge=False)
        shown.add_column(no_wrap=True)
        for column in columns:
            shown.add_column(Text(column.label), max_width=_WIDEST)
        group = None
        for row in found.rows:
            cells = ["\n".join(_cell_parts(row.cells.get(c.label))) for c in columns]
            if not any(cells):
                continue
            if group is not None and group != (row.kind, row.gauge_free):
                shown.add_row()
            group = (row.kind, row.gauge_free)
            name = f"{row.name}\n  {row.unit}" if row.unit else row.name
            shown.add_row(*map(Text, (name, *cells)))
        with console.capture() as captured:
            console.print(shown)
        yield from (line.rstrip() for line in captured.get().splitlines())
    for line in explained(found):
        yield from textwrap.wrap(line, width, subsequent_indent="  ")


def comparison_csv(found: Comparison) -> str:
    """Lay a comparison out as CSV text, one line for each quantity and column."""
    lines = []
    for row in found.rows:
        for column in found.columns:
            if (cell := row.cells.get(column.label)) is None:
                continue
            told = {key: getattr(row, key) for key in _COLUMNS[:6]} | asdict(cell)
            told |= {
                "status": "doubtful" if cell.doubted else cell.status,
                "column": column.label,
                "run": column.run,
                "column_kind": column.kind,
            }
            told |= {"sd_uncorrelated": cell.sd_plain, "accounts_for_correlation": cell.accounts}
            told["low"], told["high"] = cell.interval or (None, None)
            told["span_low"], told["span_high"] = cell.span or (None, None)
            lines.append(told)
    return csv_text(lines, _COLUMNS)


def comparison_dict(found: Comparison) -> dict[str, Any]:
    """Put a comparison into strings, numbers, lists and dicts, ready for JSON."""

    def listed(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        return {key: list(value) if isinstance(value, tuple) else value for key, value in pairs}

    quantities = {row.name: asdict(row, dict_factory=listed) for row in found.rows}
    for told in quantities.values():
        del told["name"], told["told_by"]
        told["columns"] = told.pop("cells")
    return {
        "baseline": found.baseline,
        "columns": [asdict(column) for column in found.columns],
        "quantities": quantities,
        "notes": list(found.notes),
    }


def _cell_parts(cell: Cell | None) -> list[str]:
    parts = cell.parts(TEXT) if cell else ()
    return [f"{text}{_PLAIN}" if kind == "plain" else text for kind, text in parts]


def explained(found: Comparison) -> Iterator[str]:
    """Say what the numbers are and what they take for granted."""
    cells = [cell for row in found.rows for cell in row.cells.values()]
    yield from filled(
        "explained.txt.j2",
        found=found,
        plain=any(cell.plain for cell in cells),
        levels=sorted({cell.level for cell in cells if cell.interval is not None and cell.level}),
        dagger=_PLAIN,
    ).splitlines()
    yield from found.notes
