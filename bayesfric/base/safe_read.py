"""Read ordinary files of bounded size; everything else is bad input, in one line."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.base.errors import BadInput

if TYPE_CHECKING:
    import h5py

# Bytes of one array.
LARGEST_ARRAY = 2**28


def check_file(path: Path, hint: str = "check the name") -> int:
    """Refuse what is not an ordinary file, and return its size in bytes."""
    try:
        str(path).encode()
        size = path.stat().st_size
    except UnicodeEncodeError:  # results could not name it
        raise BadInput(str(path), "its name is not UTF-8", "rename the file or folder") from None
    except FileNotFoundError:
        raise BadInput(str(path), "does not exist", hint) from None
    except (OSError, ValueError) as error:
        raise unreadable(path, error) from None
    if path.is_dir():
        raise BadInput(str(path), "is a folder", hint)
    if not path.is_file():
        raise BadInput(str(path), "is not an ordinary file", "save its output to a file")
    return size


def read_text(path: Path, hint: str = "check the name", *, largest: int = 2**26) -> str:
    """Read a UTF-8 file of at most ``largest`` bytes."""
    if check_file(path, hint) > largest:
        raise BadInput(str(path), f"is larger than {largest / 2**20:.3g} MiB", hint)
    try:
        return path.read_text(encoding="utf-8-sig")  # editors on Windows write a mark
    except OSError as error:
        raise unreadable(path, error) from None
    except UnicodeDecodeError:
        raise BadInput(str(path), "is not UTF-8", "save it as UTF-8") from None


def parse_json(where: str, text: str, hint: str = "make it again") -> Any:
    """Parse JSON; ``where`` names it in messages."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BadInput(where, f"is not valid JSON ({error})", hint) from None


def read_json(path: Path, hint: str = "make it again") -> Any:
    """Read a JSON file."""
    return parse_json(str(path), read_text(path, hint), hint)


@contextmanager
def open_hdf5(path: Path, hint: str = "check the name") -> Iterator[h5py.File]:
    """Open an HDF5 file to read; errors of the library inside the block are bad input."""
    import h5py  # takes long, which only reading HDF5 should cost

    check_file(path, hint)
    try:
        with h5py.File(path, "r") as file:
            yield file
    except (OSError, KeyError, TypeError, ValueError, RuntimeError, AttributeError) as error:
        problem = f"is not a whole file of its kind ({type(error).__name__}: {error})"
        raise BadInput(str(path), problem, hint) from None


def read_array(dataset: h5py.Dataset) -> NDArray[Any]:
    """Read a dataset; ``ValueError`` where it is a group, or too large."""
    import h5py

    if not isinstance(dataset, h5py.Dataset):
        raise ValueError("no array")
    if dataset.nbytes > LARGEST_ARRAY:  # before memory is allocated
        raise ValueError(f"more than {LARGEST_ARRAY / 2**20:.3g} MiB in an array")
    return np.asarray(dataset[()])


def unreadable(path: Path, error: OSError | ValueError) -> BadInput:
    """Word why a file that exists cannot be opened."""
    why = getattr(error, "strerror", None) or str(error)
    return BadInput(str(path), f"cannot be read ({why})", "check its name and permissions")
