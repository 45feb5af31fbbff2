"""What a run leaves open and why, and what lifts it; as data.

The template ``findings.html.j2`` words it.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Any

from bayesfric.report.paper.tables import ParameterRow, ParameterTable
from bayesfric.report.summary.record import OpenDirectionRow, RemedyRow, Summary


def findings(table: ParameterTable, summary: Summary) -> dict[str, Any]:
    """Gather what is open, why, and what lifts it, for the template to word."""
    joint, found = table.joint, summary.identifiability
    # and what no scaling changes
    rows = [*joint, *(r for r in table.rows if r.group == "free")]
    directions = found.directions or []
    null = found.null_directions if found.directions is None else []
    return {
        "lost": [r.name for r in rows if not r.cell.converged],
        "open": {r.name: r.meaning for r in rows if r.by == "open" and r.cell.converged},
        "why": [(one.meaning, one.reasons) for one in directions] + [(n.meaning, []) for n in null],
        # remedies, each with how many of the directions it lifts, if any were looked for
        "steps": _steps(directions),
        "directions": len(directions),
        "command": _command(joint),
    }


def _steps(directions: Sequence[OpenDirectionRow]) -> list[tuple[RemedyRow, int]]:
    """List remedies, those that leave fewest directions open first, each one once."""
    found: dict[str, tuple[RemedyRow, int]] = {}
    for direction in directions:
        for remedy in direction.remedies:
            first, lifted = found.get(remedy.text, (remedy, 0))
            found[remedy.text] = first, lifted + 1

    def order(one: tuple[RemedyRow, int]) -> tuple[int, int, bool]:
        remedy, lifted = one
        after = len(directions) if remedy.open_after is None else remedy.open_after
        # an experiment was simulated; a value from elsewhere has to be believed
        return after, -lifted, remedy.kind == "known value"

    return sorted(found.values(), key=order)


def _command(joint: Sequence[ParameterRow]) -> str:
    """Ask for advice on what is open, or else on what is known least."""
    if not joint or not all(row.cell.converged for row in joint):
        return ""

    def known(row: ParameterRow) -> tuple[bool, float]:
        spread = row.row.told_sd / abs(row.row.mean) if row.row and row.row.mean else 0.0
        return row.by != "open", -spread

    # a constant in the measurement is asked for last
    asked = [row for row in joint if row.name.partition(".")[0] != "offset"] or joint
    name = min(asked, key=known).name
    return f"bayesfric identify YOUR-CONFIGURATION.toml --advise {shlex.quote(name)}"
