"""Reading MATLAB files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.errors import BadInput
from bayesfric.recordings.tables.matlab_structure import check_structure
from bayesfric.recordings.tables.reader import Reader, TableOptions
from bayesfric.recordings.tables.table import Table

# All variables are unpacked, whichever are used.
_LARGEST = 2**29


def read_matlab(path: Path, options: TableOptions) -> Table:
    """Read a file of version 5 to 7, one column a vector of any orientation.

    Promised to hostile input: its structure is walked before scipy sees it, and no more than
    512 MiB are unpacked.
    """
    with path.open("rb") as file:
        start = file.read(128)
    if start.startswith(b"MATLAB 7.3") or b"\x89HDF" in start:
        raise BadInput(str(path), "is a MATLAB 7.3 file", "save it with save(..., '-v7')")
    from scipy.io import loadmat

    try:
        check_structure(path.read_bytes(), _LARGEST)
        content = loadmat(path, squeeze_me=True, struct_as_record=False)
    except Exception as error:  # scipy raises struct.error, zlib.error, TypeError ... when damaged
        raise BadInput(
            str(path),
            f"is not a readable MAT file ({type(error).__name__}: {error})",
            "export it again with save(..., '-v7')",
        ) from error
    variables = {key: value for key, value in content.items() if not key.startswith("__")}
    if options.table is not None:
        variables = _struct(path, variables, options.table)
    if not variables:
        raise BadInput(str(path), "holds no variables", "check the export")
    values = list(variables.values())

    def load(index: int) -> np.ndarray[Any, Any]:
        return np.asarray(values[index])

    return Table(str(path), list(variables), load, names_at="variables")


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


READER = Reader("mat", (".mat",), read_matlab, whole=True)
