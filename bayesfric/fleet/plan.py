"""``FLEET.toml``: one template, the units it is filled for, and how they are worked through."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from pydantic import Field, model_validator

from bayesfric.base.errors import BadInput, Unfit
from bayesfric.base.options import Options
from bayesfric.fleet.fleet_units import (
    PLACEHOLDER,
    Unit,
    find_units,
    put_in,
    read_units,
)
from bayesfric.fleet.results import COLUMNS
from bayesfric.problem.config import checked_toml, parse_config, read_document, read_toml
from bayesfric.problem.config_text import document_text


class UnitsOptions(Options):
    """The ``[units]`` table: what is fitted."""

    table: str | None = Field(
        None,
        examples=["units.csv"],
        description="CSV, a unit a row, a column a name.",
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
    """The ``[runs]`` table: what is kept of every unit."""

    light: bool = Field(True, description="no figures, tables and pages, and few draws")
    draws: int = Field(300, ge=50, le=100_000, description="of the posterior, kept in light runs")


class ClusterOptions(Options):
    """The ``[cluster]`` table: who works."""

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
        """Write the configuration of a unit; a text that is one placeholder becomes its value.

        Raises
        ------
        BadInput
            Naming the key, if a placeholder has no column, or an empty cell.
        """

        def put(value: Any, place: str) -> Any:
            inner = place and f"{place}."
            if isinstance(value, Mapping):
                return {key: put(x, f"{inner}{key}") for key, x in value.items()}
            if isinstance(value, list):
                return [put(x, f"{inner}{k}") for k, x in enumerate(value, start=1)]
            if not isinstance(value, str):
                return value
            text = put_in(value, unit.text, f"{self.path}: {place}", f"unit {unit.name!r}")
            alone = PLACEHOLDER.fullmatch(value)
            return unit.values[alone[1]] if alone and alone[1] is not None else text

        return document_text(put(self.document, ""), self.path)


@dataclass(frozen=True)
class Plan:
    """A fleet to be worked through."""

    path: Path
    template: Template
    units: Sequence[Unit]
    runs: RunOptions = field(default_factory=RunOptions)
    cluster: ClusterOptions = field(default_factory=ClusterOptions)

    def checked(self) -> Plan:
        """Refuse what could fit no unit: it would be the same line a thousand times.

        Raises
        ------
        BadInput
            Naming the column or key.
        """
        for name in self.units[0].text:
            same = name == "unit" and all(one.text[name] == one.name for one in self.units)
            if name in COLUMNS and not same:
                what = f"a column cannot be called {name!r}, which results are"
                raise BadInput(str(self.path), what, "give it another name")
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
    """Read a configuration whose texts hold placeholders; it is checked when they are filled."""
    return Template(path.absolute(), read_document(read_toml(path), path))


def read_plan(path: Path) -> Plan:
    """Read ``FLEET.toml``, its template and its units.

    Raises
    ------
    BadInput
        Naming file and key, column or row, for anything that fits no unit.
    """
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
