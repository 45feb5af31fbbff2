"""``report.html`` of a comparison: several runs side by side, and what they say together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path

from bayesfric.report.comparison.between_runs import PooledQuantity
from bayesfric.report.comparison.comparison import Comparison
from bayesfric.report.comparison.table import explained
from bayesfric.report.figures.overlay import Overlay
from bayesfric.report.page.figure_words import forest_figure_words, overlay_words
from bayesfric.report.page.figures import read_figures
from bayesfric.report.page.provenance import Provenance
from bayesfric.report.page.rendering import render
from bayesfric.report.summary.record import Summary


def shared_recordings(provenance: Mapping[str, Provenance | None]) -> list[tuple[str, str]]:
    """Name the pairs of runs that saw the same recording, by its SHA-256."""
    seen = {run: _hashes(told) for run, told in provenance.items()}
    return [(a, b) for a, b in combinations(seen, 2) if seen[a] & seen[b]]


def _hashes(told: Provenance | None) -> set[str]:
    return set(told.recordings.values()) - {""} if told else set()


def compare_page(
    folder: Path,
    found: Comparison,
    runs: Mapping[str, Summary],
    pooled: Sequence[PooledQuantity],
    provenance: Mapping[str, Provenance | None],
    overlaid: Overlay | None = None,
) -> str:
    """Write the page of a comparison.

    Parameters
    ----------
    folder
        Where ``figures/`` is; figures that are missing are left out.
    found
        The comparison.
    runs
        What each ``summary.json`` holds.
    pooled
        From :func:`bayesfric.report.comparison.between_runs.between_runs`.
    provenance
        Of each run, where it is known.
    overlaid
        From :func:`bayesfric.report.figures.overlay.overlay`, of several runs.

    Returns
    -------
    str
        HTML that fetches nothing.
    """
    words = {"forest": forest_figure_words(found)}
    if overlaid is not None and overlaid.panels:
        words["overlay"] = overlay_words(overlaid)
    return render(
        "compare.html.j2",
        title=" and ".join(runs) if len(runs) < 3 else f"{len(runs)} runs",
        runs=runs,
        pooled=pooled,
        same=shared_recordings(provenance),
        provenance=provenance,
        unknown=[run for run, told in provenance.items() if not _hashes(told)],
        without_draws=overlaid.left_out if overlaid is not None else {},
        methods=found,
        explained=list(explained(found)),
        figures=read_figures(folder / "figures", words),
        version=next(iter(runs.values())).bayesfric,
    )
