"""Angles of several runs on one turn of the circle: 3.13 and -3.13 lie close together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from bayesfric.mechanism.parameter import turned
from bayesfric.report.summary.record import (
    EstimatedRow,
    KnownRow,
    PosteriorRow,
    ReferenceRow,
    Summary,
)

Row = TypeVar("Row", EstimatedRow, KnownRow, PosteriorRow, ReferenceRow)
_PLACES = ("mean", "median", "value", "bound")
_ENDS = ("interval", "span")


def on_one_turn(runs: Mapping[str, Summary]) -> dict[str, Summary]:
    """Bring every number of an angle by whole turns next to the first run's.

    Parameters
    ----------
    runs
        Checked summaries by name.
    """
    towards: dict[str, float] = {}
    for run in runs.values():
        for name, row in run.parameters.items():
            if row.period is not None:
                towards.setdefault(name, row.middle)
    return {key: _turned(run, towards) for key, run in runs.items()} if towards else dict(runs)


def _turned(run: Summary, towards: Mapping[str, float]) -> Summary:
    def table(rows: Mapping[str, Row]) -> dict[str, Row]:
        return {
            name: _row(row, towards[name]) if name in towards else row for name, row in rows.items()
        }

    estimates = {
        method: found.model_copy(update={"parameters": table(found.parameters)})
        for method, found in run.estimates.items()
    }
    update = {
        "parameters": table(run.parameters),
        "fixed": table(run.fixed),
        "references": table(run.references),
        "estimates": estimates,
    }
    return run.model_copy(update=update)


def _row(row: Row, towards: float) -> Row:
    middle = row.middle if isinstance(row, PosteriorRow) else row.value
    by = float(turned(middle, towards) - middle)
    told = row.model_dump(exclude_none=True)
    moved = {key: told[key] + by for key in _PLACES if key in told}
    moved |= {key: [end + by for end in told[key]] for key in _ENDS if key in told}
    return row.model_copy(update=moved)
