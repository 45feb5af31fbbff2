"""``bayesfric report``: the page and the tables of a finished run, made again."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from bayesfric.commands.compare import read_summary_file
from bayesfric.errors import BadInput
from bayesfric.report.files import write_beside
from bayesfric.report.page.run_page import run_page
from bayesfric.report.summary_texts import summary_texts


def report(run: Path) -> dict[str, Any]:
    """Make ``report.html`` and what follows from ``summary.json`` again; nothing is sampled.

    Parameters
    ----------
    run
        A run directory.

    Returns
    -------
    dict
        ``run`` and the files written.

    Raises
    ------
    BadInput
        If the folder holds no finished run, or cannot be written to; then nothing is changed.
    """
    summary = read_summary_file(run)
    name = Path(os.path.realpath(run)).name
    try:
        texts = summary_texts(summary, name)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        # the tables of every number ask for more than a comparison does
        raise BadInput(
            str(run / "summary.json"),
            f"is not whole ({type(error).__name__}: {error})",
            "fit this run again",
        ) from None
    texts["report.html"] = run_page(run, summary, name)
    try:
        (run / "tables").mkdir(exist_ok=True)
    except OSError as error:
        raise BadInput(
            str(run), f"cannot be written ({error.strerror})", "copy the run to a folder of yours"
        ) from None
    write_beside({run / file: text for file, text in texts.items()}, replace=True)
    return {"run": str(run), "written": sorted(texts)}
