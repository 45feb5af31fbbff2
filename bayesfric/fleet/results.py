"""The table of a fleet's results: a row for each unit and quantity, whole at every moment."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel

from bayesfric.base.atomic_write import atomic_path
from bayesfric.base.errors import BadInput
from bayesfric.fleet.fleet_units import Unit
from bayesfric.report.summary.record import Summary

if TYPE_CHECKING:
    import pyarrow as pa

# Columns before those of the units; the kinds are Arrow's names.
COLUMNS = {
    "unit": "string",  # of the fleet
    "outcome": "string",  # of its fit, as its verdict has it, or "failed"
    "quantity": "string",
    "value": "double",
    "sd": "double",
    "low": "double",
    "high": "double",
    "level": "double",
    "measure": "string",  # unit of the numbers
    "status": "string",  # identified, doubtful, limit, prior or unidentified
    "findings": "string",  # that move it by more than its interval
    "error": "string",  # the line of a unit that failed
}
FAILED = "failed"
# Share of the time that may go into writing the table while units come in.
_SHARE = 0.02

Record = Mapping[str, Any]


class Kept(BaseModel):
    """What a fleet keeps of a unit."""

    outcome: str
    findings: list[str]
    error: str | None
    rows: list[dict[str, str | float | bool | None]]


def record_of(summary: Summary) -> dict[str, Any]:
    """Give what a fleet keeps of a finished run: strings, numbers, lists and dicts."""
    rows = []
    for name, row in summary.rows.items():
        if (told := row.reported) is None:
            continue
        low, high = told.interval
        rows.append(
            {
                "quantity": name,
                "value": told.value,
                "sd": told.sd,
                "low": low,
                "high": high,
                "level": row.level,
                "measure": row.unit,
                "status": told.status,
                "findings": ", ".join(told.how.findings),
            }
        )
    found = [finding.kind for finding in summary.findings]
    kept = Kept(outcome=summary.verdict.outcome, findings=found, error=None, rows=rows)
    return kept.model_dump()


def failure(error: str) -> dict[str, Any]:
    """Give what a fleet keeps of a unit that failed: its one line."""
    return Kept(outcome=FAILED, findings=[], error=error, rows=[]).model_dump()


class Results:
    """What came in so far; ``path`` holds it as a Parquet file that is always a whole one.

    Rows go by the units' order and the summary's, whatever order they come in: the file of a
    finished fleet has the same bytes every time.
    """

    def __init__(self, path: Path, units: Sequence[Unit]) -> None:
        self.path, self._units = path, units
        self.records: dict[str, Record] = {}
        self._written, self._took = 0.0, 0.0

    def add(self, name: str, record: Record) -> None:
        """Take a unit's result; the file follows, as often as takes little of the time."""
        self.records[name] = record
        if time.monotonic() - self._written > self._took / _SHARE:
            self.write()

    def write(self) -> None:
        """Write all results so far.

        Raises
        ------
        BadInput
            If the disk takes no more.
        """
        import pyarrow.parquet as pq

        began = time.monotonic()
        try:
            with atomic_path(self.path) as partial:
                pq.write_table(self.table(), partial)
        except OSError as error:
            what = f"cannot be written ({error.strerror or error})"
            raise BadInput(str(self.path), what, "mend that, then go on with --resume") from None
        self._written = time.monotonic()
        self._took = self._written - began

    def table(self) -> pa.Table:
        """Lay everything out, the columns of the units last."""
        import pyarrow as pa

        own = [name for name in self._units[0].values if name not in COLUMNS]
        kinds = COLUMNS | {name: self._kind(name) for name in own}
        schema = pa.schema([(name, pa.type_for_alias(kind)) for name, kind in kinds.items()])
        return pa.Table.from_pylist(list(self._rows()), schema=schema)

    def _kind(self, column: str) -> str:
        kinds = {type(unit.values[column]) for unit in self._units} - {type(None)}
        names = {str: "string", float: "double", int: "int64", bool: "bool"}
        return names[kinds.pop()] if len(kinds) == 1 else "string"

    def _rows(self) -> Iterator[dict[str, Any]]:
        for unit in self._units:
            if (record := self.records.get(unit.name)) is None:
                continue
            told = {"unit": unit.name, "outcome": record["outcome"], "error": record["error"]}
            told = unit.values | told
            for row in record["rows"] or [{}]:
                yield told | row
