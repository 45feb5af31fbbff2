"""Whether references and priors that a configuration gives fit what was found."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from bayesfric.inference.prior.priors import KNOWN
from bayesfric.mechanism.parameter import scales_with_torque
from bayesfric.report.summary.record import Summary
from bayesfric.report.summary.rows import PosteriorRow, sd_towards

# Sds between a reference and what was found that are no chance.
_FAR = 3.0
# What data say of a posterior of which they have less than this share is hardly told by it.
_LEAST_SHARE = 0.1


def references_off(summary: Summary) -> dict[str, Any] | None:
    """Name references far from what was found, and the one factor of all.

    So are priors that the data contradict. Far counts the sd of the told interval and the
    reference's own. ``None`` where none is; what the data leave open contradicts nothing.
    """
    compared = list(_compared(summary))
    off = [one for one in compared if one["times"] > _FAR]
    if not off:
        return None
    scaled = [one for one in compared if one["scaled"]]
    # a gain that is fitted is that factor already
    factor = _common(scaled) if not summary.scaled and any(one in off for one in scaled) else None
    return {"off": {one["name"]: one["times"] for one in off}, "compared": off, "factor": factor}


def priors_off(summary: Summary) -> dict[str, float]:
    """Name told priors that the data contradict, with how many sds they are off."""
    found = references_off(summary) or {"compared": ()}
    return {one["name"]: one["times"] for one in found["compared"] if one["by"] == "prior"}


def _compared(summary: Summary) -> Iterator[dict[str, Any]]:
    for name, reference in summary.references.items():
        row = summary.rows.get(name)
        if row is not None and row.verdict != "prior" and row.converged is not False:
            sd = sd_towards(reference.value, row.middle, row.told_interval, row.told_sd)
            found = _beside(row, reference.value, reference.sd, row.middle, sd)
            yield {"name": name, "by": "reference"} | found
    for name, row in summary.joint.items():
        if name in summary.references or row.converged is False:
            continue
        if told := _of_data(row):
            yield {"name": name, "by": "prior"} | _beside(row, *told)


def _of_data(row: PosteriorRow) -> tuple[float, float, float, float] | None:
    """Give value and sd of a told prior that is narrow, and of what the data say without it.

    As if both were normal: precisions add up, and means weighed by them. The sd is that were the
    model right, as when the two were made one: a model error may be no more than that they differ.
    """
    if row.prior_default or row.prior_sd is None or row.prior_interval is None or row.period:
        return None
    value, sd = sum(row.prior_interval) / 2.0, row.prior_sd
    if not 0.0 < row.sd < sd < KNOWN * abs(value):
        return None
    share = 1.0 - (row.sd / sd) ** 2  # that the data have in the posterior
    if share < _LEAST_SHARE:
        return None
    found = value + (row.middle - value) / share
    return value, sd, found, row.sd / share**0.5


def _beside(
    row: PosteriorRow, value: float, known: float | None, found: float, found_sd: float
) -> dict[str, Any]:
    """Put what was found beside a value that is ``known`` so well."""
    away = found - value
    if row.period:
        away -= row.period * round(away / row.period)
    sd = float(np.hypot(found_sd, known or 0.0))
    return {
        "times": abs(away) / sd if sd > 0.0 else 0.0,
        "factor": found / value if value * found > 0.0 and not row.period else None,
        "relative": sd / abs(found) if found else 0.0,
        "scaled": scales_with_torque(row.unit),
    }


def _common(scaled: list[dict[str, Any]]) -> float | None:
    """Give the factor by which all are off alike, if there is one."""
    if not all(one["factor"] and one["relative"] for one in scaled):
        return None
    logs = np.log([one["factor"] for one in scaled])
    weights = np.array([one["relative"] for one in scaled]) ** -2.0
    mean = float(weights @ logs / weights.sum())
    alike = np.abs(logs - mean) < _FAR * weights**-0.5
    return float(np.exp(mean)) if alike.all() else None
