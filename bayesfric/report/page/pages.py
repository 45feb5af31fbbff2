"""``report.html`` of a run, or of several side by side, from what folders hold and nothing else."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

from pydantic import Field

from bayesfric.base.errors import BadInput
from bayesfric.base.safe_read import open_hdf5, parse_json, read_text
from bayesfric.recordings.moving import too_slow
from bayesfric.report.alerts import alerts_of
from bayesfric.report.comparison.between_runs import PooledQuantity
from bayesfric.report.comparison.comparison import Comparison, comparison, explained
from bayesfric.report.figures.forest import FOREST
from bayesfric.report.figures.registry import read_captions, run_figures
from bayesfric.report.figures.rollout import FIGURE as ROLL_OUT
from bayesfric.report.numbers import HTML
from bayesfric.report.page.rendering import page_figures, render
from bayesfric.report.paper.tables import ParameterRow, ParameterTable, parameter_table
from bayesfric.report.summary.friction_part import friction_cells
from bayesfric.report.summary.record import Readable, RemedyRow, Summary
from bayesfric.report.summary.rows import Pair, Part
from bayesfric.report.terminal import brief


def run_page(folder: Path, summary: Readable, name: str) -> str:
    """Write the page of a run: HTML that fetches nothing.

    Figures, texts, configuration and the head of ``posterior.nc`` are read from the run directory
    ``folder``; what is missing is left out. ``BadInput`` where the summary lacks something.
    """
    read = Summary.read(summary, name)
    table = parameter_table(read, name)
    methods = comparison({name: read})
    told = alerts_of(read, methods.contested)
    captions = read_captions(_text(folder / "text" / "captions.md"))
    return render(
        "run.html.j2",
        title=name,
        summary=read,
        alerts=told,
        found=findings(table, read),
        too_slow=too_slow(),
        brief=brief(read, told),
        table=table,
        notes=table.notes(marked=False),
        methods=methods,
        friction=list(friction_cells(read.friction, HTML)),
        explained=list(explained(methods)),
        figures=page_figures(folder, [*run_figures().values(), ROLL_OUT], captions),
        provenance=read_provenance(folder),
        config=_text(folder / "config.toml"),
    )


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
    steps: dict[str, RemedyRow] = {}
    for one in found.directions:
        for remedy in one.remedies:
            steps.setdefault(remedy.text, remedy)
    return {
        "lost": [r.name for r in rows if not r.cell.converged],
        "open": {r.name: r.meaning for r in rows if r.by == "open" and r.cell.converged},
        "why": [(one.meaning, one.reasons) for one in found.directions],
        # each remedy once, an experiment before a value from elsewhere, which has to be believed
        "steps": sorted(steps.values(), key=lambda remedy: remedy.kind == "known value"),
        "command": _command(joint),
    }


def _command(joint: Sequence[ParameterRow]) -> str:
    """Ask for advice on what is open."""
    open_ = [row.name for row in joint if row.by == "open" and row.cell.converged]
    name = shlex.quote(open_[0]) if open_ else ""
    return f"bayesfric identify YOUR-CONFIGURATION.toml --advise {name}" if name else ""


class Provenance(Part):
    """What is needed to repeat a run."""

    # of Python and the libraries, by name
    versions: dict[str, str] = Field(default_factory=dict)
    # SHA-256 of every recording, by its name
    recordings: dict[str, str] = Field(default_factory=dict)
    seed: str = ""  # as text; empty where it is not known
    # first and last second that was fitted of a recording, by its name; not of those held out
    spans: dict[str, Pair] = Field(default_factory=dict)

    def saw_of(self, other: Provenance) -> bool:
        """Whether both fitted a part of one recording, by SHA-256 and seconds."""
        whole = [-float("inf"), float("inf")]
        return any(
            own == theirs != "" and max(a[0], b[0]) <= min(a[1], b[1])
            for mine, own in self.recordings.items()
            for name, theirs in other.recordings.items()
            for a, b in [(self.spans.get(mine, whole), other.spans.get(name, whole))]
        )


def read_provenance(run: Path) -> Provenance | None:
    """Read the root attributes of a run's ``posterior.nc``, and no draws; ``None`` without them."""
    try:
        with open_hdf5(run / "posterior.nc") as file:
            tables = ("versions", "recordings", "spans")
            attributes = {key: parse_json(key, file.attrs[key]) for key in tables}
            return Provenance(**attributes, seed=str(file.attrs["seed"]))
    except (BadInput, ValueError, TypeError):
        return None


def shared_recordings(provenance: Mapping[str, Provenance | None]) -> list[tuple[str, str]]:
    """Name the pairs of runs that saw the same seconds of a recording."""
    known = {run: told for run, told in provenance.items() if told}
    return [(a, b) for a, b in combinations(known, 2) if known[a].saw_of(known[b])]


def compare_page(
    folder: Path,
    found: Comparison,
    runs: Mapping[str, Summary],
    pooled: Sequence[PooledQuantity],
    provenance: Mapping[str, Provenance | None],
) -> str:
    """Write the page of a comparison; a figure that ``folder`` lacks is left out."""
    return render(
        "compare.html.j2",
        title=" and ".join(runs) if len(runs) < 3 else f"{len(runs)} runs",
        runs=runs,
        pooled=pooled,
        same=shared_recordings(provenance),
        provenance=provenance,
        methods=found,
        explained=list(explained(found)),
        figures=page_figures(folder, [FOREST], {}),
        version=next(iter(runs.values())).bayesfric,
    )
