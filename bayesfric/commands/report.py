"""``bayesfric report``: the page and the tables of a finished run, made again."""

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
    """Make ``report.html`` and what follows from ``summary.json`` again; nothing is sampled.

    ``paper`` has the figures drawn again, as PDF and PNG, for which the recordings are read, and
    writes LaTeX tables and references. Nothing is changed where the folder holds no
    finished run, or cannot be written to.
    """
    summary = read_summary_file(run)
    name = Path(os.path.realpath(run)).name
    # first, for it looks at every key
    page = run_page(run, summary, name)
    texts = summary_texts(summary, name) | {"report.html": page}
    drawn: list[str] = []
    if any(run.glob("tables/*.tex")):
        texts |= latex_texts(summary, name)
    try:
        if paper:
            drawn = _for_paper(run, name, texts, progress)
        write_files({run / file: text for file, text in texts.items()}, replace=True)
    except OSError as error:
        raise BadInput(
            str(run), f"cannot be written ({error.strerror})", "copy the run to a folder of yours"
        ) from None
    return {"run": str(run), "written": sorted([*texts, *drawn])}


def _for_paper(
    run: Path, name: str, texts: dict[str, str], progress: ProgressCallback
) -> list[str]:
    """Add texts to write, and draw; give the files drawn."""
    from bayesfric.fit.finished_run import fit_of
    from bayesfric.report.figures.registry import FinishedRun
    from bayesfric.report.figures.style import IN_PAPER
    from bayesfric.report.run_directory import draw

    progress(Progress("recordings"))
    fit, summary = fit_of(run)
    texts |= latex_texts(summary, name)
    with add_files(run / "figures") as beside:
        draw(beside, FinishedRun(fit, summary), IN_PAPER, progress)
        files = sorted(beside.iterdir())
    return [f"figures/{file.name}" for file in files]
