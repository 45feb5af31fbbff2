"""The files of a run's figures, saved by two processes at once."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from matplotlib.figure import Figure

from bayesfric.report.figures.style import save

_DONE = b"done\n"
# -P: a file of the user's folder must not stand in for a library's.
_HELPER = ["-P", "-c", "from bayesfric.report.figures.files import help_saving; help_saving()"]


@contextmanager
def two_at_once(folder: Path) -> Iterator[Callable[[Figure, str], None]]:
    """Give a function like :func:`bayesfric.report.figures.style.save` that shares its work.

    Setting text and embedding fonts three times a figure takes longer than all drawing, so
    whenever a second process is free the figure is handed to it through a pipe. What it
    cannot do, for whatever reason, is done here, where an error is told. The bytes are the
    same wherever a figure is saved. ``folder`` holds all files when the block ends well.
    """
    helper = _helper()
    waiting = ThreadPoolExecutor(1)
    handed: list[tuple[Figure, str, Future[bool]]] = []

    def share(figure: Figure, stem: str) -> None:
        if helper is not None and all(written.done() for *_, written in handed):
            written = waiting.submit(_hand_over, helper, figure, folder / stem)
            handed.append((figure, stem, written))
        else:
            save(figure, folder, stem)

    try:
        yield share
        for figure, stem, written in handed:
            if not written.result():
                save(figure, folder, stem)
    finally:
        if helper is not None:
            helper.kill()
        waiting.shutdown()
        if helper is not None:
            helper.communicate()


def _helper() -> subprocess.Popen[bytes] | None:
    """Start the second process; none where there is one core, or no way to start it."""
    if len(os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else range(2)) < 2:
        return None
    try:
        return subprocess.Popen(
            [sys.executable, *_HELPER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is answered here, not in both
        )
    except (OSError, ValueError):
        return None


def _hand_over(helper: subprocess.Popen[bytes], figure: Figure, path: Path) -> bool:
    """Send a figure, and tell whether its files were written.

    Pickled, but only from this process to the one it started: no file is ever unpickled.
    """
    assert helper.stdin is not None
    assert helper.stdout is not None
    try:
        pickle.dump((figure, path), helper.stdin)
        helper.stdin.flush()
        return helper.stdout.readline() == _DONE
    except Exception:  # a figure that cannot be sent, a process that is gone
        return False


def help_saving() -> None:
    """Save the figures that come in, until no more come; the second process runs this."""
    while True:
        try:
            figure, path = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        save(figure, path.parent, path.name)
        sys.stdout.buffer.write(_DONE)
        sys.stdout.flush()
