"""Reading JSON: rows of objects, or an object of lists."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.errors import BadInput
from bayesfric.recordings.tables.reader import Reader, TableOptions
from bayesfric.recordings.tables.table import Table, check_names


def read_json(path: Path, options: TableOptions) -> Table:
    """Read a list of objects, or an object of lists; one column a key.

    Either lies at the path of keys that ``options.table`` gives, or is the file's own, or the
    only list of objects in it. True and false become 1 and 0.

    Promised to hostile input: a key written twice, a row without a key and a file nested too
    deep are refused and named; pandas takes the last, fills up, or fails.
    """
    text = decode(path)
    try:
        data = json.loads(text, object_pairs_hook=Doubled)
    except json.JSONDecodeError as error:
        raise BadInput(
            f"{path}, line {error.lineno}",
            f"is not valid JSON ({error.msg})",
            "export it again; the file may be cut off",
        ) from error
    except (RecursionError, ValueError) as error:
        raise BadInput(
            str(path), f"is not readable JSON ({type(error).__name__})", "export it again"
        ) from error
    found, where = _find(path, data, options.table)
    return (from_rows if isinstance(found, list) else _from_columns)(path, found, where)


def decode(path: Path) -> str:
    """Return a file's text, which must be UTF-8."""
    try:
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadInput(
            f"{path}, byte {error.start}", "is not UTF-8 text", "save it as UTF-8"
        ) from error


class Doubled(dict[str, Any]):
    """An object that remembers its keys as written, doubles included."""

    def __init__(self, pairs: list[tuple[str, Any]]) -> None:
        super().__init__(pairs)
        self.keys_written = [key for key, _ in pairs]


def _find(path: Path, data: Any, table: str | None) -> tuple[Any, str]:
    where = "top level"
    if table is not None:
        for key in table.split("."):
            if not isinstance(data, dict) or key not in data:
                known = (
                    ", ".join(f"'{k}'" for k in list(data)[:20]) if isinstance(data, dict) else ""
                )
                raise BadInput(
                    f"{path}, table '{table}'",
                    f"there is no key '{key}'",
                    f"it has {known}" if known else "give the path to the list of rows",
                )
            data = data[key]
        where = f"table '{table}'"
    elif isinstance(data, dict):
        rows = [key for key, value in data.items() if _is_rows(value)]
        if len(rows) == 1:
            return data[rows[0]], f"table '{rows[0]}'"
        if len(rows) > 1:
            raise BadInput(
                str(path),
                f"holds several tables ({', '.join(repr(key) for key in rows[:20])})",
                "name one with table",
            )
    if isinstance(data, list) or (
        isinstance(data, dict) and any(isinstance(value, list) for value in data.values())
    ):
        return data, where
    raise BadInput(
        f"{path}, {where}",
        "is neither a list of objects nor an object of lists",
        "give the dotted path to it with table",
    )


def _is_rows(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(v, dict) for v in value)


def _objects(values: list[Any]) -> NDArray[Any]:
    # numpy would turn nested lists into a matrix; cells must stay cells
    return np.fromiter(values, dtype=object, count=len(values))


def from_rows(path: Path, rows: list[Any], where: str, lines: Sequence[int] | None = None) -> Table:
    """Make a table of objects, one a row; ``lines`` are those of the file that they stand in."""
    if not rows:
        raise BadInput(f"{path}, {where}", "holds no rows", "check the recorder's export")
    names: dict[str, None] = {}

    def place(index: int) -> str:
        return f"row {index + 1}" + ("" if lines is None else f" (line {lines[index]})")

    for index, row in enumerate(rows):
        if not isinstance(row, Doubled):
            raise BadInput(
                f"{path}, {where}, {place(index)}", "is no object", "give an object a row"
            )
        check_names(str(path), row.keys_written, f"{where}, {place(index)}")
        names.update(dict.fromkeys(row))

    def cells(name: str) -> NDArray[Any]:
        for index, row in enumerate(rows):
            if name not in row:
                raise BadInput(
                    f"{path}, column '{name}', {place(index)}",
                    "is missing",
                    "correct the row, or cut it out of the file",
                )
        return _objects([row[name] for row in rows])

    return Table(str(path), list(names), lambda i: cells(list(names)[i]), lines=lines, by_rows=True)


def _from_columns(path: Path, columns: Doubled, where: str) -> Table:
    check_names(str(path), columns.keys_written, where)
    values = list(columns.values())

    def load(index: int) -> NDArray[Any]:
        value = values[index]
        return _objects(value) if isinstance(value, list) else np.asarray(None)

    return Table(str(path), list(columns), load)


READER = Reader("json", (".json",), read_json, whole=True)
