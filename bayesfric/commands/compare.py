"""``bayesfric compare``: methods and runs side by side."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bayesfric.base.errors import BadInput
from bayesfric.report.comparison.comparison import (
    Comparison,
    comparison,
    comparison_csv,
    comparison_dict,
)
from bayesfric.report.summary.record import Summary, read_summary_file


def compare(
    runs: Sequence[Path], output: Path | None = None, *, estimates: bool | None = None
) -> Comparison:
    """Compare finished runs, or the methods of a single one.

    ``output`` is a folder to make: ``report.html``, ``comparison.csv``, ``.tex`` and
    ``.json``, ``figures/forest.pdf``, ``.svg`` and ``.png``; of several runs ``between-runs.csv``.
    By default point estimates are shown for a single run only.
    """
    summaries = read_summaries(runs)
    if output is None:
        return comparison(summaries, estimates=estimates)

    # slow imports that the table does not need
    from bayesfric.base.atomic_write import check_output_folder, new_folder
    from bayesfric.report.comparison.between_runs import between_runs, between_runs_csv, read_draws
    from bayesfric.report.figures.registry import FOREST
    from bayesfric.report.figures.style import save
    from bayesfric.report.page.pages import compare_page, read_provenance, shared_recordings
    from bayesfric.report.paper.tables import methods_latex

    check_output_folder(output, force=None)
    table = comparison(summaries, estimates=estimates)
    checked = {name: Summary.read(summary, name) for name, summary in summaries.items()}
    provenance = {name: read_provenance(run) for name, run in zip(summaries, runs, strict=True)}
    draws = {
        name: read_draws(run, checked[name])
        for name, run in zip(summaries, runs, strict=True)
        if len(runs) > 1
    }
    # a recording in two runs would count twice
    pooled = [] if shared_recordings(provenance) else between_runs(checked, draws)
    order = {row.name: k for k, row in enumerate(table.rows)}
    pooled.sort(key=lambda pool: order[pool.name])
    # before anything is written, as it may be refused
    figure = FOREST.draw(table)
    assert figure is not None
    with new_folder(output) as folder:
        as_json = json.dumps(comparison_dict(table), indent=1, ensure_ascii=False, allow_nan=False)
        texts = {
            "comparison.csv": comparison_csv(table),
            "comparison.json": f"{as_json}\n",
            "comparison.tex": methods_latex(table),
        }
        if len(checked) > 1:
            texts["between-runs.csv"] = between_runs_csv(pooled)
        (folder / "figures").mkdir()
        save(figure, folder / "figures", FOREST.stem)
        texts["report.html"] = compare_page(folder, table, checked, pooled, provenance)
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
    return table


def read_summaries(runs: Sequence[Path]) -> dict[str, Mapping[str, Any]]:
    """Read ``summary.json`` of every run, named by the distinct part of its folder."""
    folders: list[Path] = []
    for run in runs:
        folder = Path(os.path.realpath(run))
        if folder in folders:
            raise BadInput(str(run), "is given twice", "name each run once")
        folders.append(folder)
    return dict(zip(_names(folders), map(read_summary_file, runs), strict=True))


def _names(folders: Sequence[Path]) -> list[str]:
    deepest = max((len(folder.parts) for folder in folders), default=1)
    for parts in range(1, deepest):
        names = ["/".join(folder.parts[-parts:]) for folder in folders]
        if len(set(names)) == len(names):
            return names
    return [str(folder) for folder in folders]
