"""Text files that are written beside and moved into place, in folders that are made for them."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from bayesfric.errors import BadInput


@contextmanager
def parents_made(path: Path) -> Iterator[None]:
    """Make the folders that ``path`` is to lie in; those that stay empty are removed again.

    ``OSError`` where they cannot be made.
    """
    missing: list[Path] = []
    folder = _target(path).parent
    while not folder.exists():
        missing.append(folder)
        folder = folder.parent
    if not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(folder))
    try:
        for one in reversed(missing):
            one.mkdir(exist_ok=True)  # another process may want the same one
        yield
    finally:
        for one in missing:
            with suppress(OSError):
                one.rmdir()


def write_beside(texts: Mapping[Path, str], *, replace: bool = False) -> None:
    """Write several files, by name, all or none; folders that are missing are made.

    ``BadInput`` if a file is there already and must not be replaced, or a folder cannot be written
    to; nothing is left behind.
    """
    beside: dict[Path, Path] = {}
    at = next(iter(texts))
    try:
        with ExitStack() as folders:
            for at in texts:
                if at.is_dir():
                    raise BadInput(str(at), "is a folder", "name a file with -o")
                if at.exists() and not replace:
                    raise BadInput(
                        str(at),
                        "exists already",
                        "name another file with -o, or replace it with --force",
                    )
                folders.enter_context(parents_made(at))
            # before the folders: one that is empty again goes, too
            folders.callback(_removed, beside)
            for at, text in texts.items():
                beside[at] = at.with_name(f".{at.name}.{os.getpid()}.partial")
                beside[at].write_text(text, encoding="utf-8")
            for at, partial in beside.items():
                partial.replace(at)
    except OSError as error:
        raise unwritable(at, error, "file") from None


def _removed(beside: Mapping[Path, Path]) -> None:
    for partial in beside.values():
        with suppress(OSError):  # it was never made, or has its name
            partial.unlink()


def check_free(folder: Path, *, force: bool | None, marked: str = "summary.json") -> None:
    """Refuse a directory that would overwrite another, or cannot be made.

    ``force`` is whether an old one, ``marked`` by a file, may be kept under another name; ``None``
    where the command has no such option. ``BadInput`` comes before any sampling is spent on it.
    """
    try:
        if folder.is_symlink() and not folder.exists():
            raise BadInput(str(folder), "is a link to nowhere", "name a folder with -o")
        if folder.exists() and not folder.is_dir():
            raise BadInput(str(folder), "is a file", "name a folder with -o")
        if not _target(folder).name:
            raise BadInput(str(folder), "is the whole disk", "name a folder in it with -o")
        filled = folder.exists() and any(folder.iterdir())
        old = (folder / marked).is_file()
        if filled and not (force and old):
            what = f"is not empty, and holds no '{marked}'" if force else "is not empty"
            mend = "name another folder with -o"
            if old and force is not None:
                mend += ", or add --force to keep it under another name"
            raise BadInput(str(folder), what, mend)
        beside = _beside(folder)
        # Only trying tells: rights, read-only disks and /proc all refuse in their own way.
        with parents_made(beside):
            beside.mkdir()
            beside.rmdir()
    except OSError as error:
        raise unwritable(folder, error, "folder") from None


@contextmanager
def made_beside(folder: Path) -> Iterator[Path]:
    """Give an empty folder to fill; it takes its name when the block ends well.

    What stood there before is kept under another name; what a failed block left
    is removed, with the folders that were made for it.
    """
    target = _target(folder)
    beside = _beside(folder)
    try:
        with parents_made(target):
            try:
                beside.mkdir()
                yield beside
                if target.exists():
                    if any(target.iterdir()):
                        target.rename(_old_name(target))
                    else:
                        target.rmdir()
                beside.rename(target)
            except BaseException:
                shutil.rmtree(beside, ignore_errors=True)
                raise
    except OSError as error:
        raise unwritable(folder, error, "folder") from error


def _target(folder: Path) -> Path:
    return Path(os.path.abspath(folder))  # noqa: PTH100  (".." must get a name, links stay)


def _beside(folder: Path) -> Path:
    target = _target(folder)
    return target.with_name(f".{target.name}.{os.getpid()}.partial")


def unwritable(path: Path, error: OSError, kind: str) -> BadInput:
    """Say why a ``file`` or ``folder`` cannot be written."""
    reason = error.strerror or str(error)
    return BadInput(str(path), f"cannot be written ({reason})", f"name another {kind} with -o")


def _old_name(target: Path) -> Path:
    k = 1
    while (old := target.with_name(f"{target.name}.old{k}")).exists():
        k += 1
    return old
