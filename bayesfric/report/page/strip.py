"""A strip beside a number: prior, interval, other methods and reference on one axis."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from bayesfric.report.comparison.cell import Cell
from bayesfric.report.comparison.comparison import Column, Comparison
from bayesfric.report.paper.tables import ParameterRow
from bayesfric.report.summary.rows import HALF

MarkKind = Literal["prior", "interval", "estimate", "reference"]

# What is further from the interval than so many of its widths is drawn at the axis's end.
_FAR = 8.0
# Share of the axis that is left free at either end.
_FREE = 0.06


@dataclass(frozen=True)
class Mark:
    """One thing on the axis: places in per cent of it, which they may be cut to."""

    kind: MarkKind
    label: str
    low: float
    high: float
    at: float | None  # of a value; none of a prior
    line: int  # 0 for the posterior, then one for each method
    beyond: str = ""  # `low` or `high` where the value is off the axis


@dataclass(frozen=True)
class Strip:
    """A number's axis and what is on it, in the unit of the number."""

    low: float
    high: float
    marks: tuple[Mark, ...]
    words: str  # for who cannot see it


@dataclass(frozen=True)
class _Told:
    kind: MarkKind
    label: str
    low: float
    high: float
    at: float | None
    line: int


def strips(rows: Iterable[ParameterRow], found: Comparison) -> dict[str, Strip]:
    """Make a strip of each determined or limited number, by name."""
    columns = [c for c in found.columns if c.kind != "posterior"]
    cells = {row.name: row.cells for row in found.rows}
    made = {}
    for row in rows:
        told = list(_told(row, columns, cells.get(row.name, {})))
        interval = next((one for one in told if one.kind == "interval"), None)
        if interval is not None and interval.high > interval.low:
            made[row.name] = _strip(row, told, interval)
    return made


def methods_of(made: Iterable[Strip]) -> list[tuple[str, int]]:
    """Name the methods that strips show, for a legend, each with its line."""
    marks = [m for strip in made for m in strip.marks if m.kind == "estimate"]
    return sorted({(m.label, m.line) for m in marks}, key=lambda one: one[1])


def _told(row: ParameterRow, columns: list[Column], cells: Mapping[str, Cell]) -> Iterator[_Told]:
    if row.row is None or row.cited is None:
        return
    if row.row.prior_interval:
        low, high = row.row.prior_interval
        yield _Told("prior", "prior", low, high, None, 0)
    if row.cell.status == "determined":
        middle, low, high, _ = row.cited
        yield _Told("interval", "posterior", low, high, middle, 0)
    elif row.cell.limit is not None and row.row.bound is not None:
        low, high = sorted((row.row.bound, row.cell.limit))
        yield _Told("interval", "posterior", low, high, None, 0)
    line = 0
    for column in columns:
        line += column.kind == "estimate"
        cell = cells.get(column.label)
        if cell is None or (column.kind == "estimate" and cell.status != "determined"):
            continue
        reach = HALF * (cell.sd or 0.0)
        low, high = cell.value - reach, cell.value + reach
        if column.kind == "estimate":
            yield _Told("estimate", column.label, low, high, cell.value, line)
        else:
            yield _Told("reference", cell.remark or column.label, low, high, cell.value, 0)


def _strip(row: ParameterRow, told: list[_Told], interval: _Told) -> Strip:
    width = interval.high - interval.low
    least, most = interval.low - _FAR * width, interval.high + _FAR * width
    shown = [one for one in told if one.kind != "prior"]
    low = max(least, min(one.low for one in shown))
    high = min(most, max(one.high for one in shown))
    free = _FREE * (high - low)
    # there is nothing beyond a bound
    bound = row.row.bound if row.row is not None and row.by == "limit" else None
    low, high = low - free * (low != bound), high + free * (high != bound)

    def place(x: float) -> float:
        return 100.0 * min(max((x - low) / (high - low), 0.0), 1.0)

    marks = [
        Mark(
            one.kind,
            one.label,
            place(one.low),
            place(one.high),
            None if one.at is None else place(one.at),
            one.line,
            "" if one.at is None or low <= one.at <= high else "low" if one.at < low else "high",
        )
        for one in told
    ]
    unit = f" {row.unit}" if row.unit else ""
    said = "; ".join(
        f"{one.label} {one.low:.4g} to {one.high:.4g}"
        + (f" around {one.at:.4g}" if one.at is not None and one.high > one.low else "")
        for one in told
    )
    return Strip(
        low,
        high,
        tuple(marks),
        f"{row.meaning or row.name}, on one axis{unit and ' in' + unit}: {said}.",
    )
