"""Comparison of every method, every run's posterior and values from elsewhere.

A number that the data leave open has no standard deviation and no interval, whatever a file says:
its remark says so. Nor is its distance to anything measured.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from io import StringIO
from itertools import groupby
from typing import Any, Literal

from bayesfric.base.errors import BadInput
from bayesfric.base.templates import capital
from bayesfric.estimates import METHODS, Method
from bayesfric.estimates.point_estimate import Kind
from bayesfric.mechanism.quantities import QUANTITIES, quantity_of, scales_with_torque
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
_PLAIN = "†"
# What JSON has of each ResultRow, and CSV next to the names, with the ends of the interval.
_KEYS = ("value", "status", "sd", "sd_plain", "accounts", "interval", "level", "span", "limit",
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

    ``estimates`` is whether to show point estimates; by default of a single run only. ``BadInput``
    where units differ, or a run has no quantity in common with any other.

    Disagreement is ``(value - median)/sd`` with both of the first posterior, of what is skewed the
    sd on the side of the other. The variance of another posterior or of a reference is added; of
    an estimate of the same run, which used the same data, the larger of the two sds counts.
    """
    runs = {name: Summary.read(run, name) for name, run in summaries.items()}
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
            for name, row, cell in _cells(column, summary, angles):
                # estimates describe quantities even where they are not shown
                quantity = _quantity(quantities, name, row, summary, run)
                if column in shown:
                    quantity.cells[column.label] = cell
    for quantity in quantities.values():
        if quantity.gauge_free is None:
            # the data alone leave what a scaling changes without any sd
            rows = [s.parameters.get(quantity.name) for s in runs.values()]
            quantity.gauge_free = all(row.data_sd is not None for row in rows if row is not None)
    _check_common([*quantities.values()], columns)
    notes = [
        _note("unsure run", run=run, status=summary.sampler.status)
        for run, summary in runs.items()
        if summary.sampler.status != "reliable"
    ]
    if names := [name for name, quantity in quantities.items() if quantity.of_motion]:
        notes.append(_note("of motion", names=names, several=len(runs) > 1))
    if sources := _add_references(quantities, runs, angles):
        columns.append(Column(REFERENCE, "reference", "", told=", ".join(sources)))
    posteriors = [column for column in columns if column.kind == "posterior"]
    baseline = posteriors[0] if posteriors else None
    compared = [
        quantity
        for quantity in quantities.values()
        if any(cell.status != "known" for cell in quantity.cells.values())
    ]
    order = ("total", True), ("derived", True), ("parameter", True), ("parameter", False)
    places = {key: k for k, key in enumerate(order)} | {("total", False): 0}
    # keeps the order of the files within each group
    compared.sort(key=lambda row: places.get((row.kind, bool(row.gauge_free)), len(order)))
    for quantity in compared:
        _measure(quantity, columns, baseline)
    contested = []
    for column in columns:
        same = baseline is not None and column.run == baseline.run
        if column.kind == "estimate" and same and (names := _far(compared, column, baseline)):
            notes.append(_note("far estimate", label=column.label, names=names))
            contested += names
    apart = tuple(
        _note("runs apart", run=column.run, first=posteriors[0].run, names=names)
        for column in posteriors[1:]
        if (names := _far(compared, column, baseline))
    )
    return Comparison(
        tuple(columns),
        tuple(compared),
        baseline.label if baseline else None,
        (*apart, *notes),
        tuple(quantity.name for quantity in compared if quantity.name in contested),
        {run: summary.reasons for run, summary in runs.items() if summary.reasons},
        apart,
    )


def _note(kind: str, **values: Any) -> str:
    """Word a note; names are all given."""
    values = {key: ", ".join(x) if isinstance(x, list) else x for key, x in values.items()}
    return f"{capital(line_of(kind, values))}."


def _columns(prefix: str, run: str, summary: Summary) -> Iterator[Column]:
    def rms(value: float | None, unit: str) -> list[str]:
        return [] if value is None else [f"residual rms {value:.4g} {unit}".strip()]

    for method in METHODS:
        if (table := summary.estimates.get(method)) is not None:
            words = [table.assumption, *table.notes]
            words += rms(table.residual_rms, table.residual_unit)
            told = "; ".join(filter(None, words))
            yield Column(f"{prefix}{method}", "estimate", run, method, told)
    if summary.rows:
        noise, words = summary.noise, [summary.likelihood["method"], f"noise {summary.noise.model}"]
        if noise.residual_lag1 is not None:
            words.append(f"its residuals' lag-1 correlation is {noise.residual_lag1:.2f}")
        told = "; ".join(words + rms(summary.fit.residual_rms, summary.fit.unit))
        yield Column(f"{prefix}posterior", "posterior", run, None, told, summary.widened)


def _cells(
    column: Column, summary: Summary, angles: Mapping[str, float]
) -> Iterator[tuple[str, Any, ResultRow]]:
    """Give name, row of the file, and judgement of a column's numbers; none of the noise."""
    if column.method is not None:
        table = summary.estimates[column.method]
        for name, row in table.parameters.items():
            cell = estimate_row(name, unwrapped(row, angles.get(name)), table.converged)
            if column.method == "least-squares" and (why := _not_alike(summary, name, row.unit)):
                cell = replace(cell, alike=False, remark=cell.remark or why)
            yield name, row, cell
        return
    for name, posterior in summary.rows.items():
        if not of_noise(name):
            aligned = unwrapped(posterior, angles.get(name))
            yield name, posterior, posterior_row(name, aligned, summary.accounts)
    for name, fixed in summary.fixed.items():
        yield name, fixed, known_row(name, unwrapped(fixed, angles.get(name)).value, fixed)


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
        problem = f"is in {units[0]!r}, but in {units[1]!r} in {quantity.run}"
        raise BadInput(where, problem, "compare runs of the same kind of joint, in one unit")


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


def _check_common(quantities: list[Quantity], columns: list[Column]) -> None:
    """Refuse runs without a result, or without any that another has, but for fixed parameters."""
    names: dict[str, set[str]] = {}
    for column in columns:
        cells = {quantity.name: quantity.cells.get(column.label) for quantity in quantities}
        results = {name for name, cell in cells.items() if cell and cell.status != "known"}
        names[column.run] = names.get(column.run, set()) | results
    # of two, the second is the one out of place
    for run, results in reversed(names.items()):
        others = [theirs for other, theirs in names.items() if other != run]
        if others and results.isdisjoint(set[str]().union(*others)):
            problem = "has no quantity in common with the other runs"
            raise BadInput(run, problem, "compare runs whose mechanisms share elements")


def _far(quantities: list[Quantity], column: Column, baseline: Column | None) -> list[str]:
    """Name what a column gives otherwise than the first posterior.

    What a run doubts itself, as for a delay or too wide a band, is no news of the joint.
    """
    names = []
    for quantity in quantities:
        cell = quantity.cells.get(column.label)
        if cell is None or baseline is None or abs(cell.disagreement or 0.0) <= _FAR:
            continue
        if column.kind == "estimate" and cell.status == "determined":
            names.append(quantity.name)
        doubted = cell.doubted or quantity.cells[baseline.label].doubted
        if column.kind == "posterior" and not doubted:
            names.append(f"{quantity.name} ({cell.disagreement:+.1f} sd)")
    return names


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


def comparison_text(compared: Comparison, width: int = 120) -> Iterator[str]:
    """Lay a comparison out for a terminal; columns that do not fit come in further blocks."""
    from rich.box import SIMPLE_HEAD  # a page does without
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    printed = StringIO()
    console = Console(width=width, file=printed, color_system=None)
    left = max((len(row.name) for row in compared.rows), default=0)
    # at least [0.00046688, 0.00046933] fits
    across = max(1, (width - left) // 26)
    for first in range(0, len(compared.columns), across):
        columns = compared.columns[first : first + across]
        table = Table(box=SIMPLE_HEAD, pad_edge=False)
        table.add_column(no_wrap=True)
        for column in columns:
            table.add_column(Text(column.label), max_width=30)
        for _, rows in groupby(compared.rows, key=lambda row: (row.kind, row.gauge_free)):
            if table.row_count:
                table.add_row()
            for row in rows:
                cells = [_cell_text(row.cells.get(column.label)) for column in columns]
                if any(cells):
                    name = f"{row.name}\n  {row.unit}" if row.unit else row.name
                    table.add_row(*map(Text, (name, *cells)))
        console.print(table)
    yield from (line.rstrip() for line in printed.getvalue().splitlines())
    for line in explained(compared):
        yield from textwrap.wrap(line, width, subsequent_indent="  ")


def _cell_text(cell: ResultRow | None) -> str:
    parts = cell.parts(TEXT) if cell else ()
    return "\n".join(text + _PLAIN * (kind == "plain") for kind, text in parts)


def comparison_csv(compared: Comparison) -> str:
    """Lay a comparison out as CSV text, one line for each quantity and column."""
    lines: list[dict[str, Any]] = []
    for row in compared.rows:
        for label, cell in row.cells.items():
            line = {"name": row.name, "unit": row.unit, "column": label, **_record(cell)}
            line["low"], line["high"] = line.pop("interval") or (None, None)
            line["status"] = "doubtful" if cell.doubted else cell.status
            lines.append(line)
    return csv_text(lines, [key for key in (lines[0] if lines else ["name"]) if key != "span"])


def _record(cell: ResultRow) -> dict[str, Any]:
    return {key: getattr(cell, key) for key in _KEYS}


def comparison_dict(compared: Comparison) -> dict[str, Any]:
    """Put a comparison into strings, numbers, lists and dicts, ready for JSON."""
    keys = ("unit", "symbol", "meaning", "kind", "gauge_free", "of_motion")
    return {
        "baseline": compared.baseline,
        "columns": [asdict(column) for column in compared.columns],
        "quantities": {
            row.name: {key: getattr(row, key) for key in keys}
            | {"columns": {label: _record(cell) for label, cell in row.cells.items()}}
            for row in compared.rows
        },
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
