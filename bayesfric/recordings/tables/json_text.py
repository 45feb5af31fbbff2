"""Read JSON: rows of objects, or an object of lists; and JSON lines, an object a line."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.base.errors import BadInput
from bayesfric.recordings.tables.reader import Reader, TableOptions, read_text
from bayesfric.recordings.tables.table import Table, row_name


def read_json(path: Path, options: TableOptions) -> Table:
    """Read a list of objects, or an object of lists; one column a key.

    It is at the path ``options.table``, at the top, or the only list of objects in the file.
    """
    data = inside(str(path), parse(str(path), read_text(path)), options.table)
    if options.table is None and isinstance(data, dict):
        rows = [key for key, value in data.items() if _is_rows(value)]
        if len(rows) > 1:
            problem = f"holds several tables ({', '.join(repr(key) for key in rows[:20])})"
            raise BadInput(str(path), problem, "name one with table")
        data = data[rows[0]] if rows else data
    if isinstance(data, list):
        return from_rows(path, data)
    if not isinstance(data, dict) or not any(isinstance(value, list) for value in data.values()):
        problem = "is neither a list of objects nor an object of lists"
        raise BadInput(str(path), problem, "give the dotted path to it with table")
    values = list(data.values())

    def load(index: int) -> NDArray[Any]:
        value = values[index]
        return np.array(value if isinstance(value, list) else None, dtype=object)

    return Table(str(path), list(data), load)


def parse(where: str, text: str) -> Any:
    """Read JSON; ``where`` names it in messages."""
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        reason = f"{error.msg} in line {error.lineno}"
        raise BadInput(
            where, f"is not valid JSON ({reason})", "export it again, or cut it out"
        ) from error


def inside(where: str, data: Any, table: str | None) -> Any:
    """Follow a dotted path of keys."""
    for key in [] if table is None else table.split("."):
        known = list(data)[:20] if isinstance(data, dict) else []
        if not isinstance(data, dict) or key not in data:
            raise BadInput(
                f"{where}, table '{table}'",
                f"there is no key '{key}'",
                f"it has {', '.join(map(repr, known))}" if known else "give the path to the rows",
            )
        data = data[key]
    return data


def _is_rows(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(v, dict) for v in value)


def from_rows(path: Path, rows: list[Any], lines: Sequence[int] | None = None) -> Table:
    """Make a table of objects, one a row, at some ``lines`` of the file."""
    if not rows:
        raise BadInput(str(path), "holds no rows", "check the recorder's export")
    keys: dict[str, None] = {}
    for index, row in enumerate(rows):
        if not isinstance(row, dict):
            raise BadInput(
                f"{path}, {row_name(index, lines)}", "is no object", "give an object a row"
            )
        keys.update(dict.fromkeys(row))
    names = list(keys)

    def load(index: int) -> NDArray[Any]:
        return np.array([row.get(names[index]) for row in rows], dtype=object)

    return Table(str(path), names, load, lines=lines, by_rows=True)


def read_json_lines(path: Path, options: TableOptions) -> Table:
    """Read an object a line, one column a key; blank lines are left out.

    ``options.table`` is the path of keys to the object with the columns, the same in each line.
    """
    text = enumerate(read_text(path).split("\n"), start=1)
    lines = {number: line for number, line in text if line.strip()}
    places = {number: f"{path}, line {number}" for number in lines}
    rows = [inside(places[n], parse(places[n], line), options.table) for n, line in lines.items()]
    return from_rows(path, rows, list(lines))


READERS = (
    Reader("json", (".json",), read_json),
    Reader("jsonl", (".jsonl", ".ndjson"), read_json_lines),
)
