"""Reading NumPy archives."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.errors import BadInput
from bayesfric.recordings.tables.table import Table, check_names

LARGEST = 4 * 2**30
# 2**25 numbers: nine hours at 1 kHz
LARGEST_COLUMN = 2**28


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
        For a damaged file, one larger than 4 GiB unpacked, an array larger than 256 MiB,
        doubled names, or pickled arrays.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            sizes = [entry.file_size for entry in archive.infolist()]
            names = [entry.filename.removesuffix(".npy") for entry in archive.infolist()]
    except OSError:
        raise
    except Exception as error:  # zipfile raises struct.error, NotImplementedError ... when damaged
        raise _damaged(path, error) from error
    size = sum(sizes)
    if size > LARGEST:
        raise BadInput(
            str(path),
            f"would unpack to {size / 2**30:.1f} GiB, more than {LARGEST / 2**30:.0f} GiB",
            "save only the recording's arrays",
        )
    if not names:
        raise BadInput(str(path), "holds no arrays", "check the export")
    check_names(path, names, "archive")

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

    return Table(path=path, names=tuple(names), load=load)


def _damaged(path: Path, error: Exception) -> BadInput:
    # numpy shows the parsed header as Python's own objects
    reason = "its header is no numpy header" if " object at " in str(error) else str(error)
    return BadInput(
        str(path),
        f"is not a readable NPZ file ({type(error).__name__}: {reason})",
        "save it again with numpy.savez",
    )
