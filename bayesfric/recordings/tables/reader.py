"""Open a file of any registered format as a table, with the keys of its layout."""

from __future__ import annotations

import hashlib
import pkgutil
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, Self

from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from bayesfric.base.errors import BadInput, Unfit
from bayesfric.base.options import Options
from bayesfric.base.safe_read import check_file, unreadable
from bayesfric.recordings.tables.table import Table


def _name_formats(schema: dict[str, Any]) -> None:
    schema["enum"] = list(readers())


class TableOptions(Options):
    """How a file is laid out."""

    format: str | None = Field(
        None,
        description="File format; by the suffix if left out.",
        json_schema_extra=_name_formats,
    )
    delimiter: Literal[",", ";", ":", "|", " ", "\t", "tab", "whitespace"] | None = Field(
        None,
        description="Text: the character between columns, or 'tab' or 'whitespace'; detected "
        "if left out.",
    )
    decimal: Literal[".", ","] = Field(".", description="Text: decimal mark.")
    skip_rows: int = Field(0, ge=0, description="Text: lines to skip at the beginning of the file.")
    table: str | None = Field(
        None,
        description="Nested files: dotted path of keys (or structs) to the rows or columns, "
        "HDF5's path of groups, or the topic of a ROS bag.",
    )
    where: dict[str, bool | int | float | str] = Field(
        default_factory=dict,
        description="Use only the rows in which columns equal values, such as one episode of "
        "many: { episode_index = 3 }.",
    )

    @field_validator("format")
    @classmethod
    def _registered(cls, value: str | None) -> str | None:
        if value is not None and value not in readers():
            raise Unfit(f"one of {', '.join(readers())}", f"got '{value}'")
        return value

    @model_validator(mode="after")
    def _two_marks(self) -> Self:
        if self.delimiter is not None and self.delimiter == self.decimal:
            raise ValueError(f"'delimiter' and 'decimal' are both '{self.decimal}'")
        return self


@dataclass(frozen=True)
class Reader:
    """A file format; ``mark`` is the file in a folder that is read as one recording."""

    name: str
    suffixes: tuple[str, ...]
    read: Callable[[Path, TableOptions], Table]
    mark: str | None = None


@cache
def readers() -> dict[str, Reader]:
    """Collect the ``READERS`` of every module of this folder, by name."""
    package = import_module("bayesfric.recordings.tables")
    names = (f"{package.__name__}.{m.name}" for m in pkgutil.iter_modules(package.__path__))
    modules = (import_module(name) for name in names)
    return {r.name: r for module in modules for r in getattr(module, "READERS", ())}


def read_table(path: Path, options: TableOptions) -> Table:
    """Open a recorded file; its columns are checked when read.

    The format goes by the suffix unless ``options`` give it.
    """
    known = readers()
    by_suffix = {suffix: r for r in known.values() for suffix in r.suffixes}
    by_folder = next((r for r in known.values() if _is_folder_of(r, path)), None)
    reader = known[options.format] if options.format else by_folder
    reader = reader or by_suffix.get(path.suffix.lower())
    if reader is None or not _is_folder_of(reader, path):
        hint = "give a file, a pattern such as '*.csv', or the folder of a ROS 2 bag"
        if check_file(path, hint) == 0:
            raise BadInput(str(path), "is empty", "check whether the recorder wrote anything")
    if reader is None:
        problem = f"the suffix '{path.suffix}' is of no known format"
        raise BadInput(str(path), problem, f"set format to {', '.join(known)}")
    with _damage_named(path, reader.name):
        table = reader.read(path, options)

    def load(index: int) -> NDArray[Any]:
        with _damage_named(path, reader.name, table.label(table.names[index] or index + 1)):
            return table.load(index)

    return replace(table, load=load).only(options.where)


def read_text(path: Path) -> str:
    """Return a file's text, which must be UTF-8, or UTF-16 with a byte order mark."""
    data = path.read_bytes()
    kind = "UTF-16" if data.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) else "UTF-8"
    try:
        return data.decode("utf-16" if kind == "UTF-16" else "utf-8-sig")
    except UnicodeDecodeError as error:
        where = f"{path}, byte {error.start}"
        raise BadInput(where, f"is not {kind} text", "save it as UTF-8") from error


@contextmanager
def _damage_named(path: Path, kind: str, where: str = "") -> Iterator[None]:
    """Turn any error of a library into bad input: damaged files raise dozens of types."""
    try:
        yield
    except BadInput:
        raise
    except PermissionError as error:
        raise unreadable(path, error) from error
    except Exception as error:
        text = str(error).replace(f"{path}/", "")
        text = text if " object at 0x" not in text else "damaged header"
        problem = f"is not a readable {kind} file ({type(error).__name__}: {text})"
        raise BadInput(where or str(path), problem, "export it again; it may be cut off") from error


def is_recording(path: Path) -> bool:
    """Whether something is a file, or a folder that is read as one."""
    return path.is_file() or any(_is_folder_of(r, path) for r in readers().values())


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, or of the names and SHA-256 of a folder's sorted files."""
    try:
        if path.is_dir():
            digest = hashlib.sha256()
            for file in sorted(path.iterdir(), key=lambda file: file.name):
                if file.is_file():
                    digest.update(f"{file.name}\0{sha256(file)}\n".encode())
            return digest.hexdigest()
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise unreadable(path, error) from error


def _is_folder_of(reader: Reader, path: Path) -> bool:
    return reader.mark is not None and path.is_dir() and (path / reader.mark).is_file()
