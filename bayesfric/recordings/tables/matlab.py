"""Reading MATLAB files."""

from __future__ import annotations

import math
import struct
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.errors import BadInput
from bayesfric.recordings.tables.hdf5 import read_matlab_73
from bayesfric.recordings.tables.reader import Reader, TableOptions
from bayesfric.recordings.tables.table import Table

_HEADER, _HDF5_AT = 128, 512
# Types of elements, and classes of arrays: of few numbers, and without dimensions.
_INT32, _MATRIX, _COMPRESSED = 5, 14, 15
_SPARSE, _OPAQUE = 5, 17
_TYPES = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13, _MATRIX, 16, 17, 18}
_DEEPEST = 20


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

    _check_types(path.read_bytes())
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


def _check_types(data: bytes) -> None:
    """Refuse an element of unknown type, or larger than what it is in.

    SciPy trusts both: one byte that is damaged may end the process, which no ``except`` catches.
    """
    order = {b"IM": "<", b"MI": ">"}.get(data[126:_HEADER])
    if order is None:
        raise ValueError("no MATLAB 5 header")

    def walk(body: bytes, depth: int) -> None:
        place, found = 0, list[tuple[int, bytes]]()
        while place < len(body):
            kind, size = struct.unpack(order + "II", body[place : place + 8])
            begin, step = place + 8, 8 + size
            if kind >> 16:  # short elements carry their values inside the tag
                size, kind, begin, step = kind >> 16, kind & 0xFFFF, place + 4, 8
            elif kind not in (_MATRIX, _COMPRESSED):
                step += -size % 8
            if kind not in _TYPES and not (kind == _COMPRESSED and depth == 0):
                raise ValueError(f"unknown element type {kind}")
            part = body[begin : begin + size]
            if len(part) < size or depth > _DEEPEST:
                raise ValueError("an element is cut off, or nested too deep")
            if kind in (_MATRIX, _COMPRESSED):
                walk(part if kind == _MATRIX else zlib.decompress(part), depth + 1)
            found.append((kind, part))
            place += step
        # beyond its flags an array has dimensions, and no more cells than bytes
        if depth > 0 and len(found) > 1 and found[0][0] != _MATRIX:
            (_, flags), (kind, shape), *_ = found
            size = math.prod(struct.unpack(f"{order}{len(shape) // 4}i", shape[: len(shape) & ~3]))
            fits = kind == _INT32 and len(shape) >= 8 and size <= len(body)
            if not fits and flags[:1] not in (bytes([_SPARSE]), bytes([_OPAQUE])):
                raise ValueError("an array's dimensions do not fit what it holds")

    walk(data[_HEADER:], 0)


READER = Reader("mat", (".mat",), read_matlab)
