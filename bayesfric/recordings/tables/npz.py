"""Reading NumPy archives."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.errors import BadInput
from bayesfric.recordings.tables.table import Table

LARGEST = 4 * 2**30


def read_npz(path: Path) -> Table:
    """Read a NumPy archive.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Table
        One column an array; arrays are read when asked for.

    Raises
    ------
    BadInput
        For a damaged file, one larger than 4 GiB unpacked, or pickled arrays.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
            names = [entry.filename.removesuffix(".npy") for entry in archive.infolist()]
    except (zipfile.BadZipFile, OSError, ValueError) as error:
        raise _damaged(path, error) from error
    if size > LARGEST:
        raise BadInput(
            str(path),
            f"would unpack to {size / 2**30:.1f} GiB, more than {LARGEST / 2**30:.0f} GiB",
            "save only the recording's arrays",
        )
    if not names:
        raise BadInput(str(path), "holds no arrays", "check the export")

    def load(index: int) -> np.ndarray[Any, Any]:
        try:
            with np.load(path, allow_pickle=False) as arrays:
                return np.squeeze(np.asarray(arrays[names[index]]))
        except (
            zipfile.BadZipFile,
            zlib.error,
            OSError,
            ValueError,
            KeyError,
            MemoryError,
        ) as error:
            if "pickle" in str(error).lower() or "object array" in str(error).lower():
                raise BadInput(
                    f"{path}, column '{names[index]}'",
                    "is a pickled array, which could run foreign code",
                    "save it as an array of numbers",
                ) from error
            raise _damaged(path, error) from error

    return Table(path=path, names=tuple(names), load=load)


def _damaged(path: Path, error: Exception) -> BadInput:
    return BadInput(
        str(path),
        f"is not a readable NPZ file ({type(error).__name__}: {error})",
        "save it again with numpy.savez",
    )
