"""Write files and folders atomically: in a temporary folder next to their place, then moved."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any

from filelock import FileLock, Timeout
from pydantic_core import to_jsonable_python

from bayesfric.base.errors import BadInput


def jsonable(value: Any) -> Any:
    """Turn data classes and arrays into what JSON can hold; infinite numbers into ``None``."""
    return to_jsonable_python(value, inf_nan_mode="null", fallback=lambda x: x.tolist())


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Give a path to write to; when the block succeeds, it replaces the file or folder ``path``.

    Missing parent folders are made. ``OSError`` where the folder cannot be written to.
    """
    target = absolute(path)
    with suppress(FileExistsError):
        target.parent.mkdir(parents=True)
    with TemporaryDirectory(
        prefix=".bayesfric-", dir=target.parent, ignore_cleanup_errors=True
    ) as name:
        partial = Path(name, "new")
        yield partial
        old = Path(name, "old")
        if target.is_dir():
            target.rename(old)
        try:
            partial.replace(target)
        except OSError:
            if old.is_dir():  # or it would go with the temporary folder
                old.rename(target)
            raise


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Give an empty folder to fill; it replaces ``folder`` when the block succeeds."""
    try:
        with atomic_path(folder) as partial:
            partial.mkdir()
            yield partial
    except OSError as error:
        raise unwritable(folder, error, "folder") from error


@contextmanager
def add_files(folder: Path) -> Iterator[Path]:
    """Give an empty folder to fill; its files go into ``folder`` when the block succeeds."""
    with TemporaryDirectory(prefix=".bayesfric-", dir=folder.parent) as name:
        yield Path(name)
        folder.mkdir(exist_ok=True)
        for file in Path(name).iterdir():
            file.replace(folder / file.name)


def write_files(texts: Mapping[Path, str], *, replace: bool = False) -> None:
    """Write several text files; missing folders are made.

    ``BadInput`` if one exists and must not be replaced, or cannot be written; then none is.
    """
    path = next(iter(texts))
    try:
        with ExitStack() as stack:
            for path, text in texts.items():
                if path.is_dir():
                    raise BadInput(str(path), "is a folder", "name a file with -o")
                if path.exists() and not replace:
                    hint = "name another file with -o, or replace it with --force"
                    raise BadInput(str(path), "exists already", hint)
                partial = stack.enter_context(atomic_path(path))
                partial.write_text(text, encoding="utf-8")
    except OSError as error:
        raise unwritable(path, error, "file") from None


def check_output_folder(folder: Path, *, force: bool | None, marker: str = "summary.json") -> None:
    """Refuse a folder that is in use or cannot be written, before time is spent on its content.

    ``force`` allows to replace a folder that holds the file ``marker``; ``None`` where the command
    has no such option.
    """
    try:
        if os.path.lexists(folder) and not folder.is_dir():
            raise BadInput(str(folder), "is not a folder", "name a folder with -o")
        if folder.is_dir() and any(folder.iterdir()):
            marked = (folder / marker).is_file()
            if not (force and marked):
                problem = f"is not empty, and holds no '{marker}'" if force else "is not empty"
                replace = ", or replace it with --force" if marked and force is not None else ""
                raise BadInput(str(folder), problem, f"name another folder with -o{replace}")
        # rights, read-only disks and /proc all refuse differently: try it
        parent = next(p for p in absolute(folder).parents if os.path.lexists(p))
        TemporaryFile(dir=parent).close()
    except OSError as error:
        raise unwritable(folder, error, "folder") from None


@contextmanager
def run_lock(folder: Path) -> Iterator[None]:
    """Hold an exclusive lock on a run folder; the system releases that of a killed process."""
    target = absolute(folder)
    lock = FileLock(target.with_name(f".{target.name}.lock"))
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=0)
    except Timeout:
        problem = "another process is making this run"
        raise BadInput(str(folder), problem, "wait for it, or name another with -o") from None
    except OSError as error:
        raise unwritable(folder, error, "folder") from None
    try:
        yield
    finally:
        Path(lock.lock_file).unlink(missing_ok=True)
        lock.release()


def absolute(path: Path) -> Path:
    """Make a path absolute without following links, so that it has a name and a parent."""
    return Path(os.path.abspath(path))  # noqa: PTH100  (Path.absolute keeps "..")


def unwritable(path: Path, error: OSError, kind: str) -> BadInput:
    """Word why a ``file`` or ``folder`` cannot be written."""
    reason = error.strerror or str(error)
    return BadInput(str(path), f"cannot be written ({reason})", f"name another {kind} with -o")
