"""``bayesfric fit`` and ``demo``: sample the posterior and write the run directory."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

from bayesfric.base.errors import BadInput
from bayesfric.base.progress import Progress, Shown, silent
from bayesfric.base.written import check_free
from bayesfric.commands.unfinished import unfinished
from bayesfric.fit.model import Model
from bayesfric.problem.config import Config, read_config
from bayesfric.report.summary.record import Summary
from bayesfric.report.terminal import fit_text as fit_text


def fit(
    config: Config,
    folder: Path,
    *,
    seed: int | None = None,
    resume: bool = False,
    force: bool = False,
    output_error: bool = False,
    paper: bool = False,
    progress: Shown = silent,
    found: Callable[[Summary], None] = lambda _: None,
) -> dict[str, Any]:
    """Fit a configuration, write the run directory, and return what ``summary.json`` holds.

    ``found`` takes the numbers as soon as they are there, before figures and pages are made.
    ``resume`` goes on with an interrupted run; the result is that of one never interrupted.
    ``force`` keeps what stands there under another name, and starts afresh. Nothing is written of
    what cannot be used; where the disk is full or gone, and on Ctrl-C or SIGTERM, what was sampled
    is kept.
    """
    # who resumes has an old run kept, if --force came with the first command
    check_free(folder, force=force or resume)
    with unfinished(folder, resume=resume, force=force) as run:
        model = Model.from_config(config)
        result = model.fit(
            seed=seed,
            output_error=output_error,
            progress=progress,
            checkpoint=partial(run.sampling, model),
        )
        found(result.summary)
        progress(Progress("writing results"))
        try:
            summary = result.write(folder, paper=paper, progress=progress)
        except BadInput as error:
            mend = "mend that, then write them with --resume: nothing is sampled again"
            raise BadInput(error.where, error.what, mend) from None
        run.remove()
    return summary.as_dict()


def demo_config() -> Config:
    """Read the packaged configuration; its recording lies beside it in the package."""
    with as_file(files("bayesfric") / "examples") as folder:
        return read_config(folder / "knee.toml")
