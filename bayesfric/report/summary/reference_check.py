"""Whether references that a configuration gives fit what was found."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from bayesfric.report.summary.record import Summary

# Sds between a reference and what was found that are no chance.
_FAR = 4.0
# Units that a wrong scale of the torque multiplies; a loss per torque, an angle or a speed not.
_SCALED = {"kg", "N"}


def references_off(summary: Summary) -> Mapping[str, Any] | None:
    """Name references far from what was found, and the one factor of all, for its sentence.

    Far counts the sd of the told interval and the reference's own. ``None`` where none is; what the
    data leave open contradicts nothing.
    """
    compared = list(_compared(summary))
    off = [one for one in compared if one["times"] > _FAR]
    if not off:
        return None
    scaled = [one for one in compared if one["scaled"]]
    return {"off": off, "factor": _common(scaled) if any(one in off for one in scaled) else None}


def _compared(summary: Summary) -> Iterator[dict[str, Any]]:
    for name, reference in summary.references.items():
        row = summary.rows.get(name)
        if row is None or row.verdict == "prior" or row.converged is False:
            continue
        away = row.middle - reference.value
        if row.period:
            away -= row.period * round(away / row.period)
        sd = float(np.hypot(row.told_sd, reference.sd or 0.0))
        same = reference.value * row.middle > 0.0 and not row.period
        yield {
            "name": name,
            "unit": row.unit,
            "found": row.middle,
            "value": reference.value,
            "times": abs(away) / sd if sd > 0.0 else 0.0,
            "factor": row.middle / reference.value if same else None,
            "relative": sd / abs(row.middle) if row.middle else 0.0,
            "scaled": bool(_SCALED & set(row.unit.replace("²", "").split())),
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
