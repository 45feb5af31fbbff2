"""The table of a fleet's results: a row for each unit and quantity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from bayesfric.fleet.fleet_units import Unit
from bayesfric.report.summary.record import Summary

if TYPE_CHECKING:
    import pandas as pd

# Columns before those of the units, and their types.
COLUMNS = {
    "unit": "string",  # of the fleet
    "outcome": "string",  # of its fit, as its verdict has it, or "failed"
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


def results_table(
    units: Sequence[Unit], runs: Mapping[str, Summary], errors: Mapping[str, str]
) -> pd.DataFrame:
    """Tabulate what is reported of each unit's fit, or why it failed; the units' columns last."""
    import pandas as pd

    rows: list[dict[str, Any]] = []
    for unit in units:
        if unit.name in errors:
            rows.append({"unit": unit.name, "outcome": FAILED, "error": errors[unit.name]})
            continue
        summary = runs[unit.name]
        for name, row in summary.rows.items():
            if (reported := row.reported) is None:
                continue
            rows.append(
                {
                    "unit": unit.name,
                    "outcome": summary.verdict.outcome,
                    "quantity": name,
                    "value": reported.value,
                    "sd": reported.sd,
                    "low": reported.interval[0],
                    "high": reported.interval[1],
                    "level": row.level,
                    "measure": row.unit,
                    "status": reported.status,
                    "findings": ", ".join(reported.how.findings),
                }
            )
    table = pd.DataFrame(rows, columns=[*COLUMNS]).astype(COLUMNS)
    values = {unit.name: unit.values for unit in units}
    columns = pd.DataFrame.from_dict(values, orient="index").convert_dtypes()
    own = [name for name in columns if name not in COLUMNS]
    return table.join(columns[own], on="unit")
