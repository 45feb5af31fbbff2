"""What every reader of a format registers, and what a user may say of a file's layout."""

from __future__ import annotations

import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from bayesfric.errors import Unfit
from bayesfric.recordings.tables.table import Table

_DELIMITERS = "\t !#$%&'()*,/:;<=>?@[\\]^_`{|}~"


class Options(BaseModel):
    """Options that refuse keys they do not know."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class TableOptions(Options):
    """How a file is laid out."""

    format: str | None = Field(
        default=None, description="File format; found from the suffix if left out."
    )
    delimiter: str | None = Field(
        default=None,
        description="Text: the character between columns, or 'tab' or 'whitespace'; found by "
        "itself if left out.",
    )
    header: bool | None = Field(
        default=None,
        description="Text: whether the first line names the columns; found by itself if left out.",
    )
    decimal: Literal[".", ","] = Field(default=".", description="Text: decimal mark.")
    skip_rows: int = Field(
        default=0, ge=0, description="Text: lines to skip at the beginning of the file."
    )
    table: str | None = Field(
        default=None,
        description="Nested files: dotted path of keys (or structs) to the rows or columns.",
    )

    @field_validator("format")
    @classmethod
    def _registered(cls, value: str | None) -> str | None:
        if value is not None and value not in readers():
            raise Unfit(f"one of {', '.join(readers())}", f"got '{value}'")
        return value

    @field_validator("delimiter")
    @classmethod
    def _one_character(cls, value: str | None) -> str | None:
        if value is not None and len(value) != 1 and value not in ("tab", "whitespace"):
            raise Unfit("one character, 'tab' or 'whitespace'", f"got '{value}'")
        if value is not None and len(value) == 1 and value not in _DELIMITERS:
            raise ValueError(f"'{value}' is part of numbers, or no delimiter of text files")
        return value

    @model_validator(mode="after")
    def _two_marks(self) -> Self:
        if self.delimiter is not None and self.delimiter == self.decimal:
            raise ValueError(f"'delimiter' and 'decimal' are both '{self.decimal}'")
        return self


@dataclass(frozen=True)
class Reader:
    """A format of files: its name, its suffixes, and what reads it.

    ``whole`` tells that a file is read at once, which takes several times its size in memory.
    """

    name: str
    suffixes: tuple[str, ...]
    read: Callable[[Path, TableOptions], Table]
    whole: bool = False


@cache
def readers() -> dict[str, Reader]:
    """Find the readers: what every module of this folder calls ``READER``, by name."""
    package = import_module("bayesfric.recordings.tables")
    names = (f"{package.__name__}.{m.name}" for m in pkgutil.iter_modules(package.__path__))
    found = (getattr(import_module(name), "READER", None) for name in names)
    return {reader.name: reader for reader in found if isinstance(reader, Reader)}
