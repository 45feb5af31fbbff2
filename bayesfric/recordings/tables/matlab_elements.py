"""MATLAB files of version 5 to 7, looked through before they are read."""

from __future__ import annotations

import math
import struct
import zlib

_HEADER = 128
# Types of elements, and classes of arrays: of few numbers, and without dimensions.
_INT32, _MATRIX, _COMPRESSED = 5, 14, 15
_SPARSE, _OPAQUE = 5, 17
_TYPES = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13, _MATRIX, 16, 17, 18}
_DEEPEST = 20


def check_elements(data: bytes) -> None:
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
