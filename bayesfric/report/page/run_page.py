"""``report.html`` of a run, made from what its folder holds and nothing else."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bayesfric.errors import BadInput
from bayesfric.opened import read_text
from bayesfric.recordings.moving import too_slow
from bayesfric.report.alerts import alerts_of
from bayesfric.report.calculator import Calculator, read_calculator
from bayesfric.report.comparison.comparison import comparison, explained
from bayesfric.report.figures.registry import read_captions, run_figures
from bayesfric.report.figures.rollout import FIGURE as ROLL_OUT
from bayesfric.report.page.page_figures import page_figures
from bayesfric.report.page.provenance import read_provenance
from bayesfric.report.page.rendering import render
from bayesfric.report.paper.tables import ParameterRow, ParameterTable, parameter_table
from bayesfric.report.summary.record import OpenDirectionRow, Readable, RemedyRow, Summary
from bayesfric.report.terminal import brief


def run_page(folder: Path, summary: Readable, name: str) -> str:
    """Write the page of a run: HTML that fetches nothing.

    Figures, texts, ``page.json``, configuration and the head of ``posterior.nc`` are read from the
    run directory ``folder``; what is missing is left out. ``BadInput`` where the summary lacks
    something.
    """
    read = Summary.read(summary, name)
    table = parameter_table(read, name)
    methods = comparison({name: read})
    told = alerts_of(read, methods.contested)
    captions = read_captions(_text(folder / "text" / "captions.md"))
    return render(
        "run.html.j2",
        scripts=("page.js", "calculator.js"),
        title=name,
        summary=read,
        alerts=told,
        found=findings(table, read),
        too_slow=too_slow(),
        brief=brief(read, told),
        law=_law(read_calculator(folder), table),
        table=table,
        notes=table.notes(marked=False),
        methods=methods,
        explained=list(explained(methods)),
        figures=page_figures(folder, [*run_figures().values(), ROLL_OUT], captions),
        provenance=read_provenance(folder),
        config=_text(folder / "config.toml"),
    )


def _law(told: Calculator | None, table: ParameterTable) -> dict[str, Any] | None:
    """Give what the calculator is worded from, and what its script reads."""
    if told is None:
        return None
    doubted = "doubted" if table.summary.doubts else ""
    if table.summary.unexplained:
        doubted = "wrong"
    return {
        **told,
        "text": json.dumps(told, allow_nan=False),
        "draws": max((len(x) for x in told.get("values", ()) if isinstance(x, list)), default=1),
        "widened": table.summary.widened,
        "unsettled": any(row.by == "open" for row in table.joint),
        "doubted": doubted,
        "unusable": table.summary.sampler.status == "unusable",
    }


def _text(path: Path) -> str:
    """Read a text that a run may lack."""
    try:
        return read_text(path)
    except BadInput:
        return ""


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

    def unknown(row: ParameterRow) -> tuple[bool, float]:
        told = row.row
        return row.by == "open", told.told_sd / abs(told.mean) if told and told.mean else 0.0

    # a constant in the measurement is asked for last
    asked = [row for row in joint if row.name.partition(".")[0] != "offset"] or joint
    name = shlex.quote(max(asked, key=unknown).name)
    return f"bayesfric identify YOUR-CONFIGURATION.toml --advise {name}"
