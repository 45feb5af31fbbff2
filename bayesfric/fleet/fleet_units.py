"""The units of a fleet: rows of a table, or files found by a pattern with named parts."""

from __future__ import annotations

import glob
import io
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.safe_read import check_file, read_text
from bayesfric.recordings.tables.table import check_names

if TYPE_CHECKING:
    import pandas as pd

Value = str | float | int | bool | None

# Units of a fleet, and bytes of their table.
MOST_UNITS, _LARGEST_TABLE = 100_000, 2**24
# What every file system takes, with room for what is put before and behind.
_LONGEST = 180
# A serial number such as 007 is none: it would lose its noughts.
_NUMBER = r"-?(0|[1-9][0-9]*)(\.[0-9]*)?([eE][-+]?[0-9]+)?"
_WHOLE = r"-?(0|[1-9][0-9]{0,17})"
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
    """Read a CSV table, a unit a row; ``pattern`` is that of their names.

    Raises
    ------
    BadInput
        Naming the row, for what cannot be used.
    """
    import pandas as pd

    size = check_file(path)
    try:
        text = read_text(path, largest=_LARGEST_TABLE)
        _check_count(text.count("\n") - 1, str(path))
        head = text.partition("\n")[0]
        delimiter = max(",;\t", key=head.count)
        check_names(str(path), [""] * (head.count(delimiter) + 1), "header")
        # no header: pandas would rename the second of two columns of one name
        cells = pd.read_csv(
            io.StringIO(text), sep=delimiter, header=None, dtype=str, keep_default_na=False
        )
    except (OSError, ValueError) as error:
        what = f"is no table of units ({error})" if size else "is empty"
        raise BadInput(str(path), what, "give a row of names, and one for each unit") from None
    frame = cells[1:].set_axis(cells.iloc[0], axis=1)
    return units_of(frame, pattern, str(path), first_row=2)


def find_units(pattern: str, folder: Path, names: str | None, start: str = ".") -> list[Unit]:
    """Find files such as ``logs/{robot}/{day}.csv``, a unit each; ``{file}`` is its path.

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
    pattern = os.path.normpath(pattern)
    # brackets are letters here
    wild = PLACEHOLDER.sub("?*", pattern).replace("[", "[[]")
    regex = _regex(pattern)
    rows = []
    # Path.glob finds hidden files, and takes no absolute pattern
    for path in sorted(glob.glob(wild, root_dir=folder, recursive=True)):  # noqa: PTH207
        if match := regex.fullmatch(path):
            file = os.path.normpath(os.path.join(start, os.path.relpath(folder / path, folder)))  # noqa: PTH118 (a text)
            rows.append({**match.groupdict(), "file": file})
    if not rows:
        raise BadInput(where, f"no file in {folder} matches it", "check the pattern")
    import pandas as pd

    frame = pd.DataFrame(rows)
    names = names or "-".join(f"{{{part}}}" for part in dict.fromkeys(parts))
    return units_of(frame, names, where)


def _regex(pattern: str) -> re.Pattern[str]:
    """Turn a pattern into a regular expression whose groups are its named parts."""
    wild = {"**/": "(?:.*/)?", "*": "[^/]*", "?": "[^/]"}
    names = list[str]()
    regex = ""
    for token in re.split(r"(\{\w+\}|\*\*/|\*|\?)", pattern):
        name = token[1:-1] if token[:1] == "{" else ""
        if name in names:  # a part that is named twice is the same in both places
            regex += f"(?P={name})"
        elif name:
            names.append(name)
            regex += f"(?P<{name}>[^/]+?)"
        else:
            regex += wild.get(token, re.escape(token))
    return re.compile(regex, re.DOTALL)


def _check_count(count: int, known: str) -> None:
    if count > MOST_UNITS:
        mend = "divide it into several fleets"
        raise BadInput(known, f"has {count} rows, more than {MOST_UNITS}", mend)


def units_of(
    frame: pd.DataFrame, pattern: str | None, known: str, first_row: int | None = None
) -> list[Unit]:
    """Make units of the rows of a table; ``known`` is what complaints call it.

    Raises
    ------
    BadInput
        Naming the row, if a name cannot be that of a folder, or is there twice.
    """
    columns = [str(name).strip() for name in frame.columns]
    check_names(known, columns, "header")
    if not all(columns):
        raise BadInput(known, "a column has no name", "give each a name of its own")
    _check_count(len(frame), known)
    if pattern is None:
        own = next((name for name in ("unit", "name") if name in columns), None)
        if own is None:
            mend = "add a column 'unit', or say name = \"{serial}-{day}\" under [units]"
            raise BadInput(known, "does not say what units are called", mend)
        pattern = f"{{{own}}}"
    texts = [[_cell(x) for x in frame.iloc[:, k].tolist()] for k in range(len(columns))]
    typed = dict(zip(columns, map(_typed, texts), strict=True))
    units: dict[str, Unit] = {}
    for number, row in enumerate(zip(*texts, strict=True)):
        where = known if first_row is None else f"{known}, row {number + first_row}"
        text = dict(zip(columns, row, strict=True))
        name = put_in(pattern, text, f"{where}: units.name", known)
        if _NOT_IN_NAMES.search(name) or name[0] in ". " or len(name.encode()) > _LONGEST:
            mend = "give it another with name = ... under [units]"
            raise BadInput(where, f"{name[:60]!r} cannot be the name of a folder", mend)
        if name in units:
            mend = "give each row a name of its own, or name = ... under [units]"
            raise BadInput(where, f"{name!r} is there twice", mend)
        units[name] = Unit(name, text, {c: values[number] for c, values in typed.items()})
    if not units:
        raise BadInput(known, "has no rows", "give a row for each unit")
    return list(units.values())


def _typed(cells: Sequence[str]) -> Sequence[Value]:
    """Take a column for numbers, or true and false, where all its cells are."""
    full = [cell for cell in cells if cell]
    makes: tuple[tuple[str, Any], ...] = (
        (_WHOLE, int),
        (_NUMBER, float),
        ("true|false", "true".__eq__),
    )
    for pattern, make in makes:
        if full and all(re.fullmatch(pattern, cell) for cell in full):
            return [make(cell) if cell else None for cell in cells]
    return [cell or None for cell in cells]


def _cell(value: Any) -> str:
    """Write a cell as a CSV file has it."""
    if value is None or value != value:  # nan
        return ""
    return str(value).lower() if isinstance(value, bool) else str(value).strip()
