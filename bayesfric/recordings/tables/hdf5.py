"""Read HDF5 and MATLAB files; MATLAB 7.3 is HDF5."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.base.errors import BadInput
from bayesfric.base.safe_read import read_array
from bayesfric.recordings.tables.json_text import inside
from bayesfric.recordings.tables.reader import Reader, TableOptions
from bayesfric.recordings.tables.table import Table

# MATLAB's text and cells: numbers to HDF5, and no columns.
_NO_NUMBERS = (b"char", b"cell", b"function_handle")


def read_hdf5(path: Path, options: TableOptions) -> Table:
    """Read a file, one column a dataset, named by its path below the group that is the table.

    Without ``options.table``, its path, the only group with datasets, else the whole file. No link
    is followed.
    """
    return _read(path, options.table or "", matlab=False)


def _read(path: Path, table: str, matlab: bool) -> Table:
    # h5py takes long to import, which only reading HDF5 should cost
    import h5py

    datasets: list[str] = []

    def visit(name: str, item: Any) -> None:
        # MATLAB's internal datasets begin with #
        if isinstance(item, h5py.Dataset) and not name.startswith("#"):
            datasets.append(name)

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    if not datasets:
        raise BadInput(str(path), "holds no datasets of numbers", "check the export")
    groups = list(dict.fromkeys(name.rpartition("/")[0] for name in datasets))
    table = table.strip("/") or (groups[0] if len(groups) == 1 else "")
    prefix = f"{table}/" if table else ""
    columns = [name for name in datasets if name.startswith(prefix)]
    if not columns:
        known = ", ".join(f"'{name}'" for name in groups[:20] if name)
        raise BadInput(
            f"{path}, table '{table}'",
            "there is no such group with datasets",
            f"it has {known}" if known else "leave table out",
        )
    names = [name.removeprefix(prefix) for name in columns]

    def load(index: int) -> NDArray[Any]:
        with h5py.File(path, "r") as file:
            return _values(file[columns[index]], f"{path}, column '{names[index]}'", matlab)

    return Table(str(path), names, load, names_at="datasets")


def _values(dataset: Any, where: str, matlab: bool) -> NDArray[Any]:
    words = dataset.attrs.get("MATLAB_class", b"")
    if words in _NO_NUMBERS or dataset.dtype.kind not in "biuf":
        name = words.decode() if isinstance(words, bytes) and words else dataset.dtype.name
        raise BadInput(where, f"holds {name[:60]}, not numbers", "export it as numbers")
    if dataset.shape is None or dataset.attrs.get("MATLAB_empty", 0):
        return np.empty(0)
    try:
        values = read_array(dataset)
    except ValueError as error:
        hint = "save the recording's values alone, one row a sample, in one file"
        raise BadInput(where, f"holds {error}", hint) from None
    # MATLAB stores arrays transposed, and knows no vectors
    return np.squeeze(values.T if matlab else values)


_HDF5_AT = 512


def read_matlab(path: Path, options: TableOptions) -> Table:
    """Read a file, one column a vector; ``options.table`` is a dotted path of structs.

    Objects and functions, which only MATLAB can read, are left out, which is reported.
    """
    with path.open("rb") as file:
        start = file.read(_HDF5_AT + 4)
    if start.startswith(b"MATLAB 7.3") or b"\x89HDF" in (start[:4], start[_HDF5_AT:]):
        return _read(path, (options.table or "").replace(".", "/"), matlab=True)
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabFunction, MatlabOpaque

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # objects have no names, and seem doubled
        content = loadmat(path, simplify_cells=True)
    contents = {key: value for key, value in content.items() if not key.startswith("__")}
    kinds = (MatlabFunction, MatlabOpaque)
    variables = {key: value for key, value in contents.items() if not isinstance(value, kinds)}
    objects = ", ".join(key for key in contents if key not in variables)
    variables = inside(str(path), variables, options.table)
    if not isinstance(variables, dict):
        raise BadInput(f"{path}, table '{options.table}'", "is no struct", "name a struct")
    if not variables:
        problem = "holds only objects and functions" if contents else "holds no variables"
        raise BadInput(str(path), problem, "save the columns as plain arrays")
    values = list(variables.values())
    return Table(
        str(path),
        list(variables),
        lambda index: np.asarray(values[index]),
        names_at="variables",
        notes=(f"objects left out, which only MATLAB reads: {objects}",) if objects else (),
    )


READERS = (Reader("hdf5", (".h5", ".hdf5"), read_hdf5), Reader("mat", (".mat",), read_matlab))
