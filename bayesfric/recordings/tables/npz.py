"""Reading NumPy archives."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.recordings.tables.reader import Reader, TableOptions
from bayesfric.recordings.tables.table import Table


def read_npz(path: Path, _: TableOptions) -> Table:
    """Read an archive, one column an array, each when asked for; no pickle is opened."""
    with zipfile.ZipFile(path) as archive:
        names = [name.removesuffix(".npy") for name in archive.namelist()]

    def load(index: int) -> np.ndarray[Any, Any]:
        with np.load(path, allow_pickle=False) as arrays:
            return np.squeeze(np.asarray(arrays[names[index]]))

    return Table(str(path), names, load, names_at="archive")


READER = Reader("npz", (".npz",), read_npz)
