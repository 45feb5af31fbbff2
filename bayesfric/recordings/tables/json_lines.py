"""Reading JSON lines: one object a line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from bayesfric.errors import BadInput
from bayesfric.recordings.tables.json_rows import Doubled, decode, from_rows
from bayesfric.recordings.tables.reader import Reader, TableOptions
from bayesfric.recordings.tables.table import Table


def read_json_lines(path: Path, options: TableOptions) -> Table:
    """Read an object a line, one column a key; blank lines are left out.

    ``options.table`` is the path of keys to the object with the columns, the same in each line.

    Promised to hostile input as :func:`bayesfric.recordings.tables.json_rows.read_json`; a line
    that is no JSON, such as the last of a file that was cut off, is named.
    """
    text = decode(path).split("\n")
    rows, lines = list[Any](), list[int]()
    for number, line in enumerate(text, start=1):
        if line.strip():
            rows.append(_inside(path, number, _parse(path, number, line), options.table))
            lines.append(number)
    return from_rows(path, rows, "the file", lines)


def _parse(path: Path, number: int, line: str) -> Any:
    try:
        return json.loads(line, object_pairs_hook=Doubled)
    except (RecursionError, ValueError) as error:
        why = error.msg if isinstance(error, json.JSONDecodeError) else type(error).__name__
        raise BadInput(
            f"{path}, line {number}",
            f"is not valid JSON ({why})",
            "correct the line, or cut it out",
        ) from error


def _inside(path: Path, number: int, found: Any, table: str | None) -> Any:
    for key in [] if table is None else table.split("."):
        if not isinstance(found, dict) or key not in found:
            known = ", ".join(f"'{k}'" for k in list(found)[:20]) if isinstance(found, dict) else ""
            raise BadInput(
                f"{path}, line {number}, table '{table}'",
                f"there is no key '{key}'",
                f"it has {known}" if known else "give the path to the object with the columns",
            )
        found = found[key]
    return found


READER = Reader("jsonl", (".jsonl", ".ndjson"), read_json_lines, whole=True)
