"""Progress of long work, on stderr, and the time it takes."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Progress:
    """Progress for a bar; of sampling, the worst parameter's diagnostics."""

    phase: str
    steps: int = 0
    ess: float = math.nan
    rhat: float = math.nan


ProgressCallback = Callable[[Progress], None]


class Timer:
    """Time since it was started: wall clock, and CPU time with that of child processes."""

    def __init__(self) -> None:
        self._start, self._cpu_start = time.perf_counter(), sum(os.times()[:4])

    @property
    def seconds(self) -> float:
        """Wall-clock time."""
        return time.perf_counter() - self._start

    @property
    def cpu_seconds(self) -> float:
        """CPU time of all processors."""
        return sum(os.times()[:4]) - self._cpu_start


def time_text(timed: Any) -> str:
    """Write wall-clock and CPU time, of a timer or a result."""
    return f"{timed.seconds:.1f} s by the clock, {timed.cpu_seconds:.1f} s of CPU time"


def no_progress(_: Progress) -> None:
    """Ignore progress."""


def by_method(progress: ProgressCallback) -> Callable[[str], None]:
    """Report by the name of a method of estimation that it begins."""
    return lambda method: progress(Progress(f"{method} estimate"))


@contextmanager
def progress_shown(wanted: bool | ProgressCallback) -> Iterator[ProgressCallback]:
    """Give a callback for progress: a bar, a function of the caller's, or none."""
    if callable(wanted) or not wanted:
        yield wanted or no_progress
        return
    from numba.core import event
    from rich.console import Console
    from rich.progress import Progress as Bar
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    console = Console(stderr=True)

    class Compilation(event.Listener):
        """Say once that kernels are compiled, which a cache keeps for later runs."""

        announced = False

        def on_start(self, _: Any) -> None:
            if not self.announced:
                console.print("compiling, first run only")
            self.announced = True

        def on_end(self, _: Any) -> None:
            pass

    bar = Bar(*columns, console=console, transient=True)
    with event.install_listener("numba:compile", Compilation()), bar:
        task = bar.add_task("reading")

        def show(progress: Progress) -> None:
            text = progress.phase
            if progress.steps:
                text += f", {progress.steps} steps"
            if progress.ess == progress.ess:  # not nan
                text += f", {progress.ess:.0f} independent draws, R-hat {progress.rhat:.3f}"
            bar.update(task, description=text)

        yield show
