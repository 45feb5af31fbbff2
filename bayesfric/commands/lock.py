"""One process at a time in a folder: ``filelock``, and who is there, for the one that is not."""

from __future__ import annotations

import errno
import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

# How a disk without locks tells it: better one run without than none at all.
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
# Files of a lock.
LOCK, OWNER = "lock", "lock.owner"


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
    lock, owner = FileLock(folder / LOCK), folder / OWNER
    while True:
        folder.mkdir(exist_ok=True)
        try:
            lock.acquire(timeout=0)
        except FileNotFoundError:
            continue  # its owner just left and removed the folder
        except Timeout:
            raise Taken(_name(owner)) from None
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
