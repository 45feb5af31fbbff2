"""``bayesfric report``, ``rollout`` and ``compare``: what is made of finished runs.

Figures and pages are imported when they are drawn, as a table on a terminal needs none.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from bayesfric.base.atomic_write import (
    add_files,
    check_output_folder,
    jsonable,
    new_folder,
    write_files,
)
from bayesfric.base.errors import BadInput
from bayesfric.base.progress import Progress, ProgressCallback, no_progress
from bayesfric.report.comparison.comparison import Comparison, comparison, comparison_dict
from bayesfric.report.summary.record import Summary, read_summary_file
from bayesfric.report.words import csv_text, filled, line_of


def report(
    run: Path, *, paper: bool = False, progress: ProgressCallback = no_progress
) -> dict[str, Any]:
    """Rebuild ``report.html`` and tables from ``summary.json``.

    ``paper`` also draws figures as PDF and PNG, for which the recordings are read, and writes LaTeX
    tables and references.
    """
    from bayesfric.report.page.pages import run_page
    from bayesfric.report.paper.tables import text_files

    summary = read_summary_file(run)
    name = Path(os.path.realpath(run)).name
    # first, as it validates every key
    page = run_page(run, summary, name)
    figures: list[str] = []
    with _written_into(run):
        if paper:
            figures, summary = _paper_figures(run, progress)
        latex = paper or any(run.glob("tables/*.tex"))
        texts = text_files(summary, name, paper=latex) | {"report.html": page}
        write_files({run / file: text for file, text in texts.items()}, replace=True)
    return {"run": str(run), "written": sorted([*texts, *figures])}


def _paper_figures(run: Path, progress: ProgressCallback) -> tuple[list[str], Any]:
    """Draw a run's figures again; return their files, and its summary."""
    from bayesfric.fit.model import Result
    from bayesfric.report.figures.style import IN_PAPER
    from bayesfric.report.run_directory import draw

    progress(Progress("recordings"))
    result = Result.read(run)
    with add_files(run / "figures") as folder:
        draw(folder, result.fit, result.summary, IN_PAPER, progress)
        return [f"figures/{file.name}" for file in sorted(folder.iterdir())], result.summary


def rollout(
    run: Path,
    config: Path | None = None,
    *,
    draws: int,
    seed: int | None = None,
    every: bool = False,
    progress: ProgressCallback,
) -> dict[str, Any]:
    """Simulate recordings' inputs with a run's posterior, and add the result to the run.

    Arguments as of :func:`bayesfric.rollout`. ``summary.json``, the page and ``figures/rollout``
    are written.
    """
    from bayesfric.report.figures.prediction import rollout_figure
    from bayesfric.report.figures.style import save
    from bayesfric.rollouts.rollout import rollout as simulated

    # keys that another version wrote are kept
    summary: dict[str, Any] = read_summary_file(run)
    # the folder first: what cannot be written is not simulated
    with _written_into(run), add_files(run / "figures") as figures:
        result = simulated(run, config, every=every, draws=draws, seed=seed, progress=progress)
        save(rollout_figure(result), figures, "rollout")
    record = {**summary, "rollout": jsonable(result.summary)}
    write_files({run / "summary.json": _json(record)}, replace=True)
    report(run)
    return result.summary


def rollout_text(rolled: dict[str, Any]) -> Iterator[str]:
    """Word it for a terminal, line by line."""
    from bayesfric.report.terminal import roll_out_messages

    yield from filled("rollout.txt.j2", found=rolled).splitlines()
    for kind, values in roll_out_messages(rolled).items():
        yield f"WARNING: {line_of(kind, values)}"


def compare(
    runs: Sequence[Path], output: Path | None = None, *, estimates: bool | None = None
) -> Comparison:
    """Compare finished runs, or the methods of a single one.

    ``output`` is a folder to make: ``report.html``, ``comparison.csv``, ``.tex`` and
    ``.json``, ``figures/forest.pdf``, ``.svg`` and ``.png``; of several runs ``between-runs.csv``.
    By default point estimates are shown for a single run only.
    """
    folders = [Path(os.path.realpath(run)) for run in runs]
    for k, folder in enumerate(folders):
        if folder in folders[:k]:
            raise BadInput(str(runs[k]), "is given twice", "name each run once")
    names = _distinct_names(folders)
    summaries = dict(zip(names, map(read_summary_file, runs), strict=True))
    if output is None:
        return comparison(summaries, estimates=estimates)
    check_output_folder(output, force=None)
    table = comparison(summaries, estimates=estimates)
    _write_comparison(table, output, dict(zip(names, runs, strict=True)), summaries)
    return table


def _write_comparison(
    table: Comparison,
    output: Path,
    runs: Mapping[str, Path],
    summaries: Mapping[str, Mapping[str, Any]],
) -> None:
    """Write the folder of a comparison."""
    from bayesfric.report.comparison.between_runs import between_runs
    from bayesfric.report.figures.registry import FOREST
    from bayesfric.report.figures.style import save
    from bayesfric.report.page.pages import compare_page, read_provenance, shared_recordings
    from bayesfric.report.paper.tables import comparison_csv, methods_latex

    checked = {name: Summary.read(summary, name) for name, summary in summaries.items()}
    provenance = {name: read_provenance(run) for name, run in runs.items()}
    # a recording in two runs would count twice
    same = shared_recordings(provenance)
    pooled = [] if len(runs) < 2 or same else between_runs(checked)
    order = {row.name: k for k, row in enumerate(table.rows)}
    pooled.sort(key=lambda line: order[line["name"]])
    # before anything is written, as it may be refused
    figure = FOREST.draw(table)
    assert figure is not None
    texts = {
        "comparison.csv": comparison_csv(table),
        "comparison.json": _json(comparison_dict(table)),
        "comparison.tex": methods_latex(table),
    }
    if len(runs) > 1:
        texts["between-runs.csv"] = csv_text(pooled, [*pooled[0]] if pooled else ["name"])
    with new_folder(output) as folder:
        (folder / "figures").mkdir()
        save(figure, folder / "figures", FOREST.stem)
        texts["report.html"] = compare_page(folder, table, checked, pooled, provenance)
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")


def _distinct_names(folders: Sequence[Path]) -> list[str]:
    """Name runs by as much of their paths' ends as makes them distinct."""
    parts = 1
    while True:
        names = ["/".join(folder.parts[-parts:]) for folder in folders]
        if len(set(names)) == len(names):
            return names
        parts += 1


@contextmanager
def _written_into(run: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise BadInput(
            str(run), f"cannot be written ({error.strerror})", "copy the run to a writable folder"
        ) from None


def _json(record: Mapping[str, Any]) -> str:
    return json.dumps(record, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
