"""One process at a time in a folder."""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

if sys.platform == "win32":
    import msvcrt

    def _take(file: IO[str]) -> None:
        # a byte behind what is written, so that others can read that
        file.seek(2**20)
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
else:
    import fcntl

    def _take(file: IO[str]) -> None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


class Taken(Exception):
    """Another process is in the folder; the text tells which."""


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Be the only process in a folder; it is made, and removed again if it stays empty.

    The operating system gives the lock back when a process ends, however it ends.

    Raises
    ------
    Taken
        If another process is there.
    OSError
        If the folder cannot be made.
    """
    file = _locked(folder)
    try:
        yield
    finally:
        if sys.platform == "win32":
            file.close()  # nothing open can be removed there
        with suppress(OSError):
            # nobody can take it before it is closed, and who waits finds it gone
            (folder / "lock").unlink()
        with suppress(OSError):
            folder.rmdir()
        file.close()


def _locked(folder: Path) -> IO[str]:
    path = folder / "lock"
    while True:
        folder.mkdir(exist_ok=True)
        try:
            file = path.open("a+", encoding="utf-8")
        except FileNotFoundError:
            continue  # its owner just left and removed the folder
        try:
            _take(file)
        except (BlockingIOError, PermissionError):  # the second is how Windows tells it
            raise Taken(_owner(file)) from None
        except OSError:
            # a disk without locks: better one run without than none at all
            pass
        with suppress(OSError):
            if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                break
        file.close()  # the one before removed it in this very moment
    file.seek(0)
    file.truncate()
    file.write(f"process {os.getpid()} on {socket.gethostname()}\n")
    file.flush()
    return file


def _owner(file: IO[str]) -> str:
    with file:
        file.seek(0)
        return file.readline(200).strip() or "another process"
