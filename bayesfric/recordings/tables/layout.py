"""Finding delimiter, header and first row of a delimited text file.

Promised to hostile input, which pandas' own sniffing is not: a decimal comma, a row of numbers
above the table and a header of another width are refused with their line, instead of read as
something else; lines above the table and a row of units are skipped and told.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from bayesfric.errors import BadInput
from bayesfric.recordings.tables.reader import TableOptions
from bayesfric.recordings.tables.table import is_number

_CANDIDATES = (",", ";", "\t", "|", "whitespace")
_LONGEST_LINE = 1_000_000
_NO_TABLE = "check delimiter, decimal and skip_rows, or whether this is a text table at all"
_MISSING = {"", "nan", "na", "n/a", "null", "none", "inf", "-inf", "-", "--", "?"}


@dataclass(frozen=True)
class Layout:
    """Where the numbers of a text file are."""

    delimiter: str  # one character, or "whitespace"
    width: int  # number of columns
    names: tuple[str, ...]  # the header, one a column (empty strings without a header)
    header_line: int | None  # index from 0 of the header's line
    first: int  # index from 0 of the first row's line
    notes: tuple[str, ...]  # one sentence for every choice made
    units: tuple[str, ...] = ()  # a row of units below the header, where there is one


class _Row(NamedTuple):
    """A line that is not blank: its index from 0, its cells, and which of them are numbers."""

    line: int
    cells: list[str]
    numbers: list[bool]


def split(line: str, delimiter: str) -> list[str]:
    """Split a line into its cells, without quotes and surrounding spaces."""
    if delimiter == "whitespace":
        return [cell.strip('"') for cell in line.split()]
    if '"' not in line:
        return [cell.strip() for cell in line.split(delimiter)] if line else []
    try:
        cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:  # a cell of more than 131072 characters
        return [line]
    return [cell.strip() for cell in cells]


def find_layout(path: Path, head: Sequence[str], options: TableOptions) -> Layout:
    """Find the layout from a file's first lines; what ``options`` say is not guessed."""
    lines = [(i, text) for i, text in enumerate(head) if i >= options.skip_rows]
    for i, text in lines:
        if len(text) > _LONGEST_LINE:
            raise BadInput(
                f"{path}, line {i + 1}",
                f"has {len(text)} characters",
                "write one row a sample, with the recording's columns only",
            )
    lines = [(i, text) for i, text in lines if text.strip()]
    if not lines:
        raise BadInput(
            str(path),
            f"is empty after {options.skip_rows:.10g} skipped lines",
            "check skip_rows and whether the recorder wrote anything",
        )
    delimiter = options.delimiter or _find_delimiter([text for _, text in lines], options.decimal)
    delimiter = {"tab": "\t", " ": "whitespace"}.get(delimiter, delimiter)
    if options.delimiter is None and options.decimal == ".":
        _refuse_decimal_comma(path, lines, delimiter)
    rows = [
        _Row(i, cells, [is_number(cell, options.decimal) for cell in cells])
        for i, cells in ((i, split(text, delimiter)) for i, text in lines)
    ]
    if options.header is not None:
        header, first = (0, 1) if options.header else (None, 0)
        width, notes = len(rows[0].cells), list[str]()
    else:
        width = _width([row.numbers for row in rows])
        if width == 0 and len(rows) > 2:
            raise BadInput(
                f"{path}, line {rows[-1].line + 1}",
                f"no cell is a number ('{rows[-1].cells[0][:40]}')",
                _NO_TABLE,
            )
        header, first, notes = _find_header(path, rows, width) if width else (0, len(rows), [])
    if first >= len(rows):
        raise BadInput(
            str(path), "holds a header but no row of numbers", "check the recorder's export"
        )
    names, line = [""] * width, None
    if header is not None:
        line, names, _ = rows[header]
        names[0] = names[0].lstrip("#").strip()
    row = rows[header + 1].cells if header is not None and first - header == 2 else []
    given = tuple(cell.strip("[]()") for cell in row)
    return Layout(delimiter, width, tuple(names), line, rows[first].line, tuple(notes), given)


def _find_header(path: Path, rows: Sequence[_Row], width: int) -> tuple[int | None, int, list[str]]:
    """Find header and first row of the table of ``width`` columns, with what there is to say."""
    like = [len(row.cells) == width for row in rows]
    fitting = (n for n, row in enumerate(rows) if like[n] and 2 * sum(row.numbers) >= width)
    begin = next(fitting, -1)
    if begin < 0:
        raise BadInput(
            f"{path}, line {rows[-1].line + 1}", "in no row is half of the cells numbers", _NO_TABLE
        )
    for n, row in enumerate(rows[:begin]):
        # a row of numbers above the rest can only be data that would be lost unseen
        if all(row.numbers):
            raise BadInput(
                f"{path}, line {row.line + 1}",
                f"has {len(row.cells)} cells, the rows below have {width}",
                "correct the row, or set skip_rows if it is no row of the table",
            )
        if like[n] and any(row.numbers):
            begin = n
            break
    top = begin
    while top > 0 and like[top - 1] and not any(rows[top - 1].numbers):
        top -= 1
    notes = []
    header = top if top < begin else None
    if header is None:
        for above, row in pairwise(rows[:top]):
            if len(above.cells) == width > 1 and all(above.cells) and any(row.numbers):
                raise BadInput(
                    f"{path}, line {row.line + 1}",
                    f"has {len(row.cells)} cells, the header in line {above.line + 1} has {width}",
                    "correct the row, or set skip_rows if it is no row of the table",
                )
    elif begin - header == 2 and not any(c.casefold() in _MISSING for c in rows[header + 1].cells):
        notes.append(f"line {rows[header + 1].line + 1} taken as a row of units and skipped")
    else:
        begin = header + 1
    if top > 0:
        notes.append(f"{rows[top].line} lines above the table skipped")
    return header, begin, notes


def _find_delimiter(lines: Sequence[str], decimal: str) -> str:
    """Return the delimiter that makes most cells numbers."""
    best, most = ",", 0
    for candidate in _CANDIDATES:
        if candidate == decimal:
            continue
        flags = [[is_number(c, decimal) for c in split(line, candidate)] for line in lines]
        width = _width(flags)
        count = sum(sum(f) for f in flags if len(f) == width) if width > 1 else 0
        if count > most:
            best, most = candidate, count
    if most == 0 and not any(best in line for line in lines):
        # one column, or nothing readable: let the character that comes most decide
        counts = Counter(c for line in lines for c in line if c in ",;\t|" and c != decimal)
        best = counts.most_common(1)[0][0] if counts else ("," if decimal != "," else ";")
    return best


def _width(flags: Sequence[Sequence[bool]]) -> int:
    """Return the number of columns most lines with numbers have, 0 if there are none."""
    counts = Counter[int]()
    for line in flags:
        counts[len(line)] += sum(line)
    width, weight = max(counts.items(), key=lambda item: (item[1], item[0]), default=(0, 0))
    return width if weight else 0


def _refuse_decimal_comma(path: Path, lines: Sequence[tuple[int, str]], delimiter: str) -> None:
    def readable(text: str, by: str, decimal: str) -> bool:
        cells = split(text, by)
        return len(cells) > 1 and all(is_number(cell, decimal) for cell in cells)

    if any(readable(text, delimiter, ".") for _, text in lines):
        return
    for other in (";", "\t", "whitespace", "|"):
        for line, text in lines:
            if readable(text, other, ","):
                raise BadInput(
                    f"{path}, line {line + 1}",
                    "its numbers have a decimal comma",
                    'set decimal = ","',
                )
