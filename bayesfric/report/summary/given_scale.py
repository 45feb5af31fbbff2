"""Numbers whose scale somebody told: the data give them in units of a number with a known prior.

Where a factor common to several numbers changes no torque, the data leave each of them open. A
prior on one, such as a weight that was put on scales, settles the factor, and with it all others.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from bayesfric.report.summary.record import Summary
from bayesfric.report.summary.rows import PosteriorRow

# Share of the prior's sd at most, as in bayesfric.identifiability.local.verdict, and how many times
# better than any other prior along the direction the one that settles it is known.
_LEFT, _BETTER = 0.5, 2.0


def tell_given_scales(summary: Summary) -> Summary:
    """Say of numbers that are open along told directions alone whose prior settled them.

    They are ``weak``: neither of the data nor of the prior alone.
    """
    ways = [{*one.parameters} for one in summary.identifiability.null_directions]
    given = [settled_by(summary, way) for way in ways]
    changes: dict[str, dict[str, Any]] = {}
    for name, row in summary.rows.items():
        # a derived number may change along any of them
        along = [
            by
            for way, by in zip(ways, given, strict=True)
            if name in way or alpha_of(name) in way or name in summary.derived
        ]
        known = [by for by in along if by is not None and by != name]
        if row.verdict == "prior" and known and len(known) == len(along) and _narrowed(row):
            changes[name] = {"verdict": "weak", "given_by": list(dict.fromkeys(known))}
    return summary.with_rows(changes) if changes else summary


def alpha_of(name: str) -> str:
    """Name the torque factor that a load loss sets: mu is open where alpha is."""
    element, _, quantity = name.partition(".")
    return f"{element}.alpha_{quantity.removeprefix('load_')}" if "load_" in quantity else name


def settled_by(summary: Summary, way: Collection[str]) -> str | None:
    """Name the parameter whose told prior settles a direction, if one does."""
    rows = {name: summary.parameters[name] for name in way if name in summary.parameters}
    known = {name: _relative(row) for name, row in rows.items()}
    best = min(known, key=lambda name: known[name], default=None)
    if best is None or rows[best].prior_default:
        return None
    others = min((known[name] for name in rows if name != best), default=float("inf"))
    return best if others >= _BETTER * known[best] else None


def _relative(row: PosteriorRow) -> float:
    """Sd of the prior over the value: what it says of a common factor."""
    if row.prior_sd is None or not row.middle:
        return float("inf")
    return row.prior_sd / abs(row.middle)


def _narrowed(row: PosteriorRow) -> bool:
    return row.prior_sd is None or row.sd < _LEFT * row.prior_sd
