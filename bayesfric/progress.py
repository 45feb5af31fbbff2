"""How far long work has come, shown on stderr."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bayesfric.inference.sampling.sampling import Progress


@contextmanager
def progress_shown(
    wanted: bool | Callable[[Progress], None],
) -> Iterator[Callable[[Progress], None]]:
    """Give what to call as work goes on: a bar where it is wanted, or what was given."""
    if callable(wanted) or not wanted:
        yield wanted or (lambda _: None)
        return
    from rich.console import Console
    from rich.progress import Progress as Bar
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("reading")

        def show(progress: Progress) -> None:
            text = progress.phase
            if progress.steps:
                text += f", {progress.steps} steps"
            if progress.ess == progress.ess:  # not nan
                text += f", {progress.ess:.0f} independent draws, R-hat {progress.rhat:.3f}"
            bar.update(task, description=text)

        yield show
