"""``FLEET.toml``: a template, the units that it is filled for, and how they are fitted.

Units are rows of a table, or files found by a pattern with named parts.
"""

from __future__ import annotations

import glob
import io
import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from pydantic import Field, model_validator

from bayesfric.base.errors import BadInput, Unfit, nearest
from bayesfric.base.options import Options
from bayesfric.base.safe_read import read_text
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
# What is no name of a folder on some file system.
_NO_NAME = re.compile(r'|[. ].*|.*[/\\:*?"<>|\x00-\x1f\x7f].*', re.DOTALL)
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
    def _table_or_glob(self) -> Self:
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
    memory_limit: str = Field("4 GiB", description="of a worker, which is started again beyond it")
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
class Plan:
    """A fleet to be fitted: a configuration with ``{column}`` in its texts, and its units."""

    path: Path
    template: Path  # file names in the configuration are relative to its folder
    document: Mapping[str, Any]
    units: Sequence[Unit]
    runs: RunOptions
    cluster: ClusterOptions

    def configuration(self, unit: Unit) -> str:
        """Write the configuration of a unit; a text that is one placeholder becomes its value."""

        def fill(value: Any, key: str) -> Any:
            prefix = key and f"{key}."
            if isinstance(value, Mapping):
                return {name: fill(x, f"{prefix}{name}") for name, x in value.items()}
            if isinstance(value, list):
                return [fill(x, f"{prefix}{k}") for k, x in enumerate(value, start=1)]
            if not isinstance(value, str):
                return value
            text = _filled(value, unit.text, f"{self.template}: {key}", f"unit {unit.name!r}")
            single = _PLACEHOLDER.fullmatch(value)
            return unit.values[single[1]] if single and single[1] is not None else text

        return document_text(fill(self.document, ""), self.template)

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
                parse_config(self.configuration(unit), self.template)
            except BadInput as error:
                errors.append(error)
            else:
                return self
        raise errors[0]


def read_plan(path: Path, text: str | None = None, units: Sequence[Unit] | None = None) -> Plan:
    """Read ``FLEET.toml``, or its ``text``, its template, and units that are not given."""
    tables = checked_toml(read_toml(path) if text is None else text, path, FleetTables, "fleet")
    folder, options = path.parent, tables.units
    if isinstance(tables.template, str):
        template = (folder / tables.template).absolute()
        document = read_document(read_toml(folder / tables.template), folder / tables.template)
    else:
        template, document = path.absolute(), tables.template
    if units is None and options.table is not None:
        units = read_units(folder / options.table, options.name)
    elif units is None:
        units = find_units(str(options.glob), folder, options.name, template.parent)
    return Plan(path, template, document, units, tables.runs, tables.cluster).checked()


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

    text = read_text(path)
    delimiter = max(",;\t", key=text.partition("\n")[0].count)
    try:
        # with a header pandas would rename the second of two columns with the same name
        cells = pd.read_csv(
            io.StringIO(text), sep=delimiter, header=None, dtype=str, keep_default_na=False
        )
    except ValueError as error:
        hint = "give a header, and a row for each unit"
        raise BadInput(str(path), f"is no table of units ({error})", hint) from None
    frame = cells[1:].set_axis(cells.iloc[0], axis=1)
    return units_of(frame, pattern, str(path), first_row=2)


def find_units(
    pattern: str, folder: Path, names: str | None, template_folder: Path | None = None
) -> list[Unit]:
    """Find files such as ``logs/{robot}/{day}.csv``, a unit each; ``{file}`` is its path."""
    import pandas as pd

    where = f"units.glob = {pattern!r}"
    parts = [m[1] for m in _PLACEHOLDER.finditer(pattern) if m[1] is not None]
    if not parts or not all(part.isidentifier() and part != "file" for part in parts):
        hint = "write a word in braces for each part, such as logs/{robot}/{day}.csv"
        raise BadInput(where, "has no named parts", hint)
    pattern = os.path.normpath(pattern)
    regex = re.escape(pattern)
    for wildcard, meaning in (("**/", "(?:.*/)?"), ("*", "[^/]*"), ("?", "[^/]")):
        regex = regex.replace(re.escape(wildcard), meaning)
    for part in parts:  # a repeated part is the same in both places
        placeholder = re.escape(f"{{{part}}}")
        regex = regex.replace(placeholder, f"(?P<{part}>[^/]+?)", 1)
        regex = regex.replace(placeholder, f"(?P={part})")
    # brackets are letters here
    wildcards = _PLACEHOLDER.sub("?*", pattern).replace("[", "[[]")
    # Path.glob finds hidden files, and takes no absolute pattern
    paths = sorted(glob.glob(wildcards, root_dir=folder, recursive=True))  # noqa: PTH207
    matches = [match for path in paths if (match := re.fullmatch(regex, path, re.DOTALL))]
    if not matches:
        raise BadInput(where, f"no file in {folder} matches it", "check the pattern")
    start = template_folder or folder
    files = [os.path.relpath(folder / match[0], start) for match in matches]
    frame = pd.DataFrame([match.groupdict() for match in matches]).assign(file=files)
    return units_of(frame, names or "-".join(f"{{{part}}}" for part in dict.fromkeys(parts)), where)


def units_of(
    frame: pd.DataFrame, pattern: str | None, source: str, first_row: int | None = None
) -> list[Unit]:
    """Make units of the rows of a table, whose name in messages is ``source``."""
    columns = [str(name).strip() for name in frame.columns]
    for k, name in enumerate(columns):
        if not name or name in columns[:k]:
            problem = f"two columns are named {name!r}" if name else "a column has no name"
            raise BadInput(source, problem, "name each column")
    if frame.empty:
        raise BadInput(source, "has no rows", "add a row for each unit")
    if pattern is None:
        pattern = next((f"{{{name}}}" for name in ("unit", "name") if name in columns), None)
        if pattern is None:
            hint = "add a column 'unit', or write name = \"{serial}-{day}\" under [units]"
            raise BadInput(source, "has no names of units", hint)
    texts = [[_cell(x) for x in frame.iloc[:, k].tolist()] for k in range(len(columns))]
    typed = dict(zip(columns, map(_typed, texts), strict=True))
    units: dict[str, Unit] = {}
    hint = "choose another with name = ... under [units]"
    for number, row in enumerate(zip(*texts, strict=True)):
        where = source if first_row is None else f"{source}, row {number + first_row}"
        text = dict(zip(columns, row, strict=True))
        name = _filled(pattern, text, f"{where}: units.name", source)
        if _NO_NAME.fullmatch(name) or len(name.encode()) > 180:
            raise BadInput(where, f"{name[:60]!r} cannot be the name of a folder", hint)
        if name in units:
            raise BadInput(where, f"{name!r} is there twice", hint)
        units[name] = Unit(name, text, {c: values[number] for c, values in typed.items()})
    return list(units.values())


def _typed(cells: Sequence[str]) -> Sequence[Value]:
    """Convert a column to numbers or booleans where TOML reads all its cells as such.

    A serial number such as 007 is a text: as a number it would lose its zeros.
    """
    try:
        values = [tomllib.loads(f"x = {cell}")["x"] if cell else None for cell in cells]
    except tomllib.TOMLDecodeError:
        values = []
    kinds = {type(value) for value in values} - {type(None)}
    if kinds == {bool} or kinds == {int}:
        return values
    if kinds and kinds <= {int, float}:
        return [None if value is None else float(value) for value in values]
    return [cell or None for cell in cells]


def _cell(value: Any) -> str:
    """Write a cell as a CSV file has it."""
    if value is None or value != value:  # nan
        return ""
    return str(value).lower() if isinstance(value, bool) else str(value).strip()
