"""Reading JSON lines: one object a line."""

from __future__ import annotations

from pathlib import Path

from bayesfric.recordings.tables.json_rows import from_rows, inside, parse
from bayesfric.recordings.tables.reader import Reader, TableOptions, read_text
from bayesfric.recordings.tables.table import Table


def read_json_lines(path: Path, options: TableOptions) -> Table:
    """Read an object a line, one column a key; blank lines are left out.

    ``options.table`` is the path of keys to the object with the columns, the same in each line.
    """
    text = enumerate(read_text(path).split("\n"), start=1)
    lines = {number: line for number, line in text if line.strip()}
    places = {number: f"{path}, line {number}" for number in lines}
    rows = [inside(places[n], parse(places[n], line), options.table) for n, line in lines.items()]
    return from_rows(path, rows, list(lines))


READER = Reader("jsonl", (".jsonl", ".ndjson"), read_json_lines)
