"""Reading delimited text: CSV, TSV, and what recorders make of them.

Promised, as pandas' own sniffing does not: a wrong encoding, a decimal comma, rows of another width
than the header or the others, quoted cells over several lines and doubled names are refused with
their line; lines above the table and a row of units are skipped and told.
"""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from bayesfric.errors import BadInput
from bayesfric.recordings.tables.reader import Reader, TableOptions, read_text
from bayesfric.recordings.tables.table import Table, check_names, column_cells, is_number, row_name

# What tells the layout.
_HEAD_LINES, _HEAD_CHARACTERS = 400, 1_000_000
_CANDIDATES = (",", ";", "\t", "|", "whitespace")
_NO_TABLE = "check delimiter, decimal and skip_rows, or whether this is a text table at all"
_MISSING = {"", "nan", "na", "n/a", "null", "none", "inf", "-inf", "-", "--", "?"}


class _Row(NamedTuple):
    """A line that is not blank: its number, its cells, and which of them are numbers."""

    line: int
    cells: list[str]
    numbers: list[bool]


class _Layout(NamedTuple):
    """Where the numbers are: ``header`` and ``first`` row count lines that are not blank."""

    delimiter: str  # one character, or "whitespace"
    width: int
    header: int | None
    first: int
    notes: list[str]  # one sentence for every choice made


def read_delimited(path: Path, options: TableOptions) -> Table:
    """Read UTF-8, or UTF-16 with a byte order mark; pandas takes the numbers out."""
    text = enumerate(_lines(path), start=1)
    numbered = [(n, line) for n, line in text if n > options.skip_rows and line.strip()]
    if not numbered:
        after = f" after {options.skip_rows:.10g} skipped lines" if options.skip_rows else ""
        raise BadInput(str(path), f"is empty{after}", "check whether the recorder wrote anything")
    rows, layout = _find_layout(path, _head(numbered), options)
    begin = rows[layout.first if layout.header is None else layout.header]
    names, units, header_line = ("",) * layout.width, list[str](), None
    if layout.header is not None:
        header_line, (name, *others) = begin.line, begin.cells
        names = (name.lstrip("#").strip(), *others)
        if layout.first - layout.header == 2:
            units = [cell.strip("[]()") for cell in rows[layout.header + 1].cells]
    check_names(str(path), names, f"line {begin.line}")
    lines = [n for n, _ in numbered[layout.first :]]
    body = [line for _, line in numbered[layout.first :]]
    return Table(
        str(path),
        names,
        _parse(path, body, layout, options.decimal, lines).__getitem__,
        lines=lines,
        header_line=header_line,
        decimal=options.decimal,
        notes=tuple(layout.notes),
        units=units,
    )


def _lines(path: Path) -> list[str]:
    text = read_text(path)
    if "\0" in text:
        raise BadInput(
            f"{path}, character {text.index(chr(0))}",
            "is a NUL, so this is no text file",
            "give its format, or save it as UTF-8",
        )
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _head(lines: Sequence[tuple[int, str]]) -> Sequence[tuple[int, str]]:
    sizes = accumulate(len(line) for _, line in lines[:_HEAD_LINES])
    return lines[: 1 + sum(size <= _HEAD_CHARACTERS for size in sizes)][:_HEAD_LINES]


def _split(line: str, delimiter: str) -> list[str]:
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


def _find_layout(
    path: Path, lines: Sequence[tuple[int, str]], options: TableOptions
) -> tuple[list[_Row], _Layout]:
    """Find the layout by the first lines; what ``options`` say is not guessed."""
    texts = [text for _, text in lines]
    found, count = _find_delimiter(texts, options.decimal)
    delimiter = options.delimiter or found
    delimiter = {"tab": "\t", " ": "whitespace"}.get(delimiter, delimiter)
    if not options.delimiter and options.decimal == "." and _find_delimiter(texts, ",")[1] > count:
        raise BadInput(
            f"{path}, line {lines[-1][0]}", "its numbers have a decimal comma", 'set decimal = ","'
        )
    rows = [
        _Row(n, cells, [is_number(cell, options.decimal) for cell in cells])
        for n, cells in ((n, _split(text, delimiter)) for n, text in lines)
    ]
    if options.header is not None:
        header, first, notes = (0, 1, []) if options.header else (None, 0, list[str]())
        width = len(rows[0].cells)
    else:
        width = _width([row.numbers for row in rows])
        if width == 0 and len(rows) > 2:
            what = f"no cell is a number ('{rows[-1].cells[0][:40]}')"
            raise BadInput(f"{path}, line {rows[-1].line}", what, _NO_TABLE)
        header, first, notes = _find_header(path, rows, width) if width else (0, len(rows), [])
    if first >= len(rows):
        raise BadInput(
            str(path), "holds a header but no row of numbers", "check the recorder's export"
        )
    return rows, _Layout(delimiter, width, header, first, notes)


def _find_header(path: Path, rows: Sequence[_Row], width: int) -> tuple[int | None, int, list[str]]:
    """Find header and first row of the table of ``width`` columns, with what there is to say."""
    like = [len(row.cells) == width for row in rows]
    fitting = (n for n, row in enumerate(rows) if like[n] and 2 * sum(row.numbers) >= width)
    begin = next(fitting, -1)
    if begin < 0:
        raise BadInput(
            f"{path}, line {rows[-1].line}", "in no row is half of the cells numbers", _NO_TABLE
        )
    for n, row in enumerate(rows[:begin]):
        # a row of numbers above the rest can only be data that would be lost unseen
        if all(row.numbers):
            raise BadInput(
                f"{path}, line {row.line}",
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
                    f"{path}, line {row.line}",
                    f"has {len(row.cells)} cells, the header in line {above.line} has {width}",
                    "correct the row, or set skip_rows if it is no row of the table",
                )
    elif begin - header == 2 and not any(c.casefold() in _MISSING for c in rows[header + 1].cells):
        notes.append(f"line {rows[header + 1].line} taken as a row of units and skipped")
    else:
        begin = header + 1
    if top > 0:
        notes.append(f"{rows[top].line - 1} lines above the table skipped")
    return header, begin, notes


def _find_delimiter(lines: Sequence[str], decimal: str) -> tuple[str, int]:
    """Return the delimiter that makes most cells numbers, and how many."""
    best, most = ",", 0
    for candidate in _CANDIDATES:
        if candidate == decimal:
            continue
        flags = [[is_number(c, decimal) for c in _split(line, candidate)] for line in lines]
        width = _width(flags)
        count = sum(sum(f) for f in flags if len(f) == width) if width > 1 else 0
        if count > most:
            best, most = candidate, count
    if most == 0 and not any(best in line for line in lines):
        # one column, or nothing readable: let the character that comes most decide
        counts = Counter(c for line in lines for c in line if c in ",;\t|" and c != decimal)
        best = counts.most_common(1)[0][0] if counts else ("," if decimal != "," else ";")
    return best, most


def _width(flags: Sequence[Sequence[bool]]) -> int:
    """Return the number of columns most lines with numbers have, 0 if there are none."""
    counts = Counter[int]()
    for line in flags:
        counts[len(line)] += sum(line)
    width, weight = max(counts.items(), key=lambda item: (item[1], item[0]), default=(0, 0))
    return width if weight else 0


def _parse(
    path: Path, body: list[str], layout: _Layout, decimal: str, lines: Sequence[int]
) -> list[NDArray[Any]]:
    # pandas takes a third of a second to import, which only reading should cost
    import pandas as pd

    try:
        frame = pd.read_csv(
            io.BytesIO("\n".join(body).encode()),
            sep=r"\s+" if layout.delimiter == "whitespace" else layout.delimiter,
            header=None,
            decimal=decimal,
            na_filter=False,
            skipinitialspace=True,
            low_memory=False,
            engine="c",
        )
    except (pd.errors.ParserError, ValueError) as error:
        _refuse_ragged(path, body, layout, lines)
        raise BadInput(
            str(path), f"is not readable as CSV ({error})", "check its rows and quotes"
        ) from error
    last = frame.iloc[:, -1]
    suspicious = last.dtype.kind not in "biuf" and bool((last.isna() | (last == "")).any())
    if suspicious or frame.shape != (len(lines), layout.width):
        _refuse_ragged(path, body, layout, lines)
    if frame.shape != (len(lines), layout.width):
        raise BadInput(
            str(path),
            f"has {len(lines)} lines of {layout.width} cells, read as {frame.shape[0]} rows of "
            f"{frame.shape[1]}",
            "close the quotes, or give its delimiter",
        )
    return [column_cells(frame.iloc[:, i]) for i in range(frame.shape[1])]


def _refuse_ragged(path: Path, body: list[str], layout: _Layout, lines: Sequence[int]) -> None:
    for index, line in enumerate(body):
        count = len(_split(line, layout.delimiter))
        if count != layout.width:
            raise BadInput(
                f"{path}, {row_name(index, lines)}",
                f"has {count} cells, the table has {layout.width} columns",
                "correct the row, or cut the file there",
            )


READER = Reader("csv", (".csv", ".tsv", ".txt", ".dat"), read_delimited)
