"""``bayesfric report``: the page and the tables of a finished run, made again."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from bayesfric.errors import BadInput
from bayesfric.report.files import write_beside
from bayesfric.report.page.run_page import run_page
from bayesfric.report.paper.tables import summary_texts
from bayesfric.report.summary.record import read_summary_file


def report(run: Path) -> dict[str, Any]:
    """Make ``report.html`` and what follows from ``summary.json`` again; nothing is sampled.

    Nothing is changed where the folder holds no finished run, or cannot be written to.
    """
    summary = read_summary_file(run)
    name = Path(os.path.realpath(run)).name
    # first, for it looks at every key
    page = run_page(run, summary, name)
    texts = summary_texts(summary, name) | {"report.html": page}
    tables = run / "tables"
    made = not tables.exists()
    try:
        tables.mkdir(exist_ok=True)
        write_beside({run / file: text for file, text in texts.items()}, replace=True)
    except OSError as error:
        raise BadInput(
            str(run), f"cannot be written ({error.strerror})", "copy the run to a folder of yours"
        ) from None
    finally:
        if made:
            with suppress(OSError):  # it is filled, as it should be
                tables.rmdir()
    return {"run": str(run), "written": sorted(texts)}
