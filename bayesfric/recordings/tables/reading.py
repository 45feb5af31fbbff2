"""Opening a file of any registered format as a table."""

from __future__ import annotations

import hashlib
import stat
from pathlib import Path

from bayesfric.errors import BadInput
from bayesfric.recordings.tables.reader import TableOptions, readers
from bayesfric.recordings.tables.table import Table

_LARGEST_WHOLE = 2**30
# Opening a pipe waits for ever, and a device never ends.
_NO_FILES = (
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


def read_table(path: Path, options: TableOptions) -> Table:
    """Open a recorded file.

    Parameters
    ----------
    path
        The file.
    options
        Its format and layout; the format goes by the suffix if it is not told.

    Returns
    -------
    Table
        Its columns; they are checked when asked for.

    Raises
    ------
    BadInput
        If the file is missing, not allowed, no ordinary file, empty, too large, of unknown
        format, or damaged.
    """
    known = readers()
    by_suffix = {suffix: one for one in known.values() for suffix in one.suffixes}
    reader = known[options.format] if options.format else by_suffix.get(path.suffix.lower())
    try:
        size = _size(path)
        if reader is None:
            raise BadInput(
                str(path),
                f"the suffix '{path.suffix}' says nothing about its format",
                f"set format to {', '.join(known)}",
            )
        if reader.whole and size > _LARGEST_WHOLE:
            raise BadInput(
                str(path),
                f"has {size / 2**30:.1f} GiB, more than {_LARGEST_WHOLE / 2**30:.0f} GiB",
                "split it, or save its columns as "
                + " or ".join(name for name, one in known.items() if not one.whole),
            )
        return reader.read(path, options)
    except OSError as error:
        raise _unreadable(path, error) from error


def sha256(path: Path) -> str:
    """Return a file's SHA-256 in hexadecimal, or raise ``BadInput`` if it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise _unreadable(path, error) from error


def _size(path: Path) -> int:
    """Size in bytes of an ordinary file that is not empty; what else there is is refused."""
    found = path.stat()
    for is_kind, word in _NO_FILES:
        if is_kind(found.st_mode):
            raise BadInput(
                str(path), f"is {word}, no file", "save what it gives to a file, and name that"
            )
    if path.is_dir():
        raise BadInput(str(path), "is a directory", "give a file, or a pattern such as '*.csv'")
    with path.open("rb") as file:
        if not file.read(1):
            raise BadInput(str(path), "is empty", "check whether the recorder wrote anything")
    return found.st_size


def _unreadable(path: Path, error: OSError) -> BadInput:
    if isinstance(error, FileNotFoundError):
        return BadInput(str(path), "does not exist", "check the file's name and folder")
    if isinstance(error, PermissionError):
        return BadInput(str(path), "no permission to read it", "change the file's permissions")
    return BadInput(str(path), f"cannot be read ({error.strerror or error})", "check the disk")
