"""Reading delimited text: CSV, TSV, and what recorders make of them."""

from __future__ import annotations

import codecs
import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from bayesfric.errors import BadInput
from bayesfric.recordings.tables.layout import Layout, find_layout, split
from bayesfric.recordings.tables.reader import Reader, TableOptions
from bayesfric.recordings.tables.table import Table, check_names, column_cells

_HEAD_LINES = 400
_HEAD_CHARACTERS = 1_000_000
_BLANK_LINE = re.compile(r"\n[ \r]*\n")


def read_delimited(path: Path, options: TableOptions) -> Table:
    """Read UTF-8, or UTF-16 with a byte order mark; pandas takes the numbers out.

    Promised to hostile input, which pandas is not: a wrong encoding, rows of different length,
    quoted cells over several lines and doubled names are refused with their line.
    """
    text = _decode(path)
    if not text.strip():
        raise BadInput(str(path), "is empty", "check whether the recorder wrote anything")
    head = _head(text, options.skip_rows)
    layout = find_layout(path, head, options)
    line = layout.first if layout.header_line is None else layout.header_line
    check_names(str(path), layout.names, f"line {line + 1}")
    body = text[sum(len(line) + 1 for line in head[: layout.first]) :].rstrip()
    lines: Sequence[int] = range(layout.first + 1, layout.first + body.count("\n") + 2)
    if _BLANK_LINE.search(body):
        # the C reader drops blank lines, and row numbers must still lead to the right line
        kept = [(n, line) for n, line in zip(lines, body.split("\n"), strict=True) if line.strip()]
        lines = [n for n, _ in kept]
        body = "\n".join(line for _, line in kept)
    return Table(
        str(path),
        layout.names,
        _parse(path, body, layout, options.decimal, lines).__getitem__,
        lines=lines,
        header_line=None if layout.header_line is None else layout.header_line + 1,
        decimal=options.decimal,
        notes=layout.notes,
        units=layout.units,
    )


def _head(text: str, skip: int) -> list[str]:
    """Return the lines to skip and those that tell the layout."""
    lines: list[str] = []
    begin = size = 0
    while begin < len(text) and len(lines) - skip < _HEAD_LINES and size < _HEAD_CHARACTERS:
        found = text.find("\n", begin)
        end = len(text) if found < 0 else found
        lines.append(text[begin:end])
        begin = end + 1
        size += len(lines[-1]) if len(lines) > skip else 0
    return lines


def _decode(path: Path) -> str:
    data = path.read_bytes()
    utf16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = data.decode("utf-16" if utf16 else "utf-8-sig")
    except UnicodeDecodeError as error:
        name = "UTF-16" if utf16 else "UTF-8"
        raise BadInput(
            f"{path}, byte {error.start}", f"is not {name} text", "save it as UTF-8"
        ) from error
    if "\0" in text:
        raise BadInput(
            f"{path}, character {text.index(chr(0))}",
            "is a NUL, so this is no text file",
            "give its format, or save it as UTF-8",
        )
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def _parse(
    path: Path, body: str, layout: Layout, decimal: str, lines: Sequence[int]
) -> list[NDArray[Any]]:
    # pandas takes a third of a second to import, which only reading should cost
    import pandas as pd

    try:
        frame = pd.read_csv(
            io.BytesIO(body.encode()),
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
    if len(frame) != len(lines):
        raise BadInput(
            str(path),
            f"has {len(lines)} lines but {len(frame)} rows: a quoted cell runs over several lines",
            "close the quotes",
        )
    if frame.shape[1] != layout.width:
        raise BadInput(
            str(path),
            f"has {layout.width} columns in some lines and {frame.shape[1]} in others",
            "give its delimiter, or write it with commas",
        )
    return [column_cells(frame.iloc[:, i]) for i in range(frame.shape[1])]


def _refuse_ragged(path: Path, body: str, layout: Layout, lines: Sequence[int]) -> None:
    for index, line in enumerate(body.split("\n")):
        count = len(split(line, layout.delimiter))
        if count != layout.width:
            raise BadInput(
                f"{path}, row {index + 1} (line {lines[index]})",
                f"has {count} cells, the table has {layout.width} columns",
                "correct the row, or cut the file there",
            )


READER = Reader("csv", (".csv", ".tsv", ".txt", ".dat"), read_delimited, whole=True)
