"""What a run found: what is known, what is open and why, and what to do next; as data.

The template ``findings.html.j2`` words it.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from bayesfric.report.alerts import first_step
from bayesfric.report.paper.tables import ParameterRow, ParameterTable
from bayesfric.report.summary.record import OpenDirectionRow, RemedyRow, Summary

# Lines of the list of what is known; the rest is in the table.
_MOST = 8


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
    """Gather what the first screen of a run's page says, for the template to word."""
    joint = table.joint
    combined = [r for r in table.rows if r.group == "free"]  # what no scaling changes
    known = [r for r in [*combined, *joint] if r.cell.status == "determined"]
    if any(r.by == "open" for r in joint):
        # what data alone determine says more than what they share with the prior
        known.sort(key=lambda r: r.by != "data")
    else:  # then the joint's own parameters are what is asked for
        known.sort(key=lambda r: r.group != "parameter")
    white, directions = summary.noise.innovation_whiteness, summary.identifiability.directions
    correlated = not summary.accounts and white is not None and not white.white
    return {
        "joint": joint,
        "combined": combined,
        "lost": [r.name for r in joint if not r.cell.converged],
        "known": known[:_MOST],
        "more": max(0, len(known) - _MOST),
        "limits": [r for r in [*joint, *combined] if r.by == "limit"],
        "open": list(_groups([*joint, *combined], summary)),
        "meanings": {r.name: r.meaning for r in [*joint, *combined]},
        # what would put in what else explains the torque
        "lacks": summary.lacks,
        # what comes before anything else, where something but the drive seems to have acted
        "first": first_step(summary),
        # whether another mechanism comes before anything else, and what the recordings ask for
        "wrong": summary.mechanism_doubted,
        "unexplained": summary.unexplained,
        "units": summary.other_units,
        # where the order was chosen, auto itself found that no memory helps
        "try_auto": correlated and not summary.noise.order_chosen_from,
        # remedies, each with how many of the directions it lifts, if any were looked for
        "steps": _steps(directions or []),
        "directions": None if directions is None else len(directions),
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
