"""Comparison of every method, every run's posterior and values from elsewhere.

A number that the data leave open has no standard deviation and no interval, whatever a file says:
its remark says so. Nor is its distance to anything measured.
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
from bayesfric.report.numbers import TEXT
from bayesfric.report.result_row import ResultRow, estimate_row, known_row, posterior_row
from bayesfric.report.summary.record import (
    GAIN,
    PosteriorRow,
    Readable,
    Summary,
    first_angles,
    of_noise,
    unwrapped,
)
from bayesfric.report.words import csv_text, filled, line_of, listed

REFERENCE = "reference"
# Standard deviations of the posterior beyond which an estimate disagrees.
_FAR = 3.0
# Of a terminal, and of a cell's line: at least [0.00046688, 0.00046933], and words on few lines.
_WIDTH = 120
_NARROWEST, _WIDEST = 24, 30
_PLAIN = "†"
_CSV = ("name", "unit", "column", "status", "value", "sd", "sd_plain", "accounts", "low",
    "high", "level", "limit", "disagreement", "converged", "remark")  # fmt: skip
# What JSON has of each ResultRow.
_JSON = ("value", "status", "sd", "sd_plain", "accounts", "interval", "level", "span", "limit",
    "at_bound", "bound", "remark", "disagreement", "converged", "doubted", "alike")  # fmt: skip


@dataclass(frozen=True)
class Column:
    """A method, a posterior, or values from elsewhere."""

    label: str  # as printed, unique
    kind: Literal["estimate", "posterior", "reference"]
    run: str  # name of the run; empty for references
    method: Method | None = None  # of an estimate
    told: str = ""  # what its numbers assume
    widened: bool = False  # whether its sds and intervals allow for model discrepancy


@dataclass
class Quantity:
    """One quantity; ``cells`` by column label, those that have it."""

    name: str
    unit: str
    symbol: str  # LaTeX without dollar signs, empty where no file has it
    meaning: str
    kind: Kind
    run: str = ""  # the first that has it
    gauge_free: bool | None = None  # whether scaling leg parameters and alpha together leaves it
    cells: dict[str, ResultRow] = field(default_factory=dict)
    of_motion: bool = False  # whether another motion of the same joint has another value


@dataclass(frozen=True)
class Comparison:
    """Quantities by columns."""

    # in the order to print them
    columns: tuple[Column, ...]
    rows: tuple[Quantity, ...]
    baseline: str | None  # label of the posterior that disagreement is measured against, if any
    notes: tuple[str, ...]  # one sentence each
    # names of the rows in which an estimate of the first posterior's run is far from it
    contested: tuple[str, ...]
    # why numbers are doubtful, by run of which some are, a clause each
    reasons: Mapping[str, list[str]]
    # the first notes: in what other runs are far from the first
    runs_apart: tuple[str, ...]

    def __getitem__(self, name: str) -> Quantity:
        return {row.name: row for row in self.rows}[name]

    @property
    def several(self) -> bool:
        """Whether it is of several runs."""
        return len({column.run for column in self.columns} - {""}) > 1


def comparison(summaries: Mapping[str, Readable], *, estimates: bool | None = None) -> Comparison:
    """Compare the results of one or several runs, each by what its ``summary.json`` holds.

    ``estimates`` is whether to show point estimates; by default of a single run only. Totals come
    first, then what no scaling of leg parameters and alpha changes, then the rest. ``BadInput``
    where units differ, or a run has no quantity in common with any other.

    Disagreement is ``(value - median)/sd`` with both of the first posterior; of what is skewed that
    sd is the one on the side of the other, and of a limit what its distance makes of one. The
    variance of another posterior, and of a reference that has one, is added; runs on the same
    recording are not independent, and disagree more than that says. An estimate of the same run
    used the same data, so variances do not add: the larger of the two sds counts.
    """
    runs = {name: Summary.read(one, name) for name, one in summaries.items()}
    with_estimates = len(runs) == 1 if estimates is None else estimates
    angles = first_angles(run.parameters for run in runs.values())
    quantities: dict[str, Quantity] = {}
    columns: list[Column] = []
    for run, summary in runs.items():
        every = list(_columns(f"{run}: " if len(runs) > 1 else "", run, summary))
        shown = [column for column in every if with_estimates or column.method is None]
        if not shown:
            raise BadInput(run, "holds no result to compare", "name a finished run")
        columns += shown
        for column in every:
            for name, row in _file_rows(column, summary):
                # estimates describe quantities even where they are not shown
                quantity = _quantity(quantities, name, row, summary, run)
                if column in shown:
                    aligned = unwrapped(row, angles.get(name))
                    quantity.cells[column.label] = _cell(name, aligned, column, summary)
    for quantity in quantities.values():
        if quantity.gauge_free is None:
            # the data alone leave what a scaling changes without any sd
            rows = [s.parameters.get(quantity.name) for s in runs.values()]
            quantity.gauge_free = all(row.data_sd is not None for row in rows if row is not None)
    _check_common(quantities.values(), columns)
    notes = list(_of_runs(runs, quantities))
    if sources := _add_references(quantities, runs, angles):
        columns.append(Column(REFERENCE, "reference", "", told=", ".join(sources)))
    baseline = next((c for c in columns if c.kind == "posterior"), None)
    compared = [
        quantity
        for quantity in quantities.values()
        if any(cell.status != "known" for cell in quantity.cells.values())
    ]
    compared.sort(key=_order)  # keeps the order of the files within each group
    for quantity in compared:
        _measure(quantity, columns, baseline)
    apart = _runs_apart(compared, columns)
    if len(runs) > 1 and not any(_in_two_runs(quantity, columns) for quantity in compared):
        notes.insert(0, _note("nothing shared"))
    far = _far_estimates(compared, columns, baseline)
    notes += [_note("far estimate", label=label, names=names) for label, names in far.items()]
    return Comparison(
        tuple(columns),
        tuple(compared),
        baseline.label if baseline else None,
        (*apart, *notes),
        tuple(q.name for q in compared if any(q.name in names for names in far.values())),
        {run: summary.reasons for run, summary in runs.items() if summary.reasons},
        apart,
    )


def _note(kind: str, **values: Any) -> str:
    """Word a note; names are all given."""
    values = {key: ", ".join(x) if isinstance(x, list) else x for key, x in values.items()}
    return f"{capital(line_of(kind, values))}."


def _order(quantity: Quantity) -> int:
    if quantity.kind == "total":
        return 0
    if quantity.gauge_free:
        return 1 if quantity.kind == "derived" else 2
    return 3 if quantity.kind == "parameter" else 4


def _columns(prefix: str, run: str, summary: Summary) -> Iterator[Column]:
    for method in METHODS:
        if (table := summary.estimates.get(method)) is not None:
            residual = _residual(table.residual_rms, table.residual_unit)
            words = "; ".join(filter(None, [table.assumption, *table.notes, residual]))
            yield Column(f"{prefix}{method}", "estimate", run, method, words)
    if summary.parameters or summary.derived:
        lag = summary.noise.residual_lag1
        parts = [summary.likelihood.method, f"noise {summary.noise.model}"]
        parts += [f"its residuals' lag-1 correlation is {lag:.2f}"] if lag is not None else []
        parts += [_residual(summary.fit.residual_rms, summary.fit.unit)]
        words = "; ".join(filter(None, parts))
        yield Column(f"{prefix}posterior", "posterior", run, None, words, summary.widened)


def _residual(rms: float | None, unit: str) -> str:
    return "" if rms is None else f"residual rms {rms:.4g} {unit}".strip()


def _file_rows(column: Column, summary: Summary) -> Iterator[tuple[str, Any]]:
    """Give the rows of the file that a column is made of, by name; none of the noise."""
    if column.method is not None:
        yield from summary.estimates[column.method].parameters.items()
        return
    for name, row in (*summary.rows.items(), *summary.fixed.items()):
        if not of_noise(name):
            yield name, row


def _cell(name: str, row: Any, column: Column, summary: Summary) -> ResultRow:
    if isinstance(row, PosteriorRow):
        return posterior_row(name, row, summary.accounts)
    if column.method is None:
        return known_row(name, row.value, row)
    cell = estimate_row(name, row, summary.estimates[column.method].converged)
    why = _not_alike(summary, name, row.unit) if column.method == "least-squares" else ""
    return replace(cell, alike=False, remark=cell.remark or why) if why else cell


def _quantity(
    quantities: dict[str, Quantity], name: str, row: Any, summary: Summary, run: str
) -> Quantity:
    """Give a quantity, with the description that one more file has of it."""
    known = name in summary.parameters or name in summary.fixed
    kind: Kind = "parameter" if known else "derived"
    kind = getattr(row, "kind", None) or ("total" if name.startswith("total.") else kind)
    quantity = quantities.setdefault(name, Quantity(name, row.unit, "", "", kind, run))
    _check_unit(f"{run}: {name}", row.unit, quantity)
    posterior = isinstance(row, PosteriorRow)
    # the joint's own symbol before that of least squares
    quantity.symbol = row.symbol if posterior and row.symbol else quantity.symbol or row.symbol
    quantity.meaning = quantity.meaning or row.meaning
    quantity.of_motion |= posterior and row.of_motion
    if (free := getattr(row, "gauge_free", None)) is not None:
        quantity.gauge_free = free and quantity.gauge_free is not False
    return quantity


def _check_unit(where: str, unit: str, quantity: Quantity) -> None:
    if unit != quantity.unit:
        units = (unit or "no unit", quantity.unit or "no unit")
        what = f"is in {units[0]!r}, but in {units[1]!r} in {quantity.run}"
        raise BadInput(where, what, "compare runs of the same kind of joint, in one unit")


def _not_alike(summary: Summary, name: str, unit: str) -> str:
    """Say why a total of least squares is not what a posterior has by its name; else nothing."""
    if GAIN in summary.parameters and scales_with_torque(unit):
        return "of the torque as recorded, without its gain"
    # load-dependent friction biases the totals, or what shapes other terms
    known = {fixed for fixed, row in summary.fixed.items() if row.value != 0.0}
    rows = (QUANTITIES.get(quantity_of(term)) for term in {*summary.parameters, *known})
    bent = sorted({row.bent_by for row in rows if row is not None and row.bends}, reverse=True)
    share = f"with the share of {listed(bent)} in it"
    return share if bent and name in summary.parameters else ""


def _check_common(quantities: Iterable[Quantity], columns: list[Column]) -> None:
    """Refuse runs without a result, or without any that another has, but for fixed parameters."""
    names: dict[str, set[str]] = {column.run: set() for column in columns}
    for quantity in quantities:
        for column in columns:
            cell = quantity.cells.get(column.label)
            if cell is not None and cell.status != "known":
                names[column.run].add(quantity.name)
    # of two, the second is the one out of place
    for run, own in reversed(names.items()):
        others = set[str]().union(*(theirs for other, theirs in names.items() if other != run))
        if len(names) > 1 and not own & others:
            what = "has no quantity in common with the other runs"
            raise BadInput(run, what, "compare runs whose mechanisms share elements")


def _of_runs(runs: Mapping[str, Summary], quantities: Mapping[str, Quantity]) -> Iterator[str]:
    """Say which runs are not reliable, and what depends on the motion."""
    for run, summary in runs.items():
        if summary.sampler.status != "reliable":
            yield _note("unsure run", run=run, status=summary.sampler.status)
    if names := [name for name, quantity in quantities.items() if quantity.of_motion]:
        yield _note("of motion", names=names, several=len(runs) > 1)


def _in_two_runs(quantity: Quantity, columns: list[Column]) -> bool:
    """Whether two runs determine a quantity, or its limit, and do not doubt it themselves."""
    cells = [quantity.cells.get(c.label) for c in columns if c.kind == "posterior"]
    usable = [c for c in cells if c and c.status in ("determined", "limit") and not c.doubted]
    return len(usable) > 1


def _far_estimates(
    quantities: list[Quantity], columns: list[Column], baseline: Column | None
) -> dict[str, list[str]]:
    """Name what estimates of the first posterior's run give otherwise, by label."""
    labels = [
        c.label for c in columns if c.kind == "estimate" and baseline and c.run == baseline.run
    ]
    far = {
        label: [
            quantity.name
            for quantity in quantities
            if (cell := quantity.cells.get(label)) is not None
            and cell.status == "determined"
            and abs(cell.disagreement or 0.0) > _FAR
        ]
        for label in labels
    }
    return {label: names for label, names in far.items() if names}


def _runs_apart(quantities: list[Quantity], columns: list[Column]) -> tuple[str, ...]:
    """Say in what other runs' posteriors are too far from the first to be of one joint.

    What a run doubts itself, as for a delay or too wide a band, is no news of the joint.
    """
    posteriors = [c for c in columns if c.kind == "posterior"]
    notes = []
    for column in posteriors[1:]:
        first = posteriors[0]
        far = [
            f"{quantity.name} ({cell.disagreement:+.1f} sd)"
            for quantity in quantities
            if (cell := quantity.cells.get(column.label)) is not None
            and abs(cell.disagreement or 0.0) > _FAR
            and not (cell.doubted or quantity.cells[first.label].doubted)
        ]
        notes += [_note("runs apart", run=column.run, first=first.run, names=far)] if far else []
    return tuple(notes)


def _add_references(
    quantities: Mapping[str, Quantity], runs: Mapping[str, Summary], angles: Mapping[str, float]
) -> list[str]:
    """Add values from elsewhere to what is shown, the first of each; give their sources."""
    sources: dict[str, None] = {}
    for run, summary in runs.items():
        for name, reference in summary.references.items():
            quantity = quantities.get(name)
            if quantity is None or all(c.status == "known" for c in quantity.cells.values()):
                continue
            _check_unit(f"{run}: references.{name}", reference.unit, quantity)
            value = unwrapped(reference, angles.get(name)).value
            cell = ResultRow(value, "known", sd=reference.sd, remark=reference.source)
            quantity.cells.setdefault(REFERENCE, cell)
            sources[reference.source] = None
    return list(sources)


def _measure(quantity: Quantity, columns: list[Column], baseline: Column | None) -> None:
    """Put the cells into the columns' order and measure them against the first posterior."""
    quantity.cells = {
        c.label: quantity.cells[c.label] for c in columns if c.label in quantity.cells
    }
    base = quantity.cells.get(baseline.label) if baseline else None
    if baseline is None or base is None or base.status not in ("determined", "limit"):
        return
    for column in columns:
        cell = quantity.cells.get(column.label)
        if cell is None or column is baseline or not cell.alike:
            continue
        # two motions need not agree
        if quantity.of_motion and column.run not in ("", baseline.run):
            continue
        # an estimate has other limits than a posterior
        if column.kind == "estimate" and "limit" in (base.status, cell.status):
            continue
        sd = base.sd_towards(cell.value)
        # what a run fixed is no finding, and what is open agrees with anything
        if sd and (cell.status in ("determined", "bound", "limit") or column.kind == "reference"):
            other = cell.sd_towards(base.value) or 0.0
            # two estimates from one recording share its noise: their variances do not add
            same = column.kind == "estimate" and column.run == baseline.run
            apart = (cell.value - base.value) / (max(sd, other) if same else math.hypot(sd, other))
            quantity.cells[column.label] = replace(cell, disagreement=apart)


def comparison_text(compared: Comparison, width: int = _WIDTH) -> Iterator[str]:
    """Lay a comparison out for a terminal; columns that do not fit come in further blocks."""
    from rich.box import SIMPLE_HEAD  # a page does without
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(width=width, file=StringIO(), color_system=None)
    left = max((len(row.name) for row in compared.rows), default=0)
    across = max(1, (width - left) // (_NARROWEST + 2))
    for first in range(0, len(compared.columns), across):
        columns = compared.columns[first : first + across]
        table = Table(box=SIMPLE_HEAD, pad_edge=False)
        table.add_column(no_wrap=True)
        for column in columns:
            table.add_column(Text(column.label), max_width=_WIDEST)
        group = None
        for row in compared.rows:
            cells = ["\n".join(_cell_lines(row.cells.get(c.label))) for c in columns]
            if not any(cells):
                continue
            if group is not None and group != (row.kind, row.gauge_free):
                table.add_row()
            group = (row.kind, row.gauge_free)
            name = f"{row.name}\n  {row.unit}" if row.unit else row.name
            table.add_row(*map(Text, (name, *cells)))
        with console.capture() as captured:
            console.print(table)
        yield from (line.rstrip() for line in captured.get().splitlines())
    for line in explained(compared):
        yield from textwrap.wrap(line, width, subsequent_indent="  ")


def _cell_lines(cell: ResultRow | None) -> list[str]:
    parts = cell.parts(TEXT) if cell else ()
    return [f"{text}{_PLAIN}" if kind == "plain" else text for kind, text in parts]


def comparison_csv(compared: Comparison) -> str:
    """Lay a comparison out as CSV text, one line for each quantity and column."""
    lines: list[dict[str, Any]] = []
    for row in compared.rows:
        for label, cell in row.cells.items():
            low, high = cell.interval or (None, None)
            line = vars(cell) | {"low": low, "high": high, "column": label}
            line |= {"status": "doubtful"} if cell.doubted else {}
            lines.append(line | {"name": row.name, "unit": row.unit})
    return csv_text(lines, _CSV)


def comparison_dict(compared: Comparison) -> dict[str, Any]:
    """Put a comparison into strings, numbers, lists and dicts, ready for JSON."""
    quantities = {}
    for row in compared.rows:
        keys = ("unit", "symbol", "meaning", "kind", "gauge_free", "of_motion")
        cells = {
            label: {key: getattr(cell, key) for key in _JSON} for label, cell in row.cells.items()
        }
        quantities[row.name] = {key: getattr(row, key) for key in keys} | {"columns": cells}
    return {
        "baseline": compared.baseline,
        "columns": [asdict(column) for column in compared.columns],
        "quantities": quantities,
        "notes": list(compared.notes),
    }


def explained(compared: Comparison) -> Iterator[str]:
    """Say what the numbers are and what they assume."""
    cells = [cell for row in compared.rows for cell in row.cells.values()]
    yield from filled(
        "explained.txt.j2",
        compared=compared,
        plain=any(cell.plain for cell in cells),
        levels=sorted({cell.level for cell in cells if cell.interval is not None and cell.level}),
        dagger=_PLAIN,
    ).splitlines()
    yield from compared.notes
