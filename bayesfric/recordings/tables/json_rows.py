"""Reading JSON: rows of objects, or an object of lists."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.errors import BadInput
from bayesfric.recordings.tables.table import Table, check_names


def read_json(path: Path, table: str | None) -> Table:
    """Read a JSON file.

    Parameters
    ----------
    path
        The file, UTF-8.
    table
        Dotted path of keys to a list of objects or an object of lists; None for the file's own,
        or for the only list of objects in it.

    Returns
    -------
    Table
        One column a key; true and false become 1 and 0.

    Raises
    ------
    BadInput
        For a damaged file, a key that is not there, or data of another shape.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadInput(
            f"{path}, byte {error.start}", "is not UTF-8 text", "save it as UTF-8"
        ) from error
    try:
        data = json.loads(text, object_pairs_hook=_Doubled)
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
    found, where = _find(path, data, table)
    if isinstance(found, list):
        return _from_rows(path, found, where)
    return _from_columns(path, found, where)


class _Doubled(dict[str, Any]):
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


def _from_rows(path: Path, rows: list[Any], where: str) -> Table:
    if not rows:
        raise BadInput(f"{path}, {where}", "holds no rows", "check the recorder's export")
    names: dict[str, None] = {}
    for index, row in enumerate(rows):
        if not isinstance(row, _Doubled):
            raise BadInput(
                f"{path}, {where}, row {index + 1}", "is no object", "give a list of objects"
            )
        check_names(path, row.keys_written, f"{where}, row {index + 1}")
        names.update(dict.fromkeys(row))

    def cells(name: str) -> NDArray[Any]:
        for index, row in enumerate(rows):
            if name not in row:
                raise BadInput(
                    f"{path}, column '{name}', row {index + 1}",
                    "is missing",
                    "correct the row, or cut it out of the file",
                )
        return _objects([row[name] for row in rows])

    return _table(path, list(names), cells)


def _from_columns(path: Path, columns: Any, where: str) -> Table:
    if isinstance(columns, _Doubled):
        check_names(path, columns.keys_written, where)

    def cells(name: str) -> NDArray[Any]:
        value = columns[name]
        return _objects(value) if isinstance(value, list) else np.asarray(None)

    return _table(path, list(columns), cells)


def _table(path: Path, names: list[str], cells: Callable[[str], NDArray[Any]]) -> Table:
    check_names(path, names)

    def load(index: int) -> NDArray[Any]:
        return cells(names[index])

    return Table(path=path, names=tuple(names), load=load)
