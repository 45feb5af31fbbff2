"""Looking over the chunks of a ROS bag before they are unpacked.

rosbags unpacks a chunk as far as it goes, whatever size the bag states: a small file could fill
the memory.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO

from bayesfric.errors import BadInput
from bayesfric.recordings.tables.npz import LARGEST, LARGEST_COLUMN, check_unpacked

# How files begin; rosbags goes by the suffix alone.
_MARKS = {
    ".mcap": b"\x89MCAP0\r\n",
    ".bag": b"#ROSBAG V2.0\n",
    ".db3": b"SQLite format 3\0",
}
_MCAP_CHUNK, _BAG_CHUNK = 0x06, b"\x05"
# A byte of LZ4 stands for no more.
_LZ4 = 255
_PIECE = 2**20
_MODE = re.compile(r"^\s*compression_mode:\s*['\"]?(file|message)", re.IGNORECASE | re.MULTILINE)


def check_chunks(path: Path) -> None:
    """Refuse a bag with a chunk that would unpack to more than it states, or than 256 MiB."""
    if path.is_dir():
        mode = _MODE.search((path / "metadata.yaml").read_text(encoding="utf-8", errors="replace"))
        if mode and mode[1].lower() == "message":
            raise BadInput(
                str(path), "its messages are compressed one by one", "run 'ros2 bag convert' on it"
            )
        for file in sorted(path.iterdir()):
            if mode and file.suffix == ".zstd":
                check_unpacked(file, _unpacked(file))
            elif file.suffix in _MARKS:
                check_chunks(file)
        return
    suffix = path.suffix.lower()
    mark = _MARKS.get(suffix)
    with path.open("rb") as opened:
        if mark is None or opened.read(len(mark)) != mark:
            known = ", ".join(_MARKS)
            raise BadInput(
                str(path),
                f"does not begin as {f'a {suffix} file' if mark else 'a ROS bag'} does",
                f"check the file; suffixes are {known}",
            )
        chunks = {".mcap": _mcap_chunks, ".bag": _bag_chunks}.get(suffix, lambda _: iter(()))
        for kind, size, packed in chunks(opened):
            if size > LARGEST_COLUMN or _exceeds(kind, size, packed):
                raise BadInput(
                    str(path),
                    f"has a chunk that unpacks to more than {min(size, LARGEST_COLUMN)} bytes",
                    "record it in smaller chunks",
                )


def _mcap_chunks(file: BinaryIO) -> Iterator[tuple[str, int, bytes]]:
    """Give compression, stated size and content of every compressed chunk."""
    while len(head := file.read(9)) == 9:
        length = struct.unpack("<Q", head[1:])[0]
        if head[0] != _MCAP_CHUNK:
            file.seek(min(length, 2**62), 1)
            continue
        end = file.tell() + length
        _, _, size, _, word = struct.unpack("<QQQII", file.read(32).ljust(32, b"\0"))
        kind = file.read(min(word, 16)).decode("latin-1")
        packed = struct.unpack("<Q", file.read(8).ljust(8, b"\0"))[0]
        if kind:
            yield kind, size, file.read(min(packed, LARGEST_COLUMN))
        file.seek(min(end, 2**62))


def _bag_chunks(file: BinaryIO) -> Iterator[tuple[str, int, bytes]]:
    while len(head := file.read(4)) == 4:
        fields = {}
        header = file.read(min(struct.unpack("<I", head)[0], _PIECE))
        while len(header) >= 4:
            length = struct.unpack("<I", header[:4])[0]
            key, _, value = header[4 : 4 + length].partition(b"=")
            fields[key] = value
            header = header[4 + length :]
        length = struct.unpack("<I", file.read(4).ljust(4, b"\0"))[0]
        end = file.tell() + length
        kind = fields.get(b"compression", b"none").decode("latin-1")
        if fields.get(b"op") == _BAG_CHUNK and kind != "none":
            size = int.from_bytes(fields.get(b"size", b"")[:4], "little")
            yield kind, size, file.read(min(length, LARGEST_COLUMN))
        file.seek(end)


def _exceeds(kind: str, size: int, packed: bytes) -> bool:
    """Whether a chunk unpacks to more than ``size`` bytes; what is damaged rosbags will tell."""
    if kind == "lz4" and _LZ4 * len(packed) <= LARGEST_COLUMN:
        return False
    try:
        unpacker = _unpacker(kind)
        if len(unpacker.decompress(packed, size + 1)) > size:
            return True
        # a second stream behind the first would be unpacked, too
        return bool(unpacker.unused_data)
    except Exception:  # each compression has errors of its own
        return False


def _unpacker(kind: str) -> Any:
    if kind == "bz2":
        from bz2 import BZ2Decompressor

        return BZ2Decompressor()
    if kind == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        return LZ4FrameDecompressor()
    # in the standard library since Python 3.14
    there = "compression.zstd" if find_spec("compression") else "backports.zstd"
    return import_module(there).ZstdDecompressor()


def _unpacked(path: Path) -> int:
    """Count the bytes that a file of one stream unpacks to, as far as a file may."""
    unpacker, count = _unpacker("zstd"), 0
    with path.open("rb") as file:
        while count <= LARGEST and (piece := file.read(_PIECE)):
            count += len(unpacker.decompress(piece, _PIECE))
            while not unpacker.needs_input and not unpacker.eof and count <= LARGEST:
                count += len(unpacker.decompress(b"", _PIECE))
            if unpacker.eof:
                return count + (LARGEST if unpacker.unused_data or file.read(1) else 0)
    return count
