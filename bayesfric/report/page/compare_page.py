"""``report.html`` of a comparison: several runs side by side, and what they say together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from pathlib import Path

from bayesfric.report.alerts import alerts_of
from bayesfric.report.comparison.between_runs import PooledQuantity
from bayesfric.report.comparison.cell import posterior_cells
from bayesfric.report.comparison.comparison import Comparison, explained
from bayesfric.report.figures.forest import FOREST
from bayesfric.report.page.page_figures import page_figures
from bayesfric.report.page.provenance import Provenance
from bayesfric.report.page.rendering import render
from bayesfric.report.summary.record import Summary


def shared_recordings(provenance: Mapping[str, Provenance | None]) -> list[tuple[str, str]]:
    """Name the pairs of runs that saw the same seconds of a recording."""
    known = {run: told for run, told in provenance.items() if told}
    return [(a, b) for a, b in combinations(known, 2) if known[a].saw_of(known[b])]


def _counts(run: Summary) -> Iterator[int]:
    """Count parameters by the data, with the prior, open or limits; then the warnings of a run."""
    cells = posterior_cells(run)
    joint = [(cells[name].status == "determined", row.verdict) for name, row in run.joint.items()]
    by = [verdict if determined else "open" for determined, verdict in joint]
    yield from (by.count(kind) for kind in ("data", "weak", "open"))
    yield len(alerts_of(run))


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
        counts={name: tuple(_counts(run)) for name, run in runs.items()},
        pooled=pooled,
        same=shared_recordings(provenance),
        provenance=provenance,
        unknown=[run for run, one in provenance.items() if not (one and one.known)],
        methods=found,
        explained=list(explained(found)),
        figures=page_figures(folder, [FOREST], {}),
        version=next(iter(runs.values())).bayesfric,
    )
