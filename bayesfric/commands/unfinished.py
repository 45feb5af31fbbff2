"""A run that is not finished: its checkpoints beside the run directory, its lock, its end.

One process at a time is in a folder (by ``filelock``);
Ctrl-C and SIGTERM wait while something is done that should not break off anywhere.
"""

from __future__ import annotations

import errno
import json
import os
import platform
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from types import FrameType

from filelock import FileLock, Timeout

from bayesfric.base.errors import BadInput, Interrupted
from bayesfric.base.version import __version__
from bayesfric.base.written import parents_made
from bayesfric.fit.model import Model
from bayesfric.inference.sampling.checkpoint import Checkpoint
from bayesfric.inference.sampling.sampling import Sampling

# How a disk without locks tells it: better one run without than none at all.
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
LOCK = "lock"


@dataclass
class Asked:
    """Whether the user asked to stop."""

    by: int | None = None  # the signal
    again: bool = False  # whether they asked a second time, and want no more waiting


@dataclass
class Unfinished:
    """The checkpoints of a run; made by :func:`unfinished`."""

    place: Path
    afresh: bool  # whether what is there is to be removed first
    samplings: list[Checkpoint] = field(default_factory=list)
    asked: Asked = field(default_factory=Asked)

    def sampling(self, model: Model, name: str, settings: Sampling) -> Checkpoint:
        """Give the checkpoint of one sampling; bad input if there is one of something else."""
        if self.afresh:
            _clear(self.place)
            self.afresh = False
        # what its steps depend on
        tables = json.loads(model.config.tables.model_dump_json())
        facts = {
            "version": {
                "bayesfric": __version__,
                "python": ".".join(platform.python_version_tuple()[:2]),
                **{name: version(name) for name in ("numpy", "scipy", "emcee", "numba")},
            },
            "recording": {r.name: r.sha256 for r in model.recordings},
            "configuration": tables | {"sampling": settings.model_dump(mode="json")},
        }
        made = Checkpoint(self.place, name, facts, asked_to_stop=lambda: self.asked.by is not None)
        self.samplings.append(made)
        return made

    def save(self) -> None:
        """Save what was sampled and is not yet on disk."""
        for checkpoint in self.samplings:
            checkpoint.save()

    def remove(self) -> None:
        """Remove the checkpoints: the run is written."""
        for checkpoint in self.samplings:
            checkpoint.remove()
        _clear(self.place)


@contextmanager
def unfinished(folder: Path, *, resume: bool, force: bool) -> Iterator[Unfinished]:
    """Work on a run directory that is to be made, alone, so that the work can be gone on with.

    ``resume`` goes on with the checkpoint that is there, ``force`` removes it before it samples.
    Ctrl-C and SIGTERM end in :class:`Interrupted`, after everything sampled was saved.
    """
    target = Path(os.path.abspath(folder))  # noqa: PTH100  (links stay)
    place = target.with_name(f".{target.name}.checkpoint")
    if resume and force:
        raise BadInput("--resume", "cannot go with --force", "give one of them")
    kept = False
    try:
        with parents_made(place), alone_in(place, folder):
            there = any(place.glob("*.steps"))
            if resume and not there:
                done = (folder / "summary.json").is_file()
                what = "is finished" if done else "there is no checkpoint to resume"
                mend = "leave --resume out" + (" and name another folder with -o" if done else "")
                raise BadInput(str(folder), what, mend)
            if there and not (resume or force):
                what = "was interrupted, and its checkpoint is there"
                mend = "add --resume to go on, or --force to start afresh"
                raise BadInput(str(folder), what, mend)
            if not there:
                _clear(place)
            run = Unfinished(place, afresh=there and force)
            with asked_to_stop(lambda: any(c.walking for c in run.samplings)) as run.asked:
                try:
                    yield run
                except KeyboardInterrupt:
                    if not run.asked.again:
                        with suppress(OSError, KeyboardInterrupt):
                            run.save()
                    saved = sum(c.saved for c in run.samplings)
                    raise Interrupted(run.asked.by, saved) from None
                except OSError:
                    kept = any(c.saved for c in run.samplings)
                    if not kept:
                        _clear(place)
                    raise
                except BaseException:
                    with suppress(OSError):
                        run.save()
                    raise
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
        mend = "mend that, or name another folder with -o"
        if kept:
            mend = "mend that, then go on with --resume from the last checkpoint, which is intact"
        where = str(error.filename or folder)
        raise BadInput(where, f"cannot be written ({reason})", mend) from None


def _clear(place: Path) -> None:
    """Remove all but the lock: what nobody is to go on with."""
    for path in place.iterdir():
        if path.name != LOCK and path.is_file():
            path.unlink()


@contextmanager
def asked_to_stop(worth_waiting: Callable[[], bool]) -> Iterator[Asked]:
    """Note a signal while ``worth_waiting``; raise KeyboardInterrupt at any other moment.

    A second signal always does. Signals that are ignored, as those of a run under ``nohup``
    are, stay so, and the previous handlers are put back at the end.
    """
    asked = Asked()

    def note(number: int, _: FrameType | None) -> None:
        asked.again = asked.by is not None
        asked.by = asked.by or number
        if asked.again or not worth_waiting():
            raise KeyboardInterrupt

    heard = {}
    # Python lets only the main thread have handlers
    if threading.current_thread() is threading.main_thread():
        before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        heard = {n: h for n, h in before.items() if h not in (None, signal.SIG_IGN)}
    try:
        for number in heard:
            signal.signal(number, note)
        yield asked
    finally:
        for number, handler in heard.items():
            signal.signal(number, handler)


@contextmanager
def alone_in(folder: Path, run: Path) -> Iterator[None]:
    """Be the only process in a run's folder; it is made, and removed again if it stays empty.

    The operating system gives the lock back when a process ends, however it ends.
    """
    lock = FileLock(folder / LOCK)
    while True:
        folder.mkdir(exist_ok=True)
        try:
            lock.acquire(timeout=0)
        except FileNotFoundError:
            continue  # its owner just left and removed the folder
        except Timeout:
            what = "another process is making this run"
            raise BadInput(str(run), what, "wait for it, or name another with -o") from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
        break
    try:
        yield
    finally:
        # nobody can take it before it is released, and who waits finds it gone
        with suppress(OSError):
            (folder / LOCK).unlink()
            folder.rmdir()
        lock.release()
