"""What a run leaves open and why, and what lifts it; as data.

The template ``findings.html.j2`` words it.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from bayesfric.report.paper.tables import ParameterRow, ParameterTable
from bayesfric.report.summary.record import OpenDirectionRow, RemedyRow, Summary


@dataclass(frozen=True)
class OpenGroup:
    """Parameters that are open for one reason.

    ``lost``: not converged; ``direction``: ``meaning`` says along which, ``reasons`` why;
    ``prior``: the data alone would leave them wide.
    """

    kind: Literal["lost", "direction", "prior"]
    names: tuple[str, ...]
    meaning: str = ""
    reasons: tuple[str, ...] = ()


def findings(table: ParameterTable, summary: Summary) -> dict[str, Any]:
    """Gather what is open, why, and what lifts it, for the template to word."""
    joint = table.joint
    combined = [r for r in table.rows if r.group == "free"]  # what no scaling changes
    directions = summary.identifiability.directions
    return {
        "open": list(_groups([*joint, *combined], summary)),
        "meanings": {r.name: r.meaning for r in [*joint, *combined]},
        # remedies, each with how many of the directions it lifts, if any were looked for
        "steps": _steps(directions or []),
        "directions": len(directions or []),
        "command": _command(joint),
    }


def _groups(rows: Sequence[ParameterRow], summary: Summary) -> Iterator[OpenGroup]:
    """Give each open parameter to the first direction that holds it."""
    if lost := [r.name for r in rows if not r.cell.converged]:
        yield OpenGroup("lost", tuple(lost))
    left = [r.name for r in rows if r.by == "open" and r.cell.converged]
    for exponents, meaning, reasons in _directions(summary):
        members = [name for name in left if name in exponents or _alpha_of(name) in exponents]
        if members:
            left = [name for name in left if name not in members]
            others = [name for name in exponents if name not in members]
            # the names stand above the sentence that may begin with them
            these = f"together with {', '.join(others)} these " if others else "these "
            listed = f"{', '.join(exponents)} "
            said = re.sub(rf"\A{re.escape(listed)}", these, meaning)
            yield OpenGroup("direction", tuple(members), said, tuple(reasons))
    if left:
        yield OpenGroup("prior", tuple(left))


def _alpha_of(name: str) -> str:
    """Name the torque factor that a load loss sets: mu is open where alpha is."""
    element, _, quantity = name.partition(".")
    return f"{element}.alpha_{quantity.removeprefix('load_')}" if "load_" in quantity else name


def _directions(summary: Summary) -> Iterator[tuple[dict[str, float], str, list[str]]]:
    found = summary.identifiability
    for null in found.null_directions if found.directions is None else ():
        yield null.parameters, null.meaning, []
    for one in found.directions or ():
        yield one.exponents, one.meaning, one.reasons


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
