"""Read one NumPy array: a structured one by its fields' names, a matrix by columns' numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.base.errors import BadInput
from bayesfric.base.safe_read import check_size
from bayesfric.recordings.tables.reader import Reader, TableOptions
from bayesfric.recordings.tables.table import Table


def read_npy(path: Path, _: TableOptions) -> Table:
    """Map a file, one column a field or a column; no pickle is opened."""
    array = np.load(path, mmap_mode="r", allow_pickle=False)
    fields = array.dtype.names
    if array.ndim != (1 if fields else 2):
        problem = f"holds an array of shape {array.shape}"
        raise BadInput(str(path), problem, "save a structured array (n,), or numbers (n, columns)")

    def load(index: int) -> NDArray[Any]:
        column = array[fields[index]] if fields else array[:, index]
        check_size(column.nbytes)
        return np.array(column)

    names = fields or ("",) * array.shape[1]
    return Table(str(path), names, load, names_at="fields", by_rows=True)


READERS = (Reader("npy", (".npy",), read_npy),)
