"""Opening a file of any format as a table."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Literal, Protocol

from bayesfric.errors import BadInput
from bayesfric.recordings.tables.delimited import read_delimited
from bayesfric.recordings.tables.json_rows import read_json
from bayesfric.recordings.tables.layout import TextOptions
from bayesfric.recordings.tables.matlab import read_matlab
from bayesfric.recordings.tables.npz import read_npz
from bayesfric.recordings.tables.ordinary_file import check_ordinary
from bayesfric.recordings.tables.parquet import read_parquet
from bayesfric.recordings.tables.table import Table

Format = Literal["csv", "parquet", "mat", "npz", "json"]

# Formats that are read as a whole, which takes several times their size in memory.
_WHOLE = ("csv", "mat", "json")
_LARGEST_WHOLE = 2**30

_SUFFIXES: dict[str, Format] = {
    ".csv": "csv",
    ".tsv": "csv",
    ".txt": "csv",
    ".dat": "csv",
    ".parquet": "parquet",
    ".mat": "mat",
    ".npz": "npz",
    ".json": "json",
}


class TableOptions(TextOptions, Protocol):
    """The part of a source that says how its file is laid out."""

    @property
    def format(self) -> Format | None:
        """The format, or None to go by the suffix."""

    @property
    def table(self) -> str | None:
        """Where the columns are inside a JSON or MAT file."""


def read_table(path: Path, source: TableOptions) -> Table:
    """Open a recorded file.

    Parameters
    ----------
    path
        The file.
    source
        Its format and layout.

    Returns
    -------
    Table
        Its columns; they are checked when asked for.

    Raises
    ------
    BadInput
        If the file is missing, not allowed, no ordinary file, empty, too large, of unknown
        format, or damaged.
    """
    form = source.format or _SUFFIXES.get(path.suffix.lower())
    size = _check_file(path)
    if form in _WHOLE and size > _LARGEST_WHOLE:
        raise BadInput(
            str(path),
            f"has {size / 2**30:.1f} GiB, more than {_LARGEST_WHOLE / 2**30:.0f} GiB",
            "save its columns as Parquet or NPZ, or split it",
        )
    try:
        match form:
            case "csv":
                return read_delimited(path, source)
            case "mat":
                return read_matlab(path, source.table)
            case "npz":
                return read_npz(path)
            case "json":
                return read_json(path, source.table)
            case "parquet":
                return read_parquet(path)
    except OSError as error:
        raise _unreadable(path, error) from error
    raise BadInput(
        str(path),
        f"the suffix '{path.suffix}' says nothing about its format",
        "set format to csv, parquet, mat, npz or json",
    )


def sha256(path: Path) -> str:
    """Return a file's SHA-256 in hexadecimal.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    str
        64 hexadecimal digits.

    Raises
    ------
    BadInput
        If the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise _unreadable(path, error) from error


def _check_file(path: Path) -> int:
    try:
        size = check_ordinary(path)
        if path.is_dir():
            raise BadInput(str(path), "is a directory", "give a file, or a pattern such as '*.csv'")
        with path.open("rb") as file:
            if not file.read(1):
                raise BadInput(str(path), "is empty", "check whether the recorder wrote anything")
    except OSError as error:
        raise _unreadable(path, error) from error
    return size


def _unreadable(path: Path, error: OSError) -> BadInput:
    if isinstance(error, FileNotFoundError):
        return BadInput(str(path), "does not exist", "check the file's name and folder")
    if isinstance(error, PermissionError):
        return BadInput(str(path), "no permission to read it", "change the file's permissions")
    return BadInput(str(path), f"cannot be read ({error.strerror or error})", "check the disk")
