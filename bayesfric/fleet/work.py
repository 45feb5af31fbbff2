"""What a worker does with a unit: the whole fit, once, in a run directory of its own.

What goes in is a :class:`Task`, what comes out a dict of strings and numbers. ``unit.json`` in the
run directory says what was fitted and what came out; it is written last, so a unit without it is
not finished, and one with it is not done again while configuration, recordings and version are
the same.
"""

from __future__ import annotations

import errno
import hashlib
import json
import shutil
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, TypedDict

from filelock import FileLock

from bayesfric.base import __version__
from bayesfric.base.atomic_write import write_files
from bayesfric.base.errors import BadInput
from bayesfric.base.safe_read import read_json
from bayesfric.fit.model import Model
from bayesfric.fleet.results import Kept, failure, record_of
from bayesfric.problem.config import Config, parse_config
from bayesfric.recordings.read import recorded_files
from bayesfric.recordings.tables import sha256

# What the machine, not the unit, is to blame for: it may go well the next time.
_MACHINE = {
    errno.EIO, errno.ENOSPC, errno.EDQUOT, errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.ESTALE,
    errno.EAGAIN, errno.ETIMEDOUT, errno.EROFS, errno.ENODEV, errno.ENOLCK,
}  # fmt: skip
UNIT = "unit.json"


class Task(TypedDict):
    """All that a worker is told."""

    name: str
    text: str  # the filled configuration
    place: str  # of the template; file names are relative to its folder
    folder: str  # run directory to make
    draws: int | None  # of a light run


class Done(TypedDict):
    """All that a worker gives back; no time is in the record, which is the same every time."""

    record: dict[str, Any]
    again: bool  # whether it was finished before
    cpu_seconds: float  # that it took now


def do_unit(task: Task) -> Done:
    """Fit a unit, unless that is done.

    Raises
    ------
    OSError
        For faults of the machine only; all else is told in the record.
    """
    began, folder = time.process_time(), Path(task["folder"])
    folder.parent.mkdir(parents=True, exist_ok=True)
    # waits for a worker that was thought lost; the system unlocks when a process ends
    lock = folder.with_name(f".{folder.name}.lock")
    with FileLock(lock):
        config, facts, why = _facts(task)
        record = _stored(folder, facts)
        again = record is not None
        if record is None:
            shutil.rmtree(folder, ignore_errors=True)
            record = failure(why) if config is None else _fitted(config, folder, task["draws"])
            folder.mkdir(parents=True, exist_ok=True)
            text = json.dumps({"of": facts, "record": record}, ensure_ascii=False, allow_nan=False)
            try:
                write_files({folder / UNIT: f"{text}\n"})
            except BadInput as error:
                raise OSError(str(error)) from None
        # who waits for it finds the unit done
        with suppress(OSError):
            lock.unlink()
    return {"record": record, "again": again, "cpu_seconds": time.process_time() - began}


def _fitted(config: Config, folder: Path, draws: int | None) -> dict[str, Any]:
    try:
        return record_of(Model.from_config(config).fit().write(folder, draws=draws))
    except MemoryError:
        raise
    except Exception as error:
        # what the machine did may have been put into words
        cause = error if isinstance(error, OSError) else error.__cause__ or error.__context__
        if isinstance(cause, OSError) and cause.errno in _MACHINE:
            # rebuilt, as pickled ones lose what they hold
            raise OSError(cause.errno, cause.strerror, str(cause.filename or folder)) from None
        if isinstance(error, BadInput):
            return failure(str(error))
        # a defect of this package is one unit's, not the fleet's
        return failure(" ".join(f"internal: {type(error).__name__}: {error}".split()))


def _facts(task: Task) -> tuple[Config | None, dict[str, Any], str]:
    """Say what a fit depends on; without a configuration, why there is none."""
    facts: dict[str, Any] = {
        "bayesfric": __version__,
        "configuration": hashlib.sha256(task["text"].encode()).hexdigest(),
        "draws": task["draws"],
        "recordings": {},
    }
    try:
        config = parse_config(task["text"], Path(task["place"]))
    except BadInput as error:
        return None, facts, str(error)
    for source in config.tables.recordings:
        # what cannot be read is told when it is fitted, and is tried again when it can
        with suppress(BadInput):
            for path in recorded_files(source, config.folder):
                with suppress(BadInput):
                    facts["recordings"][str(path)] = None
                    facts["recordings"][str(path)] = sha256(path)
    return config, facts, ""


def _stored(folder: Path, facts: dict[str, Any]) -> dict[str, Any] | None:
    """Read what came of the same unit before."""
    try:
        found = read_json(folder / UNIT)
        Kept.model_validate(found["record"], strict=True)
        return dict(found["record"]) if found["of"] == facts else None
    except (BadInput, ValueError, LookupError, TypeError):
        return None
