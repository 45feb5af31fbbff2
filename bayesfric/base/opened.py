"""Everything that is opened by its name, opened here: an ordinary file of bounded size.

A name may be that of a pipe that nobody writes to, of a device that never ends, of a file far
larger than it looks, or of an archive that unpacks to more than there is memory. What is opened
here is none of these, or it is bad input, in one line.
"""

from __future__ import annotations

import glob
import json
import math
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.base.errors import BadInput

if TYPE_CHECKING:
    import h5py

# Bytes of a text that a person wrote, or a run that is summed up, and of one array.
LARGEST_TEXT, LARGEST_ARRAY = 2**26, 2**28
# Bytes that one byte of a compressed array may stand for: even of constants it is 1032 at most.
_PACKED = 1100
# Files and folders that a pattern looks at.
MOST_LOOKED_AT = 100_000
# Nothing that is measured is larger.
LARGEST_NUMBER = 1e100
# No control characters, which a terminal would obey, and no halves of characters.
_SHOWN = re.compile(r"[^\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]*")


def check_ordinary(path: Path, mend: str = "check the name") -> int:
    """Refuse what is no ordinary file that can be read, and give its size in bytes.

    ``mend`` says what to name instead.
    """
    try:
        str(path).encode()
        found = path.stat()
    except UnicodeEncodeError:  # every later print of it would end in an error
        what = "its name is not UTF-8"
        raise BadInput(str(path), what, "rename the file or its folder") from None
    except FileNotFoundError:
        raise BadInput(str(path), "does not exist", mend) from None
    except (OSError, ValueError) as error:
        raise unreadable(path, error) from None
    if stat.S_ISDIR(found.st_mode):
        raise BadInput(str(path), "is a folder", mend)
    # opening a pipe waits for ever, a device never ends
    if not stat.S_ISREG(found.st_mode):
        raise BadInput(str(path), "is no ordinary file", "save what it gives to a file")
    return found.st_size


def matching(pattern: str, folder: Path, where: str) -> dict[Path, tuple[str, ...]]:
    """Find what a pattern matches as the shell does, and the names that its parts but ** stand for.

    ``where`` names it in messages. ** enters no linked folder, which may hold itself.
    """
    anchor = Path(pattern).anchor
    parts = [part for part in pattern[len(anchor) :].split("/") if part not in ("", ".")]
    if any("**" in part and part != "**" for part in parts):
        why = "is no pattern (** stands for whole folders)"
        raise BadInput(where, why, "write ** between slashes")
    left = MOST_LOOKED_AT

    def inside(path: Path) -> list[os.DirEntry[str]]:
        nonlocal left
        entries = list[os.DirEntry[str]]()
        with suppress(OSError), os.scandir(path) as found:
            for entry in found:
                entries.append(entry)
                left -= 1
                if left < 0:
                    what = f"looks at more than {MOST_LOOKED_AT} files"
                    raise BadInput(where, what, "name the folders, with fewer * and **")
        return entries

    found: dict[Path, tuple[str, ...]] = {Path(anchor) if anchor else folder: ()}
    for part in parts:
        before, found = found, {}
        if part == "**":
            waiting = [*before.items()]
            while waiting:
                path, names = waiting.pop()
                if path not in found:
                    found[path] = names
                    deeper = (e.name for e in inside(path) if e.is_dir(follow_symlinks=False))
                    waiting += [(path / one, names) for one in deeper if one[0] != "."]
            continue
        for path, names in before.items():
            if not glob.has_magic(part):
                there = [part] if os.path.lexists(path / part) else []
            else:
                hidden = part[0] == "."
                every = (entry.name for entry in inside(path))
                there = [x for x in every if (hidden or x[0] != ".") and fnmatch(x, part)]
            found |= {path / one: (*names, one) for one in there}
    return found


def read_bytes(path: Path, mend: str = "check the name", *, largest: int = LARGEST_TEXT) -> bytes:
    """Read a file of at most ``largest`` bytes."""
    check_ordinary(path, mend)
    try:
        with path.open("rb") as file:
            raw = file.read(largest + 1)
    except OSError as error:
        raise unreadable(path, error) from None
    if len(raw) > largest:
        raise BadInput(str(path), f"is larger than {largest / 2**20:.0f} MiB", mend)
    return raw


def read_text(path: Path, mend: str = "check the name", *, largest: int = LARGEST_TEXT) -> str:
    """Read a UTF-8 file of at most ``largest`` bytes."""
    try:
        return read_bytes(path, mend, largest=largest).decode("utf-8-sig")  # of Windows' editors
    except UnicodeDecodeError as error:
        where = f"is not UTF-8 (byte {error.start})"
        raise BadInput(str(path), where, "save it as UTF-8") from None


def parse_json(where: str, text: str, mend: str = "make it again") -> Any:
    """Read JSON of finite numbers, and text that can be shown; ``where`` names it in messages."""
    try:
        found = json.loads(text, parse_float=_number, parse_int=_whole, parse_constant=_refuse)
        for one in _texts(found):
            if not _SHOWN.fullmatch(one):
                raise ValueError(f"{one[:40]!r} cannot be shown")
        return found
    except json.JSONDecodeError as error:
        why = f"{error.msg} in line {error.lineno}"
    except (ValueError, RecursionError) as error:
        why = str(error)
    raise BadInput(where, f"is not valid JSON ({why})", mend)


def read_json(path: Path, mend: str = "make it again", *, largest: int = LARGEST_TEXT) -> Any:
    """Read a JSON file of at most ``largest`` bytes."""
    return parse_json(str(path), read_text(path, mend, largest=largest), mend)


@contextmanager
def opened_hdf5(path: Path, mend: str = "check the name") -> Iterator[h5py.File]:
    """Open an HDF5 file to read; whatever the library says of a damaged one is bad input."""
    import h5py  # takes long, which only reading HDF5 should cost

    check_ordinary(path, mend)
    try:
        with h5py.File(path, "r") as file:
            yield file
    except (OSError, KeyError, TypeError, ValueError, RuntimeError, AttributeError) as error:
        why = f"is no whole file of its kind ({type(error).__name__}: {error})"
        raise BadInput(str(path), why, mend) from None


def check_size(size: int, what: str = "an array") -> None:
    """Refuse so many bytes of one array; asked before there is room made for them."""
    if size > LARGEST_ARRAY:
        most = f"more than {LARGEST_ARRAY / 2**20:.0f}"
        raise ValueError(f"{what} of {size / 2**20:.0f} MiB, {most}")


def array_of(dataset: h5py.Dataset) -> NDArray[Any]:
    """Read a dataset whole; ``ValueError`` where it is none.

    Its size is known before, and that of the pieces that are unpacked one at a time.
    """
    import h5py

    if not isinstance(dataset, h5py.Dataset) or dataset.shape is None:
        raise ValueError("no array")
    if dataset.external is not None or dataset.is_virtual:
        raise ValueError("an array that lies in another file")
    size = math.prod(dataset.shape) * dataset.dtype.itemsize
    check_size(size)
    check_size(math.prod(dataset.chunks or (1,)) * dataset.dtype.itemsize, "pieces")
    if size > _PACKED * max(dataset.id.get_storage_size(), 2**10):
        raise ValueError(f"an array of {size / 2**20:.0f} MiB that are not there")
    return np.asarray(dataset[()])


def _number(text: str) -> float:
    """Read a number that can still be squared; what is next to nothing is nothing."""
    found = float(text)
    if abs(found) > LARGEST_NUMBER:
        raise ValueError(f"{text[:20]} is too large")
    return found if abs(found) > 1.0 / LARGEST_NUMBER**2 else 0.0


def _whole(text: str) -> int:
    _number(text)
    return int(text)


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is no number")


def _texts(found: Any) -> Iterator[str]:
    """Give every text in what JSON held, keys too."""
    if isinstance(found, str):
        yield found
    elif isinstance(found, dict | list):
        for one in found:
            yield from _texts(one)
        if isinstance(found, dict):
            yield from _texts([*found.values()])


def unreadable(path: Path, error: Exception) -> BadInput:
    """Say why the system does not give a file that is there."""
    if isinstance(error, PermissionError):
        return BadInput(str(path), "no permission to read it", "change the file's permissions")
    why = getattr(error, "strerror", None) or str(error)
    return BadInput(str(path), f"cannot be read ({why})", "check its name and the disk")
