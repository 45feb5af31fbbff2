"""Concludes what is reported of every number of a summary, from all that was asked of it."""

from __future__ import annotations

from typing import Any

from bayesfric.report.summary.bounds import told_by_data
from bayesfric.report.summary.record import Own, Summary
from bayesfric.report.summary.rows import PosteriorRow
from bayesfric.report.summary.self_check_part import cited
from bayesfric.results.reported import Reported, Spread, concluded


def put_reported(summary: Own) -> Own:
    """Put the one value, interval and status into every row; the last thing that is done.

    Runs of older versions, which have none, are concluded as they are read; what has all stays.
    """
    if all(row.reported is not None for row in summary.rows.values()):
        return summary
    corrected = cited(summary)
    changes: dict[str, dict[str, Any]] = {}
    rows = summary.self_check.rows if summary.self_check else {}
    for name, row in summary.rows.items():
        right = corrected.get(name)
        bias = rows[name].bias if right else None
        changes[name] = {"reported": _reported(summary, row, right, bias)}
    return summary.with_rows(changes)


def _reported(
    summary: Summary,
    row: PosteriorRow,
    corrected: tuple[float, float, float, float] | None,
    bias: float | None,
) -> Reported:
    widened = None
    if row.model_error_interval is not None and row.model_error_sd is not None:
        low, high = row.model_error_interval
        value = row.middle if row.model_error_value is None else row.model_error_value
        widened = Spread(value, low, high, row.model_error_sd)
    leans = row.at_bound is not None and (row.verdict == "data" or told_by_data(row))
    unusable = summary.sampler.status == "unusable"
    reliable = summary.sampler.status == "reliable"
    low, high = row.interval
    return concluded(
        Spread(row.middle, low, high, row.sd),
        verdict=row.verdict,
        own_prior=bool(row.given_by) or (not row.prior_default and bool(row.prior)),
        converged=reliable or (not unusable if row.converged is None else row.converged),
        widened=widened,
        corrected=Spread(*corrected) if corrected else None,
        bias=bias,
        limit=row.at_bound if leans else None,
        findings=row.doubted if row.verdict != "prior" else (),
    )
