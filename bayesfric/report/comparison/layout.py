"""A comparison as a table: for a terminal, as CSV and as JSON."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from dataclasses import asdict
from io import StringIO
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bayesfric.report.comparison.cell import Cell
from bayesfric.report.comparison.comparison import Comparison
from bayesfric.report.numbers import TEXT
from bayesfric.report.text_templates import csv_text, filled

_WIDTH = 120
# Characters of a cell's line: at least [0.00046688, 0.00046933], and words on few lines.
_NARROWEST, _WIDEST = 24, 30
_PLAIN = "†"
_COLUMNS = ["name", "unit", "symbol", "meaning", "kind", "gauge_free", "column", "run",
    "column_kind", "status", "value", "sd", "sd_uncorrelated", "accounts_for_correlation", "low",
    "high", "level", "span_low", "span_high", "limit", "disagreement", "remark"]  # fmt: skip


def comparison_text(found: Comparison, width: int = _WIDTH) -> Iterator[str]:
    """Lay a comparison out for a terminal; columns that do not fit come in further blocks."""
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
