"""``bayesfric report``: rebuild the page and the tables of a finished run."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from bayesfric.base.atomic_write import add_files, write_files
from bayesfric.base.errors import BadInput
from bayesfric.base.progress import Progress, ProgressCallback, no_progress
from bayesfric.report.page.pages import run_page
from bayesfric.report.paper.tables import latex_texts, summary_texts
from bayesfric.report.summary.record import read_summary_file


def report(
    run: Path, *, paper: bool = False, progress: ProgressCallback = no_progress
) -> dict[str, Any]:
    """Rebuild ``report.html`` and tables from ``summary.json``.

    ``paper`` also draws figures as PDF and PNG, for which the recordings are read, and writes LaTeX
    tables and references.
    """
    summary = read_summary_file(run)
    name = Path(os.path.realpath(run)).name
    # first, as it validates every key
    page = run_page(run, summary, name)
    texts = summary_texts(summary, name) | {"report.html": page}
    figures: list[str] = []
    if any(run.glob("tables/*.tex")):
        texts |= latex_texts(summary, name)
    try:
        if paper:
            figures = _for_paper(run, name, texts, progress)
        write_files({run / file: text for file, text in texts.items()}, replace=True)
    except OSError as error:
        raise BadInput(
            str(run), f"cannot be written ({error.strerror})", "copy the run to a writable folder"
        ) from None
    return {"run": str(run), "written": sorted([*texts, *figures])}


def _for_paper(
    run: Path, name: str, texts: dict[str, str], progress: ProgressCallback
) -> list[str]:
    """Add LaTeX texts, and draw figures; return their files."""
    from bayesfric.fit.model import Result
    from bayesfric.report.figures.registry import FinishedRun
    from bayesfric.report.figures.style import IN_PAPER
    from bayesfric.report.run_directory import draw

    progress(Progress("recordings"))
    result = Result.read(run)
    fit, summary = result.fit, result.summary
    texts |= latex_texts(summary, name)
    with add_files(run / "figures") as folder:
        draw(folder, FinishedRun(fit, summary), IN_PAPER, progress)
        files = sorted(folder.iterdir())
    return [f"figures/{file.name}" for file in files]
