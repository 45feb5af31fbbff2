"""Finding delimiter, header and first row of a delimited text file."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from bayesfric.errors import BadInput
from bayesfric.recordings.tables.table import is_number

_CANDIDATES = (",", ";", "\t", "|", "whitespace")
_LONGEST_LINE = 1_000_000
_MISSING = {"", "nan", "na", "n/a", "null", "none", "inf", "-inf", "-", "--", "?"}


class TextOptions(Protocol):
    """The part of a source that speaks about delimited text."""

    @property
    def delimiter(self) -> str | None:
        """The character between columns, 'tab', 'whitespace', or None to find it."""

    @property
    def header(self) -> bool | None:
        """Whether there is a header, or None to find out."""

    @property
    def decimal(self) -> str:
        """The decimal mark."""

    @property
    def skip_rows(self) -> int:
        """Lines to skip at the beginning."""


@dataclass(frozen=True)
class Layout:
    """Where the numbers of a text file are.

    Parameters
    ----------
    delimiter
        One character, or ``"whitespace"``.
    width
        Number of columns.
    names
        Header, one name a column (empty strings without a header).
    header_line
        Index from 0 of the header's line, or None.
    first
        Index from 0 of the first row's line.
    notes
        One sentence for every choice made.
    """

    delimiter: str
    width: int
    names: tuple[str, ...]
    header_line: int | None
    first: int
    notes: tuple[str, ...]


def split(line: str, delimiter: str) -> list[str]:
    """Split one line into its cells.

    Parameters
    ----------
    line
        The line without its end.
    delimiter
        One character, or ``"whitespace"``.

    Returns
    -------
    list of str
        The cells, stripped of quotes and surrounding spaces.
    """
    if delimiter == "whitespace":
        return [cell.strip('"') for cell in line.split()]
    if '"' not in line:
        return [cell.strip() for cell in line.split(delimiter)] if line else []
    try:
        cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:  # a cell of more than 131072 characters
        return [line]
    return [cell.strip() for cell in cells]


def find_layout(path: Path, head: Sequence[str], options: TextOptions) -> Layout:
    """Find the layout from a file's first lines.

    Parameters
    ----------
    path
        The file, for messages.
    head
        Its first lines.
    options
        What the user said; None is found out.

    Returns
    -------
    Layout
        Delimiter, columns, header and first row.

    Raises
    ------
    BadInput
        If there is no row of numbers, the header does not fit, or a line is too long.
    """
    for i, text in enumerate(head[options.skip_rows :], start=options.skip_rows + 1):
        if len(text) > _LONGEST_LINE:
            raise BadInput(
                f"{path}, line {i}",
                f"has {len(text)} characters",
                "write one row a sample, with the recording's columns only",
            )
    lines = [(i, text) for i, text in enumerate(head) if i >= options.skip_rows and text.strip()]
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
    rows = [(i, split(text, delimiter)) for i, text in lines]
    flags = [[is_number(cell, options.decimal) for cell in cells] for _, cells in rows]
    if options.header is not None:
        begin = 1 if options.header else 0
        if begin >= len(rows):
            raise _only_header(path)
        width = len(rows[0][1])
    else:
        width = _width(flags)
        if width == 0:
            raise _only_header(path) if len(rows) <= 2 else _no_numbers(path, rows)
        fitting = (n for n, f in enumerate(flags) if len(f) == width and 2 * sum(f) >= width)
        begin = next(fitting, -1)
        if begin < 0:
            raise BadInput(
                f"{path}, line {rows[-1][0] + 1}",
                "in no row is half of the cells numbers",
                "check delimiter, decimal and skip_rows, or whether this is a text table at all",
            )
    return _with_header(path, rows, flags, begin, width, delimiter, options)


def _with_header(
    path: Path,
    rows: Sequence[tuple[int, list[str]]],
    flags: Sequence[Sequence[bool]],
    begin: int,
    width: int,
    delimiter: str,
    options: TextOptions,
) -> Layout:
    notes = []
    if options.header is None:
        for n in range(begin):
            # a row of numbers above the rest can only be data that would be lost unseen
            if all(flags[n]):
                raise BadInput(
                    f"{path}, line {rows[n][0] + 1}",
                    f"has {len(flags[n])} cells, the rows below have {width}",
                    "correct the row, or set skip_rows if it is no row of the table",
                )
            if len(flags[n]) == width and any(flags[n]):
                begin = n
                break
        top = begin
        while top > 0 and len(flags[top - 1]) == width and not any(flags[top - 1]):
            top -= 1
        if top == begin and top > 0:
            _refuse_lost_header(path, rows[:top], flags[:top], width)
        header = top if top < begin else None
        if header is not None and begin - header == 2 and _is_units(rows[header + 1][1]):
            notes.append(f"line {rows[header + 1][0] + 1} taken as a row of units and skipped")
        elif header is not None:
            begin = header + 1
        if top > 0:
            notes.append(f"{rows[top][0]} lines above the table skipped")
    else:
        header = 0 if options.header else None
    first = rows[begin][0]
    if header is None:
        return Layout(delimiter, width, ("",) * width, None, first, tuple(notes))
    names = list(rows[header][1])
    names[0] = names[0].lstrip("#").strip()
    return Layout(delimiter, width, tuple(names), rows[header][0], first, tuple(notes))


def _refuse_lost_header(
    path: Path,
    rows: Sequence[tuple[int, list[str]]],
    flags: Sequence[Sequence[bool]],
    width: int,
) -> None:
    for n, (line, cells) in enumerate(rows):
        if len(cells) == width > 1 and all(cells) and n + 1 < len(rows) and any(flags[n + 1]):
            raise BadInput(
                f"{path}, line {rows[n + 1][0] + 1}",
                f"has {len(rows[n + 1][1])} cells, the header in line {line + 1} has {width}",
                "correct the row, or set skip_rows if it is no row of the table",
            )


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


def _is_units(cells: Sequence[str]) -> bool:
    return not any(cell.casefold() in _MISSING for cell in cells)


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


def _only_header(path: Path) -> BadInput:
    return BadInput(
        str(path), "holds a header but no row of numbers", "check the recorder's export"
    )


def _no_numbers(path: Path, rows: Sequence[tuple[int, list[str]]]) -> BadInput:
    return BadInput(
        f"{path}, line {rows[-1][0] + 1}",
        f"no cell is a number ('{rows[-1][1][0][:40]}')",
        "check delimiter, decimal and skip_rows, or whether this is a text table at all",
    )
