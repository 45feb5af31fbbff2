"""Write a run directory: in a temporary folder, moved into place when complete."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

from bayesfric.base.atomic_write import new_folder
from bayesfric.base.progress import Progress, ProgressCallback, no_progress
from bayesfric.inference.fitting import Fit
from bayesfric.recordings.measurement import Measurement
from bayesfric.report.figures.registry import RUN_FIGURES as FIGURES
from bayesfric.report.figures.style import ALL_KINDS, ON_PAGE, save
from bayesfric.report.page.pages import run_page
from bayesfric.report.paper.tables import text_files
from bayesfric.report.posterior_file import posterior_bytes
from bayesfric.report.summary.record import Readable, Summary


def write_run(
    folder: Path,
    fit: Fit,
    summary: Readable,
    config_text: str,
    recordings: list[Measurement],
    saved: Path | None = None,
    draws: int | None = None,
    *,
    paper: bool = False,
    progress: ProgressCallback = no_progress,
) -> None:
    """Write a run directory.

    The contents of the folder ``saved`` are copied into it. With a number of ``draws`` it is a
    light one: so many are kept, and neither figures, tables nor page are made. ``paper`` adds
    tables in LaTeX, references, and figures as PDF and PNG.
    """
    summary = Summary.read(summary)
    with new_folder(folder) as partial:
        if saved is not None:
            shutil.copytree(saved, partial, dirs_exist_ok=True)
        (partial / "config.toml").write_text(config_text, encoding="utf-8")
        indent = 1 if draws is None else None
        (partial / "summary.json").write_text(
            json.dumps(summary.as_dict(), indent=indent, ensure_ascii=False, allow_nan=False)
            + "\n",
            encoding="utf-8",
        )
        progress(Progress("draws"))
        content = posterior_bytes(fit, summary, config_text, recordings, draws)
        (partial / "posterior.nc").write_bytes(content)
        if draws is not None:
            return
        kinds = ALL_KINDS if paper else ON_PAGE
        draw(partial / "figures", fit, summary, kinds, progress)
        for name, text in text_files(summary, folder.name, paper=paper).items():
            (partial / name).parent.mkdir(exist_ok=True)
            (partial / name).write_text(text, encoding="utf-8")
        progress(Progress("page"))
        # last: it is made from these files
        page = run_page(partial, summary, folder.name)
        (partial / "report.html").write_text(page, encoding="utf-8")


def draw(
    folder: Path, fit: Fit, summary: Summary, kinds: Sequence[str], progress: ProgressCallback
) -> None:
    """Draw a run's figures into ``folder``, those that show anything."""
    folder.mkdir(exist_ok=True)
    for stem, declared in FIGURES.items():
        progress(Progress(f"figure {stem}"))
        if (figure := declared.draw(fit, summary)) is not None:
            save(figure, folder, stem, kinds)
