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
from bayesfric.mechanism.parameter import quantity_of, scales_with_torque
from bayesfric.mechanism.quantities import QUANTITIES
from bayesfric.report.comparison.cell import (
    Cell,
    estimate_cell,
    next_to,
    posterior_cell,
    turns_of,
)
from bayesfric.report.numbers import TEXT
from bayesfric.report.summary.conclusions import put_reported
from bayesfric.report.summary.record import Readable, Summary, of_noise
from bayesfric.report.summary.rows import PosteriorRow
from bayesfric.report.words import csv_text, filled, line_of, listed

REFERENCE = "reference"
# Standard deviations of the posterior beyond which an estimate is another one.
_FAR = 3.0
_GAIN = "drive.gain"
# Of a terminal, and of a cell's line: at least [0.00046688, 0.00046933], and words on few lines.
_WIDTH = 120
_NARROWEST, _WIDEST = 24, 30
_PLAIN = "†"
_COLUMNS = ("name", "unit", "column", "status", "value", "sd", "sd_plain", "accounts", "low",
    "high", "level", "limit", "disagreement", "converged", "remark")  # fmt: skip


@dataclass(frozen=True)
class Column:
    """A method, a posterior, or values from elsewhere."""

    label: str  # as printed, unique
    kind: Literal["estimate", "posterior", "reference"]
    run: str  # name of the run; empty for references
    method: Method | None = None  # of an estimate
    told: str = ""  # what its numbers take for granted
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
    # the first notes: in what other runs are far from the first
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
        the rest. What did not converge, estimate or posterior, says so.

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
    runs = {name: put_reported(Summary.read(one, name)) for name, one in summaries.items()}
    shown = len(runs) == 1 if estimates is None else estimates
    turns, rows = turns_of(runs.values()), dict[str, Row]()
    columns: list[Column] = []
    for name, run in runs.items():
        every = list(_columns(f"{name}: " if len(runs) > 1 else "", name, run))
        mine = [column for column in every if shown or column.method is None]
        if not mine:
            raise BadInput(name, "holds no result to compare", "name a finished run")
        columns += mine
        for column in every:
            for quantity, one in _told(column, run):
                # what a number is, estimates say that are not shown, too
                row = _row(rows, quantity, one, run, name)
                if column in mine:
                    turned = next_to(one, turns.get(quantity))
                    row.cells[column.label] = _cell(quantity, turned, column, run)
    for row in rows.values():
        if row.gauge_free is None:
            # the data alone leave what a scaling changes without any sd
            told = [run.parameters[row.name] for run in runs.values() if row.name in run.parameters]
            row.gauge_free = all(one.data_sd is not None for one in told)
    _check_common(rows.values(), columns)
    notes = list(_of_runs(runs, rows))
    if sources := _add_references(rows, runs, turns):
        columns.append(Column(REFERENCE, "reference", "", told=", ".join(sources)))
    baseline = next((c for c in columns if c.kind == "posterior"), None)
    found = [row for row in rows.values() if any(c.status != "known" for c in row.cells.values())]
    found.sort(key=_order)  # keeps the order of the files within each group
    for row in found:
        _measure(row, columns, baseline)
    apart = _runs_apart(found, columns)
    if len(runs) > 1 and not any(_told_twice(row, columns) for row in found):
        notes.insert(0, _note("nothing shared"))
    far = _far_estimates(found, columns, baseline)
    notes += [_note("far estimate", label=one, names=names) for one, names in far.items()]
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
        if (one := summary.estimates.get(method)) is not None:
            told = [one.assumption, *one.notes, _residual(one.residual_rms, one.residual_unit)]
            yield Column(
                f"{before}{method}", "estimate", run, method, "; ".join(filter(None, told))
            )
    if summary.parameters or summary.derived:
        lag = summary.noise.residual_lag1
        told = [summary.likelihood.method, f"noise {summary.noise.model}"]
        told += [f"its residuals' lag-1 correlation is {lag:.2f}"] if lag is not None else []
        told += [_residual(summary.fit.residual_rms, summary.fit.unit)]
        words = "; ".join(filter(None, told))
        yield Column(f"{before}posterior", "posterior", run, None, words, summary.widened)


def _residual(rms: float | None, unit: str) -> str:
    return "" if rms is None else f"residual rms {rms:.4g} {unit}".strip()


def _told(column: Column, summary: Summary) -> Iterator[tuple[str, Any]]:
    """All that a column tells of its joint: names, and rows of the file."""
    if column.method is not None:
        yield from summary.estimates[column.method].parameters.items()
        return
    for name, row in (*summary.rows.items(), *summary.fixed.items()):
        if not of_noise(name):
            yield name, row


def _cell(name: str, row: Any, column: Column, summary: Summary) -> Cell:
    if isinstance(row, PosteriorRow):
        return posterior_cell(row, summary.accounts)
    if column.method is None:
        return Cell(row.value, "known", remark="taken as known")
    cell = estimate_cell(row, summary.estimates[column.method].converged)
    why = _of_total(summary, name, row.unit) if column.method == "least-squares" else ""
    return replace(cell, alike=False, remark=cell.remark or why) if why else cell


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
    """Say which runs are not to be relied on, and what is the motion's."""
    for name, run in runs.items():
        if run.sampler.status != "reliable":
            yield _note("unsure run", run=name, status=run.sampler.status)
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


def _runs_apart(rows: list[Row], columns: list[Column]) -> tuple[str, ...]:
    """Say in what other runs' posteriors are too far from the first to be of one joint.

    What a run doubts itself, as of a delay or too wide a band, is no news of the joint.
    """
    posteriors = [c for c in columns if c.kind == "posterior"]
    said = []
    for column in posteriors[1:]:
        first = posteriors[0]
        far = [
            f"{row.name} ({cell.disagreement:+.1f} sd)"
            for row in rows
            if (cell := row.cells.get(column.label)) is not None
            and abs(cell.disagreement or 0.0) > _FAR
            and not (cell.doubted or row.cells[first.label].doubted)
        ]
        said += [_note("runs apart", run=column.run, first=first.run, names=far)] if far else []
    return tuple(said)


def _add_references(
    rows: Mapping[str, Row], runs: Mapping[str, Summary], turns: Mapping[str, float]
) -> list[str]:
    """Add values from elsewhere to what is shown, the first of each; give their sources."""
    sources: dict[str, None] = {}
    for run, summary in runs.items():
        for name, told in summary.references.items():
            if name not in rows or all(c.status == "known" for c in rows[name].cells.values()):
                continue
            _check_unit(f"{run}: references.{name}", told.unit, rows[name])
            value = next_to(told, turns.get(name)).value
            cell = Cell(value, "known", sd=told.sd, remark=told.source)
            rows[name].cells.setdefault(REFERENCE, cell)
            sources[told.source] = None
    return list(sources)


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
    lines: list[dict[str, Any]] = []
    for row in found.rows:
        for label, cell in row.cells.items():
            low, high = cell.interval or (None, None)
            told = asdict(cell) | {"low": low, "high": high}
            told |= {"status": "doubtful"} if cell.doubted else {}
            lines.append({"name": row.name, "unit": row.unit, "column": label} | told)
    return csv_text(lines, _COLUMNS)


def comparison_dict(found: Comparison) -> dict[str, Any]:
    """Put a comparison into strings, numbers, lists and dicts, ready for JSON."""
    quantities = {row.name: asdict(row) for row in found.rows}
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
