"""``report.html`` of a comparison: several runs side by side, and what they say together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

from bayesfric.report.comparison.between_runs import PooledQuantity
from bayesfric.report.comparison.table import explained
from bayesfric.report.figures.registry import ComparedRuns, comparison_figures
from bayesfric.report.page.facts import Facts, read_facts
from bayesfric.report.page.figures import page_figures
from bayesfric.report.page.provenance import Provenance
from bayesfric.report.page.rendering import render
from bayesfric.report.page.values import ends_html
from bayesfric.report.summary.read_back import RunSummary


@dataclass(frozen=True)
class RunFacts:
    """One run of a comparison.

    ``verdicts`` counts the joint's parameters by ``data``, ``weak`` and ``prior``.
    """

    name: str
    facts: Facts
    verdicts: Mapping[str, int]
    provenance: Provenance | None


def shared_recordings(provenance: Mapping[str, Provenance | None]) -> list[tuple[str, str]]:
    """Name the pairs of runs that saw the same recording, by its SHA-256."""
    seen = {run: _hashes(told) for run, told in provenance.items()}
    return [(a, b) for a, b in combinations(seen, 2) if seen[a] & seen[b]]


def _hashes(told: Provenance | None) -> set[str]:
    return set(told.recordings.values()) - {""} if told else set()


def compare_page(
    folder: Path,
    compared: ComparedRuns,
    summaries: Mapping[str, Mapping[str, Any]],
    provenance: Mapping[str, Provenance | None],
) -> str:
    """Write the page of a comparison.

    Parameters
    ----------
    folder
        Where ``figures/`` is; figures that are missing are left out.
    compared
        The runs, as read and checked.
    summaries
        What each ``summary.json`` holds.
    provenance
        Of each run, where it is known.

    Returns
    -------
    str
        HTML that fetches nothing.
    """
    found, runs, pooled = compared.found, compared.runs, compared.pooled
    captions = {stem: one.caption_of(compared) for stem, one in comparison_figures().items()}
    listed = [
        RunFacts(name, read_facts(summaries[name], name), _verdicts(run), provenance.get(name))
        for name, run in runs.items()
    ]
    same = shared_recordings(provenance)
    return render(
        "compare.html.j2",
        title=" and ".join(runs) if len(runs) < 3 else f"{len(runs)} runs",
        runs=listed,
        headline=list(_headline(listed, pooled, same)),
        pooled=pooled,
        disagree=[one for one in pooled if not one.pool.agree],
        pool_ends={one.name: ends_html(one.pool.low, one.pool.high, one.pool.sd) for one in pooled},
        same=same,
        unknown=[run for run, told in provenance.items() if not _hashes(told)],
        level=next((f"{100 * row.level:g}" for one in pooled for row in one.runs.values()), ""),
        without_draws={run: one.missing for run, one in compared.draws.items() if one.missing},
        methods=found,
        explained=list(explained(found)),
        figures=page_figures(folder, comparison_figures().values(), captions, compared),
        version=listed[0].facts.bayesfric,
    )


def _verdicts(run: RunSummary) -> dict[str, int]:
    rows = [row for name, row in run.parameters.items() if not name.startswith("noise.")]
    return {key: sum(row.verdict == key for row in rows) for key in ("data", "weak", "prior")}


def _headline(
    runs: Sequence[RunFacts], pooled: Sequence[PooledQuantity], same: Sequence[tuple[str, str]]
) -> Iterator[str]:
    if len(runs) == 1:
        yield f"One run, {runs[0].name}: its methods and its posterior side by side."
        return
    yield f"{len(runs)} runs: {', '.join(run.name for run in runs)}."
    if same:
        yield (
            "Some of them saw the same recording: they are not independent, and nothing is pooled."
        )
    elif not pooled:
        yield "There is no quantity that the data of every run determine, so nothing is pooled."
    else:
        apart = sum(not one.pool.agree for one in pooled)
        what = "quantity" if len(pooled) == 1 else "quantities"
        yield f"The data of every run determine {len(pooled)} {what}."
        if not apart:
            yield "In all of them the runs agree within their intervals."
        elif apart == len(pooled):
            yield "In none of them do the runs agree within their intervals."
        else:
            yield (
                f"In {len(pooled) - apart} of them the runs agree within their intervals, in "
                f"{apart} they do not."
            )
