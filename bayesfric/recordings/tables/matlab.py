"""Reading MATLAB files, after checking their structure.

scipy trusts the type numbers in the file: one flipped bit there can end the whole
process with a segmentation fault, which no ``except`` can catch.
"""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from bayesfric.errors import BadInput
from bayesfric.recordings.tables.hdf5 import read_matlab_73
from bayesfric.recordings.tables.reader import Reader, TableOptions
from bayesfric.recordings.tables.table import Table

# All variables are unpacked, whichever are used.
_LARGEST = 2**29
_HEADER = 128
_HDF5_AT = 512
_MATRIX, _COMPRESSED = 14, 15
_INT8, _INT32, _UINT32 = 1, 5, 6
_WIDTHS = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}
_TEXT = {*_WIDTHS, 16, 17, 18}
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE = 1, 2, 3, 4, 5
_NUMERIC = range(6, 16)
_FUNCTION, _OPAQUE = 16, 17
_COMPLEX_FLAG = 0x0800
_DEEPEST = 20
# Cells and fields of structs; each takes scipy a thousand times its room in the file.
_MOST_ARRAYS = 300_000
_MOST_DIMENSIONS = 32


def read_matlab(path: Path, options: TableOptions) -> Table:
    """Read a file of version 5 to 7, one column a vector of any orientation; 7.3 is HDF5.

    Objects and functions beside the columns, which only MATLAB can read, are left out and told.

    Promised to hostile input: its structure is walked before scipy sees it, and no more than
    512 MiB are unpacked.
    """
    with path.open("rb") as file:
        start = file.read(_HDF5_AT + 4)
    if start.startswith(b"MATLAB 7.3") or b"\x89HDF" in (start[:4], start[_HDF5_AT:]):
        return read_matlab_73(path, options)
    from scipy.io import loadmat

    try:
        plain, objects = _check_structure(path.read_bytes(), _LARGEST)
        content = loadmat(path, squeeze_me=True, struct_as_record=False, variable_names=plain)
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
        what = "holds only objects and functions" if objects else "holds no variables"
        raise BadInput(str(path), what, "save the columns as plain arrays")
    values = list(variables.values())

    def load(index: int) -> np.ndarray[Any, Any]:
        return np.asarray(values[index])

    notes = [f"objects left out, which only MATLAB reads: {', '.join(objects)}"] if objects else []
    return Table(str(path), list(variables), load, names_at="variables", notes=tuple(notes))


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


def _check_structure(data: bytes, largest: int) -> tuple[list[str], list[str]]:
    """Walk all elements of a MATLAB 5 to 7 file, and raise an error where one is damaged.

    Gives the names of its plain variables, and of its objects and functions.

    That is one of unknown type, that does not fit in what surrounds it, or claims more than it
    holds. All compressed variables together may unpack to ``largest`` bytes.
    """
    if len(data) < _HEADER or 0 in data[:4]:
        raise ValueError("no MATLAB 5 header")
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        raise ValueError("no byte order mark")
    place = _HEADER
    arrays = _Budget(_MOST_ARRAYS)
    plain, objects = list[str](), list[str]()
    while place < len(data):
        if place + 8 > len(data):
            raise ValueError("cut off in a variable's tag")
        kind, size = struct.unpack(order + "II", data[place : place + 8])
        body = data[place + 8 : place + 8 + size]
        if len(body) < size:
            raise ValueError("cut off in a variable")
        if kind == _COMPRESSED:
            unpacker = zlib.decompressobj()
            body = unpacker.decompress(body, largest)
            if not unpacker.eof:
                raise ValueError("a compressed variable is cut off or too large")
            largest = max(largest - len(body), 1)  # 0 would be no limit
            kind, size = struct.unpack(order + "II", body[:8].ljust(8, b"\0"))
            body = body[8:]
            if len(body) != size:
                raise ValueError("a compressed variable has another size than stated")
        if kind != _MATRIX:
            raise ValueError(f"unknown element type {kind}")
        variable = _Matrix(body, order, 0, arrays)
        variable.check()
        # that without a name is what objects and functions need
        if variable.name:
            (plain if variable.is_plain else objects).append(variable.name)
        place += 8 + struct.unpack(order + "I", data[place + 4 : place + 8])[0]
    return plain, objects


class _Budget:
    """How many arrays a file may still hold."""

    def __init__(self, left: int) -> None:
        self.left = left

    def take(self, count: int) -> None:
        self.left -= count
        if self.left < 0:
            raise ValueError(f"more than {_MOST_ARRAYS} cells or fields")


class _Matrix:
    """One array element, read from its beginning."""

    def __init__(self, body: bytes, order: str, depth: int, arrays: _Budget) -> None:
        self.body, self.order, self.depth, self.arrays = body, order, depth, arrays
        self.place = 0
        self.name, self.is_plain = "", True

    def check(self) -> None:
        if not self.body:
            return  # an empty field of a struct
        if self.depth > _DEEPEST:
            raise ValueError("nested too deep")
        flags = self._element({_UINT32})
        if len(flags) != 8:
            raise ValueError("damaged array flags")
        word = struct.unpack(self.order + "II", flags)[0]
        self.is_plain = word & 0xFF not in (_FUNCTION, _OPAQUE)
        if word & 0xFF == _OPAQUE:  # an object of MATLAB's newer classes has no dimensions
            self.name, *_ = (self._element({_INT8}).decode("latin-1") for _ in range(3))
            self._matrices(1)
            return
        shape = self._integers()
        if not 2 <= len(shape) <= _MOST_DIMENSIONS or any(n < 0 for n in shape):
            raise ValueError("damaged dimensions")
        self.name = self._element({_INT8}).decode("latin-1")
        self._content(word & 0xFF, bool(word & _COMPLEX_FLAG), math.prod(shape))

    def _content(self, kind: int, is_complex: bool, count: int) -> None:
        if kind in _NUMERIC:
            for _ in range(2 if is_complex else 1):
                self._values(count)
        elif kind == _CHAR:
            # scipy fills what is missing with blanks, whatever it takes
            if count > len(self._element(_TEXT)):
                raise ValueError("a text does not fit its dimensions")
        elif kind == _CELL:
            self._matrices(count)
        elif kind == _FUNCTION:
            self._matrices(1)
        elif kind in (_STRUCT, _OBJECT):
            if kind == _OBJECT:
                self._element({_INT8})
            width = self._integers()
            if len(width) != 1 or width[0] < 1:
                raise ValueError("damaged field names")
            names = self._element({_INT8})
            self.arrays.take(count)  # made even without a field
            self._matrices(count * (len(names) // width[0]))
        elif kind == _SPARSE:
            self._integers()
            self._integers()
            for _ in range(2 if is_complex else 1):
                self._element(set(_WIDTHS))
        else:
            raise ValueError(f"array class {kind} is not supported")

    def _values(self, count: int) -> None:
        kind, content = self._next()
        if kind not in _WIDTHS or len(content) != count * _WIDTHS[kind]:
            raise ValueError("an array's values do not fit its dimensions")

    def _integers(self) -> list[int]:
        content = self._element({_INT32})
        if len(content) % 4:
            raise ValueError("damaged integers")
        return list(struct.unpack(f"{self.order}{len(content) // 4}i", content))

    def _matrices(self, count: int) -> None:
        if count > len(self.body):
            raise ValueError("more elements than bytes")
        self.arrays.take(count)
        for _ in range(count):
            _Matrix(self._element({_MATRIX}), self.order, self.depth + 1, self.arrays).check()

    def _element(self, kinds: set[int]) -> bytes:
        kind, content = self._next()
        if kind not in kinds:
            raise ValueError(f"unexpected element type {kind}")
        return content

    def _next(self) -> tuple[int, bytes]:
        if self.place + 8 > len(self.body):
            raise ValueError("cut off in an element's tag")
        kind, size = struct.unpack(self.order + "II", self.body[self.place : self.place + 8])
        if kind >> 16:
            # short elements carry their values inside the tag
            size, kind = kind >> 16, kind & 0xFFFF
            content = self.body[self.place + 4 : self.place + 4 + size]
            if size > 4:
                raise ValueError("a short element is too long")
            self.place += 8
            return kind, content
        content = self.body[self.place + 8 : self.place + 8 + size]
        if len(content) < size:
            raise ValueError("cut off in an element")
        self.place += 8 + size + (-size % 8 if kind != _MATRIX else 0)
        return kind, content


READER = Reader("mat", (".mat",), read_matlab, whole=True)
