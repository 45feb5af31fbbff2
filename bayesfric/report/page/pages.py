"""``report.html`` of a run or of several, from their folders alone."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

from bayesfric.base.errors import BadInput
from bayesfric.base.safe_read import open_hdf5, parse_json, read_text
from bayesfric.recordings.checks import too_slow
from bayesfric.report.comparison.between_runs import SharedQuantity
from bayesfric.report.comparison.comparison import Comparison, comparison, explained
from bayesfric.report.figures.registry import FOREST, ROLL_OUT, RUN_FIGURES, read_captions
from bayesfric.report.numbers import HTML
from bayesfric.report.page.rendering import page_figures, render
from bayesfric.report.paper.tables import parameter_notes, parameter_table
from bayesfric.report.summary.parts import friction_cells
from bayesfric.report.summary.record import Readable, Summary, of_noise
from bayesfric.report.terminal import brief, messages_of


def run_page(folder: Path, summary: Readable, name: str) -> str:
    """Write the page of a run: HTML that fetches nothing.

    Figures, texts, configuration and the head of ``posterior.nc`` are read from the run directory
    ``folder``; what is missing is left out.
    """
    read = Summary.read(summary, name)
    table = parameter_table(read, name)
    methods = comparison({name: read})
    messages = messages_of(read, methods.contested)
    captions = read_captions(_text(folder / "text" / "captions.md"))
    return render(
        "run.html.j2",
        title=name,
        summary=read,
        messages=messages,
        too_slow=too_slow(),
        brief=brief(read, messages),
        table=table,
        joint=[row for row in table["parameter"] if not of_noise(row.name)],
        notes=parameter_notes(table, read, marked=False),
        methods=methods,
        friction=list(friction_cells(read.friction, HTML)),
        explained=list(explained(methods)),
        figures=page_figures(folder, [*RUN_FIGURES.values(), ROLL_OUT], captions),
        provenance=read_provenance(folder),
        config=_text(folder / "config.toml"),
    )


def _text(path: Path) -> str:
    """Read a text that a run may lack."""
    try:
        return read_text(path)
    except BadInput:
        return ""


# What is needed to repeat a run: `versions` of Python and the libraries, SHA-256 of `recordings`
# and the seconds that were fitted of each (`spans`) by name, and the `seed` as text.
Provenance = dict[str, Any]


def read_provenance(run: Path) -> Provenance | None:
    """Read the root attributes of a run's ``posterior.nc``, and no draws; ``None`` without them."""
    try:
        with open_hdf5(run / "posterior.nc") as file:
            tables = ("versions", "recordings", "spans")
            attributes = {key: dict(parse_json(key, file.attrs[key])) for key in tables}
            return {**attributes, "seed": str(file.attrs["seed"])}
    except (BadInput, ValueError, TypeError):
        return None


def shared_recordings(provenance: Mapping[str, Provenance | None]) -> list[tuple[str, str]]:
    """Name the pairs of runs that fitted the same seconds of a recording, by SHA-256."""
    parts = [
        (run, sha256, *of["spans"].get(name, [-math.inf, math.inf]))
        for run, of in provenance.items()
        if of
        for name, sha256 in of["recordings"].items()
        if sha256
    ]
    pairs = {
        (run, other): None
        for (run, sha256, start, stop), (other, theirs, first, last) in combinations(parts, 2)
        if run != other and sha256 == theirs and max(start, first) <= min(stop, last)
    }
    return [*pairs]


def compare_page(
    folder: Path,
    compared: Comparison,
    runs: Mapping[str, Summary],
    pooled: Sequence[SharedQuantity],
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
        methods=compared,
        explained=list(explained(compared)),
        figures=page_figures(folder, [FOREST], {}),
        version=next(iter(runs.values())).bayesfric,
    )
