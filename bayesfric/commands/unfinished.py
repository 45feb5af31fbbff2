"""A run that is not finished: its checkpoints beside the run directory, its lock, its end.

One process at a time is in a folder (by ``filelock``, and who is there, for the one that is not);
Ctrl-C and SIGTERM wait while something is done that should not break off anywhere.
"""

from __future__ import annotations

import errno
import json
import os
import platform
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from types import FrameType

from filelock import FileLock, Timeout

import bayesfric
from bayesfric.errors import BadInput, Interrupted
from bayesfric.inference.sampling.checkpoint import Checkpoint
from bayesfric.inference.sampling.sampling import Sampling
from bayesfric.model import Model
from bayesfric.report.files import parents_made

# How a disk without locks tells it: better one run without than none at all.
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
# Files of a lock.
LOCK, OWNER = "lock", "lock.owner"


@dataclass
class Asked:
    """Whether the user asked to stop."""

    by: int | None = None  # the signal
    again: bool = False  # whether they asked a second time, and want no more waiting


class Unfinished:
    """The checkpoints of a run; made by :func:`unfinished`."""

    def __init__(self, folder: Path, place: Path) -> None:
        self.folder, self._place = folder, place
        # whether what is there is to be kept under another name
        self.afresh = False
        self._samplings: list[Checkpoint] = []
        self.asked = Asked()

    @property
    def saved(self) -> int:
        """Count the steps on disk."""
        return sum(c.saved for c in self._samplings)

    @property
    def walking(self) -> bool:
        """Tell whether a sampler is at work."""
        return any(c.walking for c in self._samplings)

    def sampling(self, model: Model, name: str, settings: Sampling) -> Checkpoint:
        """Give the checkpoint of one sampling; bad input if there is one of something else."""
        if self.afresh:
            _set_aside(self._place)
            self.afresh = False
        tables = json.loads(model.config.tables.model_dump_json())
        # what its steps depend on
        facts = {
            "version": _versions(),
            "recording": {r.name: r.sha256 for r in model.recordings},
            "configuration": tables | {"sampling": settings.model_dump(mode="json")},
        }
        checkpoint = Checkpoint(
            self._place, name, facts, asked_to_stop=lambda: self.asked.by is not None
        )
        self._samplings.append(checkpoint)
        return checkpoint

    @property
    def kept(self) -> bool:
        """Tell whether there is something to go on with."""
        return any(self._place.glob("*.json"))

    def save(self) -> None:
        """Save what was sampled and is not yet on disk."""
        for checkpoint in self._samplings:
            checkpoint.save()

    def remove(self) -> None:
        """Remove the checkpoints: the run is written."""
        for checkpoint in self._samplings:
            checkpoint.remove()


@contextmanager
def unfinished(folder: Path, *, resume: bool, force: bool) -> Iterator[Unfinished]:
    """Work on a run directory that is to be made, alone, so that the work can be gone on with.

    ``resume`` goes on with the checkpoint that is there, ``force`` keeps it under another name.
    Ctrl-C and SIGTERM end in :class:`Interrupted`, after everything sampled was saved.
    """
    target = Path(os.path.abspath(folder))  # noqa: PTH100  (links stay)
    place = target.with_name(f".{target.name}.checkpoint")
    if resume and force:
        raise BadInput("--resume", "cannot go with --force", "give one of them")
    try:
        with parents_made(place), alone_in(place, folder):
            run = Unfinished(folder, place)
            there = run.kept
            if resume and not there:
                done = (folder / "summary.json").is_file()
                raise BadInput(
                    str(folder),
                    "is finished" if done else "there is no checkpoint to resume",
                    "leave --resume out" + (" and name another folder with -o" if done else ""),
                )
            if there and not (resume or force):
                raise BadInput(
                    str(folder),
                    "was interrupted, and its checkpoint is there",
                    "add --resume to go on, or --force to start afresh",
                )
            run.afresh = there and force
            with _ended_well(run):
                yield run
    except OSError as error:
        raise _cannot(error, folder, kept=False) from None


@contextmanager
def _ended_well(run: Unfinished) -> Iterator[None]:
    """Save on whatever ends the work before it is done, and say what is kept."""
    with asked_to_stop(lambda: run.walking) as asked:
        run.asked = asked
        try:
            yield
        except KeyboardInterrupt:
            if not asked.again:
                with suppress(OSError, KeyboardInterrupt):
                    run.save()
            raise Interrupted(asked.by, saved=run.saved) from None
        except OSError as error:
            raise _cannot(error, run.folder, run.kept) from None
        except BaseException:
            with suppress(OSError):
                run.save()
            raise


def _cannot(error: OSError, folder: Path, kept: bool) -> BadInput:
    """Word an error of the disk."""
    reason = os.strerror(error.errno) if error.errno else str(error)
    if kept:
        mend = "mend that, then go on with --resume from the last checkpoint, which is intact"
    else:
        mend = "mend that, or name another folder with -o"
    return BadInput(str(error.filename or folder), f"cannot be written ({reason})", mend)


def _versions() -> dict[str, str]:
    return {
        "bayesfric": bayesfric.__version__,
        "python": ".".join(platform.python_version_tuple()[:2]),
        **{name: version(name) for name in ("numpy", "scipy", "emcee", "numba")},
    }


def _set_aside(place: Path) -> None:
    """Move the files of a checkpoint into a folder of their own."""
    k = 1
    while (old := place.with_name(f"{place.name}.old{k}")).exists():
        k += 1
    old.mkdir()
    # the manifests last: with one of them there, it can still be told what this was
    for path in sorted(place.iterdir(), key=lambda path: path.suffix == ".json"):
        if path.name not in (LOCK, OWNER):
            path.rename(old / path.name)


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

    before = {}
    # Python lets only the main thread have handlers
    if threading.current_thread() is threading.main_thread():
        before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    heard = {n: h for n, h in before.items() if h is not None and h is not signal.SIG_IGN}
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
    lock, owner = FileLock(folder / LOCK), folder / OWNER
    while True:
        folder.mkdir(exist_ok=True)
        try:
            lock.acquire(timeout=0)
        except FileNotFoundError:
            continue  # its owner just left and removed the folder
        except Timeout:
            what = f"{_name(owner)} is making this run"
            raise BadInput(str(run), what, "wait for it, or name another with -o") from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
        break
    try:
        owner.write_text(f"process {os.getpid()} on {socket.gethostname()}\n", encoding="utf-8")
        yield
    finally:
        if sys.platform == "win32":
            lock.release()  # nothing open can be removed there
        # nobody can take it before it is released, and who waits finds it gone
        for path in (owner, folder / LOCK):
            with suppress(OSError):
                path.unlink()
        with suppress(OSError):
            folder.rmdir()
        lock.release()


def _name(owner: Path) -> str:
    with suppress(OSError, UnicodeDecodeError), owner.open(encoding="utf-8") as file:
        return file.readline(200).strip() or "another process"
    return "another process"
