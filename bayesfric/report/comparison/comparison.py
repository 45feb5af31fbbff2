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
from bayesfric.mechanism.quantities import QUANTITIES, quantity_of, scales_with_torque
from bayesfric.report.numbers import TEXT
from bayesfric.report.result_row import (
    GROUPS,
    ResultRow,
    estimate_row,
    known_row,
    posterior_row,
)
from bayesfric.report.summary.record import (
    GAIN,
    Readable,
    Summary,
    first_angles,
    of_noise,
    unwrapped,
)
from bayesfric.report.words import filled, line_of, listed

REFERENCE = "reference"
# Standard deviations of the posterior beyond which an estimate disagrees.
_FAR = 3.0


@dataclass(frozen=True)
class Column:
    """A method, a posterior, or values from elsewhere."""

    label: str  # as printed, unique
    kind: Literal["estimate", "posterior", "reference"]
    run: str  # name of the run; empty for references
    method: Method | None = None  # of an estimate
    assumes: str = ""  # what its numbers assume, or where they are from
    widened: bool = False  # whether its sds and intervals allow for model discrepancy


@dataclass
class Quantity:
    """One quantity; ``cells`` by column label, those that have it."""

    name: str
    unit: str
    symbol: str  # LaTeX without dollar signs
    meaning: str
    group: str
    cells: dict[str, ResultRow] = field(default_factory=dict)

    @property
    def of_motion(self) -> bool:
        """Whether another motion of the same joint has another value."""
        return any(c.posterior is not None and c.posterior.of_motion for c in self.cells.values())


@dataclass(frozen=True)
class Comparison:
    """Quantities by columns, in the order to print them."""

    columns: tuple[Column, ...]
    rows: tuple[Quantity, ...]
    baseline: str | None  # label of the posterior that disagreement is measured against, if any
    notes: tuple[str, ...]  # one sentence each; first in what other runs are far from the first
    # names of the rows in which an estimate of the first posterior's run is far from it
    contested: tuple[str, ...] = ()
    runs_apart: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> Quantity:
        return {row.name: row for row in self.rows}[name]

    @property
    def cells(self) -> list[ResultRow]:
        """Every number."""
        return [cell for row in self.rows for cell in row.cells.values()]


def comparison(summaries: Mapping[str, Readable], *, estimates: bool | None = None) -> Comparison:
    """Compare the results of one or several runs, each by what its ``summary.json`` holds.

    ``estimates`` is whether to show point estimates; by default of a single run only. ``BadInput``
    where units differ, or a run has no quantity in common with any other.

    Disagreement is ``(value - median)/sd`` with both of the first posterior, of what is skewed the
    sd on the side of the other. The variance of another posterior or of a reference is added; of
    an estimate of the same run, which used the same data, the larger of the two sds counts.
    """
    runs = {name: Summary.read(run, name) for name, run in summaries.items()}
    estimates = len(runs) == 1 if estimates is None else estimates
    angles = first_angles(run.parameters for run in runs.values())
    quantities: dict[str, Quantity] = {}
    columns: list[Column] = []
    results: dict[str, set[str]] = {}  # names of what each run determines, open or not
    for run, summary in runs.items():
        prefix = f"{run}: " if len(runs) > 1 else ""
        shown = [c for c in _columns(prefix, run, summary) if estimates or c.method is None]
        if not shown:
            raise BadInput(run, "holds no result to compare", "name a finished run")
        columns += shown
        cells = [(column, cell) for column in shown for cell in _cells(column, summary, angles)]
        for column, cell in cells:
            quantity = _quantity(quantities, f"{run}: {cell.name}", cell, summary)
            quantity.cells[column.label] = cell
        results[run] = {cell.name for _, cell in cells if cell.status != "known"}
    # of two, the second is the one out of place
    for run, names in reversed(results.items()):
        others = [theirs for other, theirs in results.items() if other != run]
        if others and names.isdisjoint(set[str]().union(*others)):
            problem = "has no quantity in common with the other runs"
            raise BadInput(run, problem, "compare runs whose mechanisms share elements")
    every = set[str]().union(*results.values())
    order = [*GROUPS]
    compared = sorted(
        (x for x in quantities.values() if x.name in every), key=lambda x: order.index(x.group)
    )
    if sources := _add_references(quantities, runs, angles):
        columns.append(Column(REFERENCE, "reference", "", assumes=", ".join(sources)))
    baseline = next((column for column in columns if column.kind == "posterior"), None)
    if baseline is None:
        return Comparison(tuple(columns), tuple(compared), None, ())
    for quantity in compared:
        _measure(quantity, columns, baseline)
    notes, contested, apart = [], list[str](), []
    for run, summary in runs.items():
        if summary.sampler.status != "reliable":
            notes.append(_note("unsure run", run=run, status=summary.sampler.status))
    if moving := [quantity.name for quantity in compared if quantity.of_motion]:
        notes.append(_note("of motion", names=moving, several=len(runs) > 1))
    for column in columns:
        far = _far(compared, column, baseline)
        if far and column.kind == "estimate":
            notes.append(_note("far estimate", label=column.label, names=[*far]))
            contested += far
        elif far and column.kind == "posterior":
            shifts = [f"{name} ({by:+.1f} sd)" for name, by in far.items()]
            apart.append(_note("runs apart", run=column.run, first=baseline.run, names=shifts))
    return Comparison(
        tuple(columns),
        tuple(compared),
        baseline.label,
        (*apart, *notes),
        tuple(quantity.name for quantity in compared if quantity.name in contested),
        tuple(apart),
    )


def _note(kind: str, **values: Any) -> str:
    """Word a note; names are all listed."""
    values = {key: ", ".join(x) if isinstance(x, list) else x for key, x in values.items()}
    return f"{capital(line_of(kind, values))}."


def _columns(prefix: str, run: str, summary: Summary) -> Iterator[Column]:
    def rms(value: float | None, unit: str) -> list[str]:
        return [] if value is None else [f"residual rms {value:.4g} {unit}".strip()]

    for method in METHODS:
        if (table := summary.estimates.get(method)) is not None:
            words = [table.assumption, *table.notes, *rms(table.residual_rms, table.residual_unit)]
            yield Column(prefix + method, "estimate", run, method, "; ".join(filter(None, words)))
    if summary.rows:
        noise, words = summary.noise, [summary.likelihood["method"], f"noise {summary.noise.model}"]
        if noise.residual_lag1 is not None:
            words.append(f"its residuals' lag-1 correlation is {noise.residual_lag1:.2f}")
        assumes = "; ".join(words + rms(summary.fit.residual_rms, summary.fit.unit))
        yield Column(f"{prefix}posterior", "posterior", run, None, assumes, summary.widened)


def _cells(column: Column, summary: Summary, angles: Mapping[str, float]) -> Iterator[ResultRow]:
    """Give a column's numbers; none of the noise."""
    if column.method is not None:
        table = summary.estimates[column.method]
        for name, row in table.parameters.items():
            cell = estimate_row(name, unwrapped(row, angles.get(name)), table.converged)
            if column.method == "least-squares" and (why := _not_alike(summary, name, row.unit)):
                cell = replace(cell, alike=False, remark=cell.remark or why)
            yield cell
        return
    for name, posterior in summary.rows.items():
        if not of_noise(name):
            yield posterior_row(name, unwrapped(posterior, angles.get(name)), summary)
    for name, fixed in summary.fixed.items():
        yield known_row(name, unwrapped(fixed, angles.get(name)))


def _quantity(
    quantities: dict[str, Quantity], where: str, cell: ResultRow, summary: Summary
) -> Quantity:
    """Give the quantity of a number, which is in one unit in all columns."""
    name, derived = cell.name, summary.derived.get(cell.name)
    group = "parameter" if name in summary.parameters or name in summary.fixed else "derived"
    if name.startswith("total") or (derived is not None and derived.gauge_free):
        group = "free"
    described = (cell.unit, cell.symbol, cell.meaning, group)
    quantity = quantities.setdefault(name, Quantity(name, *described))
    if cell.unit != quantity.unit:
        problem = f"is in {cell.unit or 'no unit'!r}, not in {quantity.unit or 'no unit'!r}"
        raise BadInput(where, problem, "compare runs of the same kind of joint, in one unit")
    # the joint's own symbol before that of least squares
    if cell.symbol and (cell.posterior is not None or not quantity.symbol):
        quantity.symbol = cell.symbol
    return quantity


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


def _far(compared: list[Quantity], column: Column, baseline: Column) -> dict[str, float]:
    """Name what a column gives otherwise than the first posterior, and by how many sds.

    What a run doubts itself, as for a delay or too wide a band, is no news of the joint; estimates
    of another run saw other data.
    """
    far = {}
    for quantity in compared:
        cell, base = (quantity.cells.get(x.label) for x in (column, baseline))
        if cell is None or base is None or abs(cell.disagreement or 0.0) <= _FAR:
            continue
        doubted = "doubtful" in (cell.status, base.status)
        estimate = cell.status == "identified" and column.run == baseline.run
        if estimate if column.kind == "estimate" else not doubted:
            far[quantity.name] = float(cell.disagreement or 0.0)
    return far


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
            row = known_row(name, unwrapped(reference, angles.get(name)))
            _quantity({name: quantity}, f"{run}: references.{name}", row, summary)
            row = replace(row, sd=reference.sd, remark=reference.source)
            quantity.cells.setdefault(REFERENCE, row)
            sources[reference.source] = None
    return list(sources)


def _measure(quantity: Quantity, columns: list[Column], baseline: Column) -> None:
    """Measure the numbers of a quantity against the first posterior's."""
    base = quantity.cells.get(baseline.label)
    if base is None or not base.informed:
        return
    for column in columns:
        cell = quantity.cells.get(column.label)
        if cell is None or column is baseline or not cell.alike or not cell.informed:
            continue
        # two motions need not agree
        if quantity.of_motion and column.run not in ("", baseline.run):
            continue
        # an estimate has other limits than a posterior
        if column.kind == "estimate" and (base.limit is not None or cell.limit is not None):
            continue
        # what a run fixed is no result
        if (sd := base.sd_towards(cell.value)) and (cell.status != "known" or not column.run):
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

    console = Console(width=width, file=(printed := StringIO()), color_system=None)
    left = max((len(row.name) for row in compared.rows), default=0)
    # at least [0.00046688, 0.00046933] fits
    across = max(1, (width - left) // 26)
    for first in range(0, len(compared.columns), across):
        columns = compared.columns[first : first + across]
        table = Table(box=SIMPLE_HEAD, pad_edge=False)
        table.add_column(no_wrap=True)
        for column in columns:
            table.add_column(Text(column.label), max_width=30)
        for _, rows in groupby(compared.rows, key=lambda row: row.group):
            if table.row_count:
                table.add_row()
            for row in rows:
                cells = [row.cells.get(column.label) for column in columns]
                if any(cells):
                    name = f"{row.name}\n  {row.unit}" if row.unit else row.name
                    texts = ["\n".join(cell.lines(TEXT)) if cell else "" for cell in cells]
                    table.add_row(*map(Text, (name, *texts)))
        console.print(table)
    yield from (line.rstrip() for line in printed.getvalue().splitlines())
    for line in explained(compared):
        yield from textwrap.wrap(line, width, subsequent_indent="  ")


def comparison_dict(compared: Comparison) -> dict[str, Any]:
    """Put a comparison into strings, numbers, lists and dicts: ``rows`` are those of its CSV."""
    keys = ("value", "status", "sd", "level", "limit", "bound", "plain", "remark", "disagreement")
    rows = []
    for row in compared.rows:
        described = {key: getattr(row, key) for key in ("name", "unit", "symbol", "group")}
        for label, cell in row.cells.items():
            low, high = cell.interval or (None, None)
            line = described | {"column": label} | {key: getattr(cell, key) for key in keys}
            rows.append(line | {"low": low, "high": high})
    return {
        "baseline": compared.baseline,
        "columns": [asdict(column) for column in compared.columns],
        "rows": rows,
        "notes": list(compared.notes),
    }


def explained(compared: Comparison) -> Iterator[str]:
    """Say what the numbers are and what they assume."""
    levels = sorted({c.level for c in compared.cells if c.interval is not None and c.level})
    plain = any(cell.plain for cell in compared.cells)
    text = filled("explained.txt.j2", compared=compared, plain=plain, levels=levels)
    yield from text.splitlines()
    yield from compared.notes
