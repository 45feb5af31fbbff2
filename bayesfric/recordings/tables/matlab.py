"""Reading MATLAB files."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.errors import BadInput
from bayesfric.recordings.tables.hdf5 import read_matlab_73
from bayesfric.recordings.tables.reader import Reader, TableOptions
from bayesfric.recordings.tables.table import Table

_HDF5_AT = 512


def read_matlab(path: Path, options: TableOptions) -> Table:
    """Read a file of version 5 to 7, one column a vector of any orientation; 7.3 is HDF5.

    Objects and functions beside the columns, which only MATLAB can read, are left out and told.
    """
    with path.open("rb") as file:
        start = file.read(_HDF5_AT + 4)
    if start.startswith(b"MATLAB 7.3") or b"\x89HDF" in (start[:4], start[_HDF5_AT:]):
        return read_matlab_73(path, options)
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabFunction, MatlabOpaque

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # objects have no names, and seem doubled
        content = loadmat(path, squeeze_me=True, struct_as_record=False)
    given = {key: value for key, value in content.items() if not key.startswith("__")}
    kinds = (MatlabFunction, MatlabOpaque)
    variables = {key: value for key, value in given.items() if not isinstance(value, kinds)}
    objects = ", ".join(key for key in given if key not in variables)
    if options.table is not None:
        variables = _struct(path, variables, options.table)
    if not variables:
        what = "holds only objects and functions" if given else "holds no variables"
        raise BadInput(str(path), what, "save the columns as plain arrays")
    values = list(variables.values())
    return Table(
        str(path),
        list(variables),
        lambda index: np.asarray(values[index]),
        names_at="variables",
        notes=(f"objects left out, which only MATLAB reads: {objects}",) if objects else (),
    )


def _struct(path: Path, variables: dict[str, Any], table: str) -> dict[str, Any]:
    for key in table.split("."):
        found = variables.get(key)
        fields = getattr(found, "_fieldnames", None)
        if fields is None:
            kind = "does not exist" if found is None else "is no struct"
            known = ", ".join(f"'{name}'" for name in list(variables)[:20])
            raise BadInput(f"{path}, table '{table}'", f"'{key}' {kind}", f"it has {known}")
        variables = {name: getattr(found, name) for name in fields}
    return variables


READER = Reader("mat", (".mat",), read_matlab)
