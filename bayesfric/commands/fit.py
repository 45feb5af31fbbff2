"""``bayesfric fit`` and ``demo``: sample the posterior and write the run directory."""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

from bayesfric.base.atomic_write import check_output_folder, run_lock
from bayesfric.base.progress import Progress, ProgressCallback, no_progress
from bayesfric.fit.model import Model
from bayesfric.problem.config import Config, read_config
from bayesfric.report.summary.record import Summary
from bayesfric.report.terminal import fit_text as fit_text


def fit(
    config: Config,
    folder: Path,
    *,
    seed: int | None = None,
    force: bool = False,
    output_error: bool = False,
    paper: bool = False,
    progress: ProgressCallback = no_progress,
    on_summary: Callable[[Summary], None] = lambda _: None,
) -> dict[str, Any]:
    """Fit a configuration, write the run directory, and return what ``summary.json`` holds.

    ``on_summary`` is called before figures and pages are made; ``force`` replaces an old run. A fit
    that ends early writes nothing.
    """
    check_output_folder(folder, force=force)
    with run_lock(folder):
        model = Model.from_config(config)
        result = model.fit(seed=seed, output_error=output_error, progress=progress)
        on_summary(result.summary)
        progress(Progress("writing results"))
        summary = result.write(folder, paper=paper, progress=progress)
    return summary.as_dict()


def demo_config() -> Config:
    """Read the packaged configuration."""
    with as_file(files("bayesfric") / "examples") as folder:
        return read_config(folder / "knee.toml")
