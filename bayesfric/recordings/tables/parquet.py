"""Read Parquet files and NumPy archives."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.base.errors import BadInput
from bayesfric.base.safe_read import check_size
from bayesfric.recordings.tables.reader import Reader, TableOptions
from bayesfric.recordings.tables.table import Table


def read_parquet(path: Path, _: TableOptions) -> Table:
    """Read a file, one column a field, each when asked for."""
    # pyarrow takes long to import, which only reading Parquet should cost
    import pyarrow as pa
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        names = [str(name) for name in file.schema_arrow.names]
        types = list(file.schema_arrow.types)

    def load(index: int) -> NDArray[Any]:
        kind = types[index]
        lists = pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind)
        lists = lists or pa.types.is_large_list(kind)
        is_any = (pa.types.is_nested, pa.types.is_temporal, pa.types.is_binary)
        plain = kind.value_type if lists else kind
        if any(is_kind(plain) for is_kind in is_any):
            problem = f"holds {str(kind)[:60]}, not numbers"
            raise BadInput(f"{path}, column '{names[index]}'", problem, "export it as numbers")
        with pq.ParquetFile(path) as file:
            check_size(8 * _count(file.metadata, names[index]))
            # by name: a name with a dot also selects a field inside a table
            column = file.read(columns=[names[index]]).column(names[index])
        if lists:
            return _matrix(column)
        if column.null_count:
            return np.array(column.to_pylist(), dtype=object)
        if pa.types.is_decimal(column.type):
            return np.array([float(value) for value in column.to_pylist()])
        return np.asarray(column.to_numpy())

    return Table(str(path), names, load, names_at="schema", by_rows=True)


def _count(metadata: Any, name: str) -> int:
    """Count a column's numbers by the metadata: a small file may repeat a value forever."""
    groups = (metadata.row_group(k) for k in range(metadata.num_row_groups))
    parts = (group.column(k) for group in groups for k in range(group.num_columns))
    return sum(
        part.num_values for part in parts if f"{part.path_in_schema}.".startswith(f"{name}.")
    )


def _matrix(column: Any) -> NDArray[Any]:
    """Take lists of one length as an array (n, k); others as they are, to be named."""
    import pyarrow.compute as pc

    lengths = pc.unique(pc.list_value_length(column)).to_pylist()
    flat = pc.list_flatten(column)
    if len(lengths) != 1 or not lengths[0] or flat.null_count:
        return np.array(column.to_pylist(), dtype=object)
    return np.asarray(flat.to_numpy()).reshape(-1, lengths[0])


def read_npz(path: Path, _: TableOptions) -> Table:
    """Read an archive, one column an array, each when asked for; no pickle is opened."""
    with zipfile.ZipFile(path) as archive:
        names = [name.removesuffix(".npy") for name in archive.namelist()]
        sizes = [member.file_size for member in archive.infolist()]

    def load(index: int) -> np.ndarray[Any, Any]:
        check_size(sizes[index])
        with np.load(path, allow_pickle=False) as arrays:
            return np.squeeze(np.asarray(arrays[names[index]]))

    return Table(str(path), names, load, names_at="archive")


READERS = (Reader("parquet", (".parquet",), read_parquet), Reader("npz", (".npz",), read_npz))
