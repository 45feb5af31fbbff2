"""``FLEET.toml``: a template, the units that it is filled for, and how they are fitted.

Units are rows of a table, or files found by a pattern with named parts.
"""

from __future__ import annotations

import glob
import io
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from pydantic import Field, model_validator

from bayesfric.base.errors import BadInput, Unfit, nearest
from bayesfric.base.options import Options
from bayesfric.base.safe_read import check_file, read_text
from bayesfric.problem.config import (
    checked_toml,
    document_text,
    parse_config,
    read_document,
    read_toml,
)

if TYPE_CHECKING:
    import pandas as pd

Value = str | float | int | bool | None

# Columns of the results before those of the units, and their types.
COLUMNS = {
    "unit": "string",  # of the fleet
    "outcome": "string",  # of its fit, as in its verdict, or "failed"
    "quantity": "string",
    "value": "float64",
    "sd": "float64",
    "low": "float64",
    "high": "float64",
    "level": "float64",
    "measure": "string",  # unit of the numbers
    "status": "string",  # identified, doubtful, limit, prior or unidentified
    "findings": "string",  # that move it by more than its interval
    "error": "string",  # why a unit failed
}
FAILED = "failed"
# Units of a fleet, and bytes of their table.
MOST_UNITS, _MAX_BYTES = 100_000, 2**24
# Bytes of a name: what every file system takes, with a margin for prefix and suffix.
_LONGEST = 180
# A serial number such as 007 is a text: as a number it would lose its zeros.
_NUMBER = r"-?(0|[1-9][0-9]*)(\.[0-9]*)?([eE][-+]?[0-9]+)?"
_INTEGER = r"-?(0|[1-9][0-9]{0,17})"
_NOT_IN_NAMES = re.compile(r'[/\\:*?"<>|\x00-\x1f\x7f]')
_PLACEHOLDER = re.compile(r"\{\{|\}\}|\{([^{}]*)\}")


@dataclass(frozen=True)
class Unit:
    """A unit, and its row of the table."""

    name: str
    text: Mapping[str, str]  # as written, by column: for placeholders inside a text
    values: dict[str, Value]  # numbers as numbers; `None` where the cell is empty


class UnitsOptions(Options):
    """The ``[units]`` table."""

    table: str | None = Field(
        None, examples=["units.csv"], description="CSV, a unit a row, a column a name."
    )
    glob: str | None = Field(
        None,
        examples=["recordings/{unit}.csv"],
        description="Files with named parts, such as 'logs/{robot}/{day}.csv', one a unit.",
    )
    name: str | None = Field(
        None,
        examples=["{robot}-{day}"],
        description="What units are called, such as '{serial}-{day}'; the column 'unit', or all "
        "parts of the glob, if left out.",
    )

    @model_validator(mode="after")
    def _one_of(self) -> Self:
        if (self.table is None) == (self.glob is None):
            raise Unfit("a table or a glob", "got both" if self.table else "got neither")
        return self


class RunOptions(Options):
    """The ``[runs]`` table."""

    light: bool = Field(True, description="no figures, tables and pages, and few draws")
    draws: int = Field(300, ge=50, le=100_000, description="of the posterior, kept in light runs")


class ClusterOptions(Options):
    """The ``[cluster]`` table."""

    workers: int | None = Field(
        None,
        ge=1,
        le=1000,
        examples=[4],
        description="processes on this machine; as many as cores if left out",
    )
    memory_limit: str = Field("4 GiB", description="of a worker, which is started anew beyond it")
    scheduler: str | None = Field(
        None,
        examples=["tls://host:8786"],
        description="address of a running Dask scheduler; certificates are those of Dask's own "
        "configuration",
    )


class FleetTables(Options):
    """Everything that ``FLEET.toml`` may hold."""

    template: str | dict[str, Any] = Field(
        description="A configuration with {column} in its texts: its file, or the tables "
        "themselves, as [template.mechanism]."
    )
    units: UnitsOptions = Field(description="What is fitted.")
    runs: RunOptions = Field(RunOptions(), description="What is kept of every unit.")
    cluster: ClusterOptions = Field(ClusterOptions(), description="Who works.")


@dataclass(frozen=True)
class Template:
    """A configuration with ``{column}`` in its texts."""

    path: Path  # file names in it are relative to its folder
    document: Mapping[str, Any]

    def filled(self, unit: Unit) -> str:
        """Write the configuration of a unit; a text that is one placeholder becomes its value."""

        def fill(value: Any, key: str) -> Any:
            prefix = key and f"{key}."
            if isinstance(value, Mapping):
                return {name: fill(x, f"{prefix}{name}") for name, x in value.items()}
            if isinstance(value, list):
                return [fill(x, f"{prefix}{k}") for k, x in enumerate(value, start=1)]
            if not isinstance(value, str):
                return value
            text = _filled(value, unit.text, f"{self.path}: {key}", f"unit {unit.name!r}")
            single = _PLACEHOLDER.fullmatch(value)
            return unit.values[single[1]] if single and single[1] is not None else text

        return document_text(fill(self.document, ""), self.path)


@dataclass(frozen=True)
class Plan:
    """A fleet to be fitted."""

    path: Path
    template: Template
    units: Sequence[Unit]
    runs: RunOptions = field(default_factory=RunOptions)
    cluster: ClusterOptions = field(default_factory=ClusterOptions)

    def checked(self) -> Plan:
        """Refuse what fits no unit: it would be the same line a thousand times."""
        for name in self.units[0].text:
            same = name == "unit" and all(unit.text[name] == unit.name for unit in self.units)
            if name in COLUMNS and not same:
                problem = f"the column {name!r} has the name of a column of results"
                raise BadInput(str(self.path), problem, "rename it")
        errors: list[BadInput] = []
        for unit in self.units:
            try:
                parse_config(self.template.filled(unit), self.template.path)
            except BadInput as error:
                errors.append(error)
            else:
                return self
        raise errors[0]


def read_template(path: Path) -> Template:
    """Read a configuration with placeholders in its texts, which is checked when it is filled."""
    return Template(path.absolute(), read_document(read_toml(path), path))


def read_plan(path: Path) -> Plan:
    """Read ``FLEET.toml``, its template and its units."""
    tables = checked_toml(read_toml(path), path, FleetTables, "fleet")
    folder, options = path.parent, tables.units
    if isinstance(tables.template, str):
        template = read_template(folder / tables.template)
    else:
        template = Template(path.absolute(), tables.template)
    if options.table is not None:
        units = read_units(folder / options.table, options.name)
    else:
        assert options.glob is not None
        start = os.path.relpath(folder.absolute(), template.path.parent)
        units = find_units(options.glob, folder, options.name, start)
    return Plan(path, template, units, tables.runs, tables.cluster).checked()


def _filled(text: str, values: Mapping[str, str], where: str, source: str) -> str:
    """Fill ``{column}`` in a text with the values of ``source``; two braces are one."""

    def value_of(match: re.Match[str]) -> str:
        name = match[1]
        if name is None:
            return match[0][0]
        if name not in values:
            hint = nearest(name, values)
            raise BadInput(where, f"needs {{{name}}}, which {source} lacks", hint)
        if not values[name]:
            raise BadInput(where, f"needs {{{name}}}, which is empty in {source}", "fill it")
        return values[name]

    return _PLACEHOLDER.sub(value_of, text)


def read_units(path: Path, pattern: str | None) -> list[Unit]:
    """Read a CSV table, a unit in each row; ``pattern`` is that of their names."""
    import pandas as pd

    size = check_file(path)
    try:
        text = read_text(path, largest=_MAX_BYTES)
        _check_count(text.count("\n") - 1, str(path))
        header = text.partition("\n")[0]
        delimiter = max(",;\t", key=header.count)
        # with a header pandas would rename the second of two columns with the same name
        cells = pd.read_csv(
            io.StringIO(text), sep=delimiter, header=None, dtype=str, keep_default_na=False
        )
    except (OSError, ValueError) as error:
        problem = f"is no table of units ({error})" if size else "is empty"
        raise BadInput(str(path), problem, "give a header, and a row for each unit") from None
    frame = cells[1:].set_axis(cells.iloc[0], axis=1)
    return units_of(frame, pattern, str(path), first_row=2)


def find_units(pattern: str, folder: Path, names: str | None, start: str = ".") -> list[Unit]:
    """Find files such as ``logs/{robot}/{day}.csv``, a unit each; ``{file}`` is its path.

    ``start`` is the path of ``folder`` relative to the template's.
    """
    where = f"units.glob = {pattern!r}"
    parts = [m[1] for m in _PLACEHOLDER.finditer(pattern) if m[1] is not None]
    if not parts or not all(part.isidentifier() and part != "file" for part in parts):
        hint = "write a word in braces for each part, such as logs/{robot}/{day}.csv"
        raise BadInput(where, "has no named parts", hint)
    pattern = os.path.normpath(pattern)
    # brackets are letters here
    wildcards = _PLACEHOLDER.sub("?*", pattern).replace("[", "[[]")
    regex = _regex(pattern)
    rows = []
    # Path.glob finds hidden files, and takes no absolute pattern
    for path in sorted(glob.glob(wildcards, root_dir=folder, recursive=True)):  # noqa: PTH207
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
    wildcards = {"**/": "(?:.*/)?", "*": "[^/]*", "?": "[^/]"}
    names = list[str]()
    regex = ""
    for token in re.split(r"(\{\w+\}|\*\*/|\*|\?)", pattern):
        name = token[1:-1] if token[:1] == "{" else ""
        if name in names:  # a repeated part is the same in both places
            regex += f"(?P={name})"
        elif name:
            names.append(name)
            regex += f"(?P<{name}>[^/]+?)"
        else:
            regex += wildcards.get(token, re.escape(token))
    return re.compile(regex, re.DOTALL)


def _check_count(count: int, source: str) -> None:
    if count > MOST_UNITS:
        hint = "divide it into several fleets"
        raise BadInput(source, f"has {count} rows, more than {MOST_UNITS}", hint)


def units_of(
    frame: pd.DataFrame, pattern: str | None, source: str, first_row: int | None = None
) -> list[Unit]:
    """Make units of the rows of a table, whose name in messages is ``source``."""
    columns = [str(name).strip() for name in frame.columns]
    if not all(columns):
        raise BadInput(source, "a column has no name", "name each column")
    if repeated := [name for name in columns if columns.count(name) > 1]:
        problem = f"several columns are named '{repeated[0]}'"
        raise BadInput(f"{source}, header", problem, "rename one of them")
    _check_count(len(frame), source)
    if pattern is None:
        named = next((name for name in ("unit", "name") if name in columns), None)
        if named is None:
            hint = "add a column 'unit', or write name = \"{serial}-{day}\" under [units]"
            raise BadInput(source, "has no names of units", hint)
        pattern = f"{{{named}}}"
    texts = [[_cell(x) for x in frame.iloc[:, k].tolist()] for k in range(len(columns))]
    typed = dict(zip(columns, map(_typed, texts), strict=True))
    units: dict[str, Unit] = {}
    for number, row in enumerate(zip(*texts, strict=True)):
        where = source if first_row is None else f"{source}, row {number + first_row}"
        text = dict(zip(columns, row, strict=True))
        name = _filled(pattern, text, f"{where}: units.name", source)
        if _NOT_IN_NAMES.search(name) or name[0] in ". " or len(name.encode()) > _LONGEST:
            hint = "choose another with name = ... under [units]"
            raise BadInput(where, f"{name[:60]!r} cannot be the name of a folder", hint)
        if name in units:
            hint = "choose unique names, or name = ... under [units]"
            raise BadInput(where, f"{name!r} is there twice", hint)
        units[name] = Unit(name, text, {c: values[number] for c, values in typed.items()})
    if not units:
        raise BadInput(source, "has no rows", "add a row for each unit")
    return list(units.values())


def _typed(cells: Sequence[str]) -> Sequence[Value]:
    """Convert a column to numbers or booleans where all its cells are."""
    full = [cell for cell in cells if cell]
    types: tuple[tuple[str, Any], ...] = (
        (_INTEGER, int),
        (_NUMBER, float),
        ("true|false", "true".__eq__),
    )
    for pattern, convert in types:
        if full and all(re.fullmatch(pattern, cell) for cell in full):
            return [convert(cell) if cell else None for cell in cells]
    return [cell or None for cell in cells]


def _cell(value: Any) -> str:
    """Write a cell as a CSV file has it."""
    if value is None or value != value:  # nan
        return ""
    return str(value).lower() if isinstance(value, bool) else str(value).strip()
