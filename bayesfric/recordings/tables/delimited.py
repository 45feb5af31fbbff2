"""Read delimited text: CSV, TSV and their variants.

Unlike pandas' sniffing it refuses a wrong encoding, a decimal comma, rows of another width, quoted
cells over several lines and repeated names with their line; lines above the table and a row of
units are skipped, which is reported.
"""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from bayesfric.base.errors import BadInput
from bayesfric.recordings.tables.reader import Reader, TableOptions, read_text
from bayesfric.recordings.tables.table import Table, check_names, column_cells, is_number, row_name

# Lines from which the layout is detected.
_HEAD = 400
_CANDIDATES = (",", ";", "\t", "|", "whitespace")
_NO_TABLE = "check delimiter, decimal and skip_rows, or whether this is a text table at all"
_NOT_OF_IT = "correct the row, or set skip_rows if it is no row of the table"
_MISSING = {"", "nan", "na", "n/a", "null", "none", "inf", "-inf", "-", "--", "?"}


class _Row(NamedTuple):
    """A line that is not blank: its number, its cells, and which of them are numbers."""

    line: int
    cells: list[str]
    numbers: list[bool]


def read_delimited(path: Path, options: TableOptions) -> Table:
    """Read UTF-8, or UTF-16 with a byte order mark; pandas takes the numbers out."""
    ends = read_text(path).replace("\r\n", "\n").replace("\r", "\n").split("\n")
    text = enumerate(ends, start=1)
    numbered = [(n, line) for n, line in text if n > options.skip_rows and line.strip()]
    if not numbered:
        after = f" after {options.skip_rows:.10g} skipped lines" if options.skip_rows else ""
        raise BadInput(str(path), f"is empty{after}", "check whether the recorder wrote anything")
    head = numbered[:_HEAD]
    delimiter = _delimiter(path, [line for _, line in head], options)
    rows = [
        _Row(n, cells, [is_number(cell, options.decimal) for cell in cells])
        for n, cells in ((n, _split(line, delimiter)) for n, line in head)
    ]
    width = _width([row.numbers for row in rows])
    header, first = _find_header(path, rows, width)
    if first >= len(rows):
        problem = "holds a header but no row of numbers"
        raise BadInput(str(path), problem, "check the recorder's export")
    top = rows[first if header is None else header]
    names, units, notes = [""] * width, list[str](), list[str]()
    if header is not None:
        names = [top.cells[0].lstrip("#").strip(), *top.cells[1:]]
        if first - header == 2:
            units = [cell.strip("[]()") for cell in rows[first - 1].cells]
            notes = [f"line {rows[first - 1].line} taken as a row of units and skipped"]
    if top.line > numbered[0][0]:
        notes.append(f"{top.line - 1} lines above the table skipped")
    check_names(str(path), names, f"line {top.line}")
    lines = [n for n, _ in numbered[first:]]
    body = [line for _, line in numbered[first:]]
    return Table(
        str(path),
        tuple(names),
        _parse(path, body, delimiter, width, options.decimal, lines).__getitem__,
        lines=lines,
        header_line=None if header is None else top.line,
        decimal=options.decimal,
        notes=tuple(notes),
        units=units,
    )


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


def _delimiter(path: Path, lines: Sequence[str], options: TableOptions) -> str:
    """Return the given delimiter, or the one with which most cells are numbers."""
    if options.delimiter:
        return {"tab": "\t", " ": "whitespace"}.get(options.delimiter, options.delimiter)

    def numbers(candidate: str, decimal: str) -> int:
        flags = [[is_number(c, decimal) for c in _split(line, candidate)] for line in lines]
        width = _width(flags)
        return sum(sum(f) for f in flags if len(f) == width) if width > 1 else 0

    def best(decimal: str) -> str:
        return max((c for c in _CANDIDATES if c != decimal), key=lambda c: numbers(c, decimal))

    delimiter = best(options.decimal)
    if options.decimal == "." and numbers(best(","), ",") > numbers(delimiter, "."):
        raise BadInput(str(path), "its numbers have a decimal comma", 'set decimal = ","')
    return delimiter


def _find_header(path: Path, rows: Sequence[_Row], width: int) -> tuple[int | None, int]:
    """Find header and first row of the table of ``width`` columns."""
    like = [len(row.cells) == width for row in rows]
    fitting = (n for n, row in enumerate(rows) if like[n] and 2 * sum(row.numbers) >= width > 0)
    first = next(fitting, -1)
    if first < 0 and len(rows) > 2:
        problem = f"no cell is a number ('{rows[-1].cells[0][:40]}')" if width == 0 else ""
        problem = problem or "in no row is half of the cells numbers"
        raise BadInput(f"{path}, line {rows[-1].line}", problem, _NO_TABLE)
    if first <= 0:
        return (None, 0) if first == 0 else (0, len(rows))
    while first > 0 and like[first - 1] and any(rows[first - 1].numbers):
        first -= 1
    above = rows[first - 1] if first else None
    if above is None:
        return None, first
    if not like[first - 1] and any(above.numbers):
        # data that would be lost silently
        problem = f"has {len(above.cells)} cells, the rows below have {width}"
        raise BadInput(f"{path}, line {above.line}", problem, _NOT_OF_IT)
    if not like[first - 1]:
        return None, first
    two = first > 1 and like[first - 2] and not any(rows[first - 2].numbers)
    with_units = two and not any(cell.casefold() in _MISSING for cell in above.cells)
    return (first - 2 if with_units else first - 1), first


def _width(flags: Sequence[Sequence[bool]]) -> int:
    """Return the number of columns most lines with numbers have, 0 if there are none."""
    counts = Counter[int]()
    for line in flags:
        counts[len(line)] += sum(line)
    width, weight = max(counts.items(), key=lambda item: (item[1], item[0]), default=(0, 0))
    return width if weight else 0


def _parse(
    path: Path, body: list[str], delimiter: str, width: int, decimal: str, lines: Sequence[int]
) -> list[NDArray[Any]]:
    # pandas takes a third of a second to import, which only reading should cost
    import pandas as pd

    try:
        frame = pd.read_csv(
            io.BytesIO("\n".join(body).encode()),
            sep=r"\s+" if delimiter == "whitespace" else delimiter,
            header=None,
            decimal=decimal,
            na_filter=False,
            skipinitialspace=True,
            low_memory=False,
            engine="c",
        )
    except (pd.errors.ParserError, ValueError) as error:
        _refuse_ragged(path, body, delimiter, width, lines)
        problem = f"is not readable as CSV ({error})"
        raise BadInput(str(path), problem, "check its rows and quotes") from error
    last = frame.iloc[:, -1]
    suspicious = last.dtype.kind not in "biuf" and bool((last.isna() | (last == "")).any())
    if suspicious or frame.shape != (len(lines), width):
        _refuse_ragged(path, body, delimiter, width, lines)
    if frame.shape != (len(lines), width):
        problem = f"has {len(lines)} lines of {width} cells, read as {frame.shape[0]} rows of "
        problem += f"{frame.shape[1]}"
        raise BadInput(str(path), problem, "close the quotes, or give its delimiter")
    return [column_cells(frame.iloc[:, i]) for i in range(width)]


def _refuse_ragged(
    path: Path, body: list[str], delimiter: str, width: int, lines: Sequence[int]
) -> None:
    for index, line in enumerate(body):
        if (count := len(_split(line, delimiter))) != width:
            raise BadInput(
                f"{path}, {row_name(index, lines)}",
                f"has {count} cells, the table has {width} columns",
                "correct the row, or cut the file there",
            )


READERS = (Reader("csv", (".csv", ".tsv", ".txt", ".dat"), read_delimited),)
