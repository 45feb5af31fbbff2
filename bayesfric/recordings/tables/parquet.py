"""Reading Parquet files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.errors import BadInput
from bayesfric.recordings.tables.npz import LARGEST, LARGEST_COLUMN
from bayesfric.recordings.tables.table import Table, check_names


def read_parquet(path: Path) -> Table:
    """Read a Parquet file.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Table
        One column a field; columns are read when asked for.

    Raises
    ------
    BadInput
        For a damaged file, one larger than 4 GiB unpacked, more than 2**25 rows, doubled
        names, or a column asked for that holds lists, tables, times or bytes.
    """
    # pyarrow takes long to import, which only reading Parquet should cost
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            names = [str(name) for name in file.schema_arrow.names]
            groups = [file.metadata.row_group(i) for i in range(file.metadata.num_row_groups)]
            size = sum(int(group.total_byte_size) for group in groups)
            rows = int(file.metadata.num_rows)
            types = list(file.schema_arrow.types)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise _damaged(path, error) from error
    check_names(path, names, "schema")
    # repeated values take no room in the file, but their rows do in memory
    if rows > LARGEST_COLUMN // 8:
        raise BadInput(
            str(path),
            f"has {rows} rows, more than {LARGEST_COLUMN // 8}",
            "split the recording",
        )
    if size > LARGEST:
        raise BadInput(
            str(path),
            f"would unpack to {size / 2**30:.1f} GiB, more than {LARGEST / 2**30:.0f} GiB",
            "save only the recording's columns",
        )

    def load(index: int) -> NDArray[Any]:
        kind = types[index]
        is_any = (pa.types.is_nested, pa.types.is_temporal, pa.types.is_binary)
        if any(is_kind(kind) for is_kind in is_any):
            raise BadInput(
                f"{path}, column '{names[index]}'",
                f"holds {str(kind)[:60]}, not numbers",
                "export it as numbers",
            )
        try:
            with pq.ParquetFile(path) as file:
                # by name: a name with a dot also selects a field inside a table
                column = file.read(columns=[names[index]]).column(names[index])
            if column.null_count:
                return np.array(column.to_pylist(), dtype=object)
            if pa.types.is_decimal(column.type):
                return np.array([float(value) for value in column.to_pylist()])
            return np.asarray(column.to_numpy())
        except (pa.ArrowException, OSError, ValueError, KeyError) as error:
            raise _damaged(path, error) from error

    return Table(path=path, names=tuple(names), load=load)


def _damaged(path: Path, error: Exception) -> BadInput:
    return BadInput(
        str(path),
        f"is not a readable Parquet file ({type(error).__name__}: {error})",
        "export it again; the file may be cut off",
    )
