"""The units of a fleet: rows of a table, or files found by a pattern with named parts."""

from __future__ import annotations

import csv
import glob
import io
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from bayesfric.configuration_errors import read_text
from bayesfric.errors import BadInput, nearest

Value = str | float | int | bool | None

# A million units of a hundred letters.
_LARGEST = 200_000_000
# What every file system takes, with room for what is put before and behind.
_LONGEST = 180
_DAY = 86_400.0  # s
# A serial number such as 007 is none: it would lose its noughts.
_NUMBER = re.compile(r"-?(0|[1-9][0-9]*)(\.[0-9]*)?([eE][-+]?[0-9]+)?")
_WHOLE = re.compile(r"-?(0|[1-9][0-9]{0,17})")
_NOT_IN_NAMES = re.compile(r'[/\\:*?"<>|\x00-\x1f\x7f]')
PLACEHOLDER = re.compile(r"\{\{|\}\}|\{([^{}]*)\}")


@dataclass(frozen=True)
class Unit:
    """One unit, and what its row says of it."""

    name: str
    text: Mapping[str, str]  # as written, by column: what stands inside other words
    values: dict[str, Value]  # numbers as numbers; `None` where the cell is empty


def put_in(text: str, told: Mapping[str, str], where: str, known: str) -> str:
    """Fill ``{column}`` in a text; two braces are one.

    Raises
    ------
    BadInput
        Naming ``where``, if ``known`` (what gives the columns) has no such column, or it is empty.
    """

    def one(found: re.Match[str]) -> str:
        name = found[1]
        if name is None:
            return found[0][0]
        if name not in told:
            raise BadInput(where, f"asks for {{{name}}}, which {known} lacks", nearest(name, told))
        if not told[name]:
            raise BadInput(where, f"asks for {{{name}}}, which is empty in {known}", "fill it")
        return told[name]

    return PLACEHOLDER.sub(one, text)


def read_units(path: Path, pattern: str | None) -> list[Unit]:
    """Read a CSV or Parquet table, a unit a row; ``pattern`` is that of their names.

    Raises
    ------
    BadInput
        Naming the row, for what cannot be used.
    """
    if path.suffix.lower() in (".parquet", ".pq"):
        columns, rows = _parquet(path)
    else:
        columns, rows = _delimited(path)
    return units_of(columns, rows, pattern, str(path), first_row=2)


def find_units(pattern: str, folder: Path, names: str | None, start: str = ".") -> list[Unit]:
    """Find files such as ``logs/{robot}/{day}.csv``, a unit each; ``{file}`` is the file found.

    ``start`` is the way to ``folder`` from where file names are relative to.

    Raises
    ------
    BadInput
        If the pattern has no named part, or nothing matches it.
    """
    where = f"units.glob = {pattern!r}"
    parts = [m[1] for m in PLACEHOLDER.finditer(pattern) if m[1] is not None]
    if not parts or not all(part.isidentifier() and part != "file" for part in parts):
        mend = "write a word in braces for each part, such as logs/{robot}/{day}.csv"
        raise BadInput(where, "has no named parts", mend)
    wild, regular = _wild_and_regular(pattern)
    found = sorted(glob.glob(wild, root_dir=folder, recursive=True))  # noqa: PTH207 (root_dir)
    matched = [(file, m) for file in found if (m := regular.fullmatch(file.replace(os.sep, "/")))]
    if not matched:
        raise BadInput(where, f"no file in {folder} matches it", "check the pattern")
    columns = [*dict.fromkeys(parts), "file"]
    rows = [
        [*(match[part] for part in columns[:-1]), os.path.normpath(os.path.join(start, file))]  # noqa: PTH118 (a text)
        for file, match in matched
    ]
    names = names or "-".join(f"{{{part}}}" for part in columns[:-1])
    return units_of(columns, rows, names, where)


def _wild_and_regular(pattern: str) -> tuple[str, re.Pattern[str]]:
    """Turn a pattern into one for glob and one that names the parts."""
    wild, regular, seen = "", "", set()
    for token in re.split(r"(\{[^{}]*\}|\*\*/|\*|\?)", pattern):
        if token[:1] == "{":
            name = token[1:-1]
            wild += "*"
            regular += f"(?P={name})" if name in seen else f"(?P<{name}>[^/]+?)"
            seen.add(name)
        elif token in ("**/", "*", "?"):
            wild += token
            regular += {"**/": "(?:.*/)?", "*": "[^/]*", "?": "[^/]"}[token]
        else:
            wild += token
            regular += re.escape(token)
    return wild, re.compile(regular)


def units_of(
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    pattern: str | None,
    known: str,
    first_row: int | None = None,
) -> list[Unit]:
    """Make units of rows of text; ``known`` is what complaints call the table.

    Raises
    ------
    BadInput
        Naming the row, if a name cannot be that of a folder, or is there twice.
    """
    if pattern is None:
        own = next((name for name in ("unit", "name") if name in columns), None)
        if own is None:
            mend = "add a column 'unit', or say name = \"{serial}-{day}\" under [units]"
            raise BadInput(known, "does not say what units are called", mend)
        pattern = f"{{{own}}}"
    rows = [list(row) for row in rows]
    typed = [_typed([row[k] for row in rows]) for k in range(len(columns))]
    found: dict[str, int] = {}
    units = []
    for number, row in enumerate(rows):
        where = known if first_row is None else f"{known}, row {number + first_row}"
        text = dict(zip(columns, row, strict=True))
        name = put_in(pattern, text, f"{where}: units.name", known)
        if _NOT_IN_NAMES.search(name) or name[0] in ". " or len(name.encode()) > _LONGEST:
            mend = "give it another with name = ... under [units]"
            raise BadInput(where, f"{name[:60]!r} cannot be the name of a folder", mend)
        if name in found:
            mend = "give each row a name of its own, or name = ... under [units]"
            raise BadInput(where, f"{name!r} is there twice", mend)
        found[name] = number
        units.append(Unit(name, text, {c: typed[k][number] for k, c in enumerate(columns)}))
    if not units:
        raise BadInput(known, "has no rows", "give a row for each unit")
    return units


def places_of(units: Sequence[Unit], column: str) -> tuple[dict[str, float], str]:
    """Give a column's numbers by unit, dates in days since the first, and their unit.

    Raises
    ------
    BadInput
        Naming the unit whose cell is neither.
    """
    values = {unit.name: unit.values[column] for unit in units}
    told = {name: value for name, value in values.items() if value is not None}
    if not any(isinstance(value, str) for value in told.values()):
        return {name: float(value) for name, value in told.items()}, column
    stamps = {}
    for name, value in told.items():
        try:
            # dates alone have no zone, and none is guessed for them: all are taken alike
            at = datetime.fromisoformat(str(value)).replace(tzinfo=None)
        except ValueError:
            where = f"units.over: column {column!r}, unit {name!r}"
            mend = "write numbers, or dates such as 2026-05-31"
            raise BadInput(where, f"{str(value)[:40]!r} is neither", mend) from None
        stamps[name] = (at - datetime(1970, 1, 1)).total_seconds() / _DAY
    first = min(stamps.values())
    return {name: stamp - first for name, stamp in stamps.items()}, "day"


def _typed(cells: Sequence[str]) -> Sequence[Value]:
    """Take a column for numbers, or true and false, where all its cells are."""
    full = [cell for cell in cells if cell]
    if not full:
        return [None] * len(cells)
    for fits, make in (
        (_WHOLE.fullmatch, int),
        (_NUMBER.fullmatch, float),
        (("true", "false").__contains__, "true".__eq__),
    ):
        if all(fits(cell) for cell in full):
            return [make(cell) if cell else None for cell in cells]
    return [cell or None for cell in cells]


def _delimited(path: Path) -> tuple[list[str], list[list[str]]]:
    try:
        text = read_text(path, _LARGEST, "table of units", "name the table", "save it as UTF-8")
    except OSError as error:
        raise BadInput(str(path), f"cannot be read ({error.strerror})", "check its name") from None
    head = text.partition("\n")[0]
    delimiter = max(",;\t", key=head.count)
    rows = [row for row in csv.reader(io.StringIO(text), delimiter=delimiter) if any(row)]
    if not rows:
        raise BadInput(str(path), "is empty", "give a row of names, and one for each unit")
    columns = [cell.strip() for cell in rows[0]]
    _check_columns(columns, str(path))
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(columns):
            what = f"has {len(row)} cells, the first {len(columns)}"
            raise BadInput(f"{path}, row {number}", what, "give as many")
    return columns, [[cell.strip() for cell in row] for row in rows[1:]]


def _parquet(path: Path) -> tuple[list[str], list[list[str]]]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(path)
    except (OSError, pa.ArrowException) as error:
        raise BadInput(str(path), f"is no Parquet table ({error})", "check the file") from None
    return cells_of(table.to_pydict(), str(path))


def cells_of(table: Mapping[Any, Sequence[Any]], known: str) -> tuple[list[str], list[list[str]]]:
    """Write columns of values as rows of text, as a CSV file would have them."""
    columns = [str(name) for name in table]
    _check_columns(columns, known)
    return columns, [[_cell(x) for x in row] for row in zip(*table.values(), strict=True)]


def _cell(value: Any) -> str:
    if value is None or value != value:  # nan
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return repr(float(value)) if isinstance(value, float) else str(value)


def _check_columns(columns: Sequence[str], known: str) -> None:
    for name in columns:
        if not name or columns.count(name) > 1:
            what = f"two columns are called {name!r}" if name else "a column has no name"
            raise BadInput(known, what, "give each a name of its own")
