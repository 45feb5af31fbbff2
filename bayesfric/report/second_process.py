"""A second process that does half of the work of writing a run."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from threading import Thread
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bayesfric.inference.sampling.sampling import Progress

Work = Callable[[], object]

_DONE = b"done\n"
# -P: a file of the user's folder must not stand in for a library's.
_HELPER = ["-P", "-c", "from bayesfric.report.second_process import help_out; help_out()"]


# One that was started before there is anything to do.
_waiting: list[subprocess.Popen[bytes]] = []


@contextmanager
def second_process() -> Iterator[None]:
    """Start it now: until there is work it has libraries ready.

    As early as possible, while this process imports, too, and needs one core only.
    """
    if (helper := _helper()) is not None:
        _waiting.append(helper)
    try:
        yield
    finally:
        while _waiting:
            _end(_waiting.pop())


@contextmanager
def shared_work(
    progress: Callable[[Progress], None] = lambda _: None,
) -> Iterator[Callable[[str, Work], None]]:
    """Give a function that takes work, by what to call it; all is done when the block ends well.

    Work is a call without arguments that writes files, and whose result nobody wants. The second
    process takes one after the other through a pipe; when the block ends this one takes what is
    left, from the other end. What cannot be sent, or fails there for whatever reason, is done
    here, where an error is told. The bytes are the same wherever a file is written.
    """
    from bayesfric.inference.sampling.sampling import Progress

    helper = _waiting.pop() if _waiting else _helper()
    line = ThreadPoolExecutor(1)
    handed: list[tuple[str, Work, Future[bool]]] = []

    def share(name: str, work: Work) -> None:
        handed.append((name, work, line.submit(_hand_over, helper, work)))

    try:
        yield share
        for name, work, done in reversed(handed):
            if done.cancel():
                progress(Progress(name))
                work()
        for name, work, done in handed:
            if not done.cancelled():
                progress(Progress(name))
                if not done.result():
                    work()
    finally:
        if helper is not None:
            helper.kill()
        line.shutdown(cancel_futures=True)
        if helper is not None:
            _end(helper)


def _end(helper: subprocess.Popen[bytes]) -> None:
    helper.kill()
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
            # Ctrl-C is answered here, not in both; in a session of its own, it would not give way
            process_group=0,
        )
    except (OSError, ValueError):
        return None


def _hand_over(helper: subprocess.Popen[bytes] | None, work: Work) -> bool:
    """Send work, and tell whether it was done.

    Pickled, but only from this process to the one it started: no file is ever unpickled.
    """
    if helper is None:
        return False
    assert helper.stdin is not None
    assert helper.stdout is not None
    try:
        pickle.dump(work, helper.stdin)
        helper.stdin.flush()
        return helper.stdout.readline() == _DONE
    except Exception:  # what cannot be sent, a process that is gone
        return False


def help_out() -> None:
    """Do the work that comes in, until no more comes; the second process runs this."""
    ready = Thread(target=_get_ready, daemon=True)
    ready.start()
    while True:
        try:
            work: Any = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        work()
        sys.stdout.buffer.write(_DONE)
        sys.stdout.flush()


def _get_ready() -> None:
    """Import what work will need, while nobody else needs the core."""
    if sys.platform == "linux":  # where it is of this thread alone
        os.setpriority(os.PRIO_PROCESS, 0, 19)
    from bayesfric.report.figures.registry import run_figures

    run_figures()
    import corner  # noqa: F401  (with ArviZ)
