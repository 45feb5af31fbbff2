"""A run that is not finished: its checkpoints beside the run directory, its lock, its end."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

import bayesfric
from bayesfric.commands.lock import LOCK, OWNER, Taken, alone_in
from bayesfric.commands.signals import Asked, asked_to_stop
from bayesfric.errors import BadInput, Interrupted
from bayesfric.inference.sampling.checkpoint import Checkpoint
from bayesfric.inference.sampling.sampling import Sampling
from bayesfric.model import Model


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
        """Give the checkpoint of one sampling.

        Parameters
        ----------
        model, settings
            What is sampled, and how.
        name
            Of the sampling, as a file may be called.

        Raises
        ------
        BadInput
            If there is one, but of something else.
        """
        if self.afresh:
            _set_aside(self._place)
            self.afresh = False
        checkpoint = Checkpoint(
            self._place,
            name,
            _facts(model, settings),
            asked_to_stop=lambda: self.asked.by is not None,
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

    Parameters
    ----------
    folder
        The run directory.
    resume
        Go on with the checkpoint that is there.
    force
        Keep the checkpoint that is there under another name.

    Raises
    ------
    BadInput
        If there is a checkpoint and neither was said, or none to resume, or another
        process at work; if a checkpoint cannot be written.
    Interrupted
        On Ctrl-C or SIGTERM, after everything sampled was saved.
    """
    target = Path(os.path.abspath(folder))  # noqa: PTH100  (links stay)
    place = target.with_name(f".{target.name}.checkpoint")
    if resume and force:
        raise BadInput("--resume", "cannot go with --force", "give one of them")
    try:
        with alone_in(place):
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
    except Taken as taken:
        raise BadInput(
            str(folder), f"{taken} is making this run", "wait for it, or name another with -o"
        ) from None


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


def _facts(model: Model, settings: Sampling) -> dict[str, Any]:
    """Put together what a sampling's steps depend on."""
    tables = json.loads(model.config.tables.model_dump_json())
    return {
        "version": _versions(),
        "recording": {r.name: r.sha256 for r in model.recordings},
        "configuration": tables | {"sampling": settings.model_dump(mode="json")},
    }


def _versions() -> Mapping[str, str]:
    libraries = ("numpy", "scipy", "emcee", "numba")
    return {
        "bayesfric": bayesfric.__version__,
        "python": ".".join(platform.python_version_tuple()[:2]),
        **{name: version(name) for name in libraries},
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
