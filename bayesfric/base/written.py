"""Files that are written beside and moved into place, in folders that are made for them."""

from __future__ import annotations

import errno
import glob
import os
import platform
import shutil
import zlib
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from pydantic_core import to_jsonable_python

from bayesfric.base.errors import BadInput


def plain(found: Any) -> Any:
    """Turn data classes and arrays into what JSON can hold; what is infinite is ``None``."""
    return to_jsonable_python(found, inf_nan_mode="null", fallback=lambda x: x.tolist())


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
                beside[at] = place_beside(at)
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
        try:
            str(_target(folder)).encode()
        except UnicodeEncodeError:  # what is written into it tells its name
            mend = "name another folder with -o"
            raise BadInput(str(folder), "its name is not UTF-8", mend) from None
        beside = place_beside(folder)
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
    beside = place_beside(folder)
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


@contextmanager
def put_into(folder: Path) -> Iterator[Path]:
    """Give an empty folder to fill; its files go into ``folder`` when the block ends well."""
    beside = place_beside(folder)
    beside.mkdir()
    try:
        yield beside
        folder.mkdir(exist_ok=True)
        for file in beside.iterdir():
            file.replace(folder / file.name)
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def _target(folder: Path) -> Path:
    return Path(os.path.abspath(folder))  # noqa: PTH100  (".." must get a name, links stay)


def place_beside(path: Path) -> Path:
    """Name where this process may make what ``path`` is to be.

    What killed processes of this machine left there is removed.
    """
    target = _target(path)
    here = f"{zlib.crc32(platform.node().encode()):08x}"
    for left in target.parent.glob(f".{glob.escape(target.name)}.{here}-*.partial"):
        process = left.name.removesuffix(".partial").rpartition("-")[2]
        if process.isdecimal() and not _runs(int(process)):
            with suppress(OSError):
                shutil.rmtree(left) if left.is_dir() else left.unlink()
    return target.with_name(f".{target.name}.{here}-{os.getpid()}.partial")


def _runs(process: int) -> bool:
    if os.name == "nt":
        return True  # asking would end it
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return process != os.getpid()


def unwritable(path: Path, error: OSError, kind: str) -> BadInput:
    """Say why a ``file`` or ``folder`` cannot be written."""
    reason = error.strerror or str(error)
    return BadInput(str(path), f"cannot be written ({reason})", f"name another {kind} with -o")


def _old_name(target: Path) -> Path:
    k = 1
    while (old := target.with_name(f"{target.name}.old{k}")).exists():
        k += 1
    return old
