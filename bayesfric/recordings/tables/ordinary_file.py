"""Refusing what is no ordinary file: opening a pipe waits for ever, a device never ends."""

from __future__ import annotations

import stat
from pathlib import Path

from bayesfric.errors import BadInput

_KINDS = (
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


def check_ordinary(path: Path) -> int:
    """Refuse pipes, devices and sockets, without opening them.

    Parameters
    ----------
    path
        A file or directory; links are followed.

    Returns
    -------
    int
        Its size in bytes.

    Raises
    ------
    BadInput
        If it is neither a file nor a directory.
    OSError
        If it does not exist or cannot be reached.
    """
    found = path.stat()
    for is_kind, word in _KINDS:
        if is_kind(found.st_mode):
            raise BadInput(
                str(path), f"is {word}, no file", "save what it gives to a file, and name that"
            )
    return found.st_size
