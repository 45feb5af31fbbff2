"""Reading NumPy archives."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.errors import BadInput
from bayesfric.recordings.tables.reader import Reader, TableOptions
from bayesfric.recordings.tables.table import Table

# Bytes when unpacked, of all columns and of one: 2**25 numbers are nine hours at 1 kHz.
LARGEST = 4 * 2**30
LARGEST_COLUMN = 2**28


def read_npz(path: Path, _: TableOptions) -> Table:
    """Read an archive, one column an array, each when asked for.

    Promised to hostile input: nothing is unpacked before its size is known (4 GiB in all, 256 MiB
    an array), and no pickle is opened.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            sizes = [entry.file_size for entry in archive.infolist()]
            names = [entry.filename.removesuffix(".npy") for entry in archive.infolist()]
    except OSError:
        raise
    except Exception as error:  # zipfile raises struct.error, NotImplementedError ... when damaged
        raise _damaged(path, error) from error
    check_unpacked(path, sum(sizes))
    if not names:
        raise BadInput(str(path), "holds no arrays", "check the export")

    def load(index: int) -> np.ndarray[Any, Any]:
        if sizes[index] > LARGEST_COLUMN:
            raise BadInput(
                f"{path}, column '{names[index]}'",
                f"would unpack to {sizes[index] / 2**20:.0f} MiB, "
                f"more than {LARGEST_COLUMN / 2**20:.0f} MiB",
                "split the recording",
            )
        try:
            with np.load(path, allow_pickle=False) as arrays:
                return np.squeeze(np.asarray(arrays[names[index]]))
        except Exception as error:  # EOFError, RuntimeError, tokenize.TokenError ... when damaged
            if "pickle" in str(error).lower() or "object array" in str(error).lower():
                raise BadInput(
                    f"{path}, column '{names[index]}'",
                    "is a pickled array, which could run foreign code",
                    "save it as an array of numbers",
                ) from error
            raise _damaged(path, error) from error

    return Table(str(path), names, load, names_at="archive")


def check_unpacked(path: Path, size: int) -> None:
    """Refuse a file of more than 4 GiB when unpacked."""
    if size > LARGEST:
        raise BadInput(
            str(path),
            f"would unpack to {size / 2**30:.1f} GiB, more than {LARGEST / 2**30:.0f} GiB",
            "save only the recording's columns",
        )


def _damaged(path: Path, error: Exception) -> BadInput:
    # numpy shows the parsed header as Python's own objects
    reason = "its header is no numpy header" if " object at " in str(error) else str(error)
    return BadInput(
        str(path),
        f"is not a readable NPZ file ({type(error).__name__}: {reason})",
        "save it again with numpy.savez",
    )


READER = Reader("npz", (".npz",), read_npz)
