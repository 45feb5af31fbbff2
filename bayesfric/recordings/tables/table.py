"""A table of numbers as it stands in a file, with names for what is wrong in it."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.errors import BadInput

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_MOST_NAMES = 20
_MOST_COLUMNS = 10_000
_LONGEST_NAME = 60


def is_number(text: str, decimal: str = ".") -> bool:
    """Tell whether a cell's text is a plain decimal number.

    Parameters
    ----------
    text
        The cell.
    decimal
        The decimal mark.

    Returns
    -------
    bool
        True for ``"1"``, ``"-2.5e-3"``; False for ``""``, ``"nan"``, ``"0x1F"``, ``"1_0"``.
    """
    text = text.strip()
    if decimal != ".":
        if "." in text:
            return False
        text = text.replace(decimal, ".")
    return _NUMBER.fullmatch(text) is not None


@dataclass(frozen=True)
class Table:
    """Columns of one file.

    Parameters
    ----------
    path
        The file.
    names
        One name a column, empty for a column without one.
    load
        Gives the raw cells of a column by its index from 0: a numeric array (n,), or an object
        array (n,) if some cell is no number.
    first_line
        Line of the first row in a text file, from 1; None for other formats.
    lines
        Line of every row (n,), if they do not simply follow each other.
    header_line
        Line of the header, if there is one.
    decimal
        Decimal mark of cells that are text.
    notes
        One sentence for every choice made in reading.
    """

    path: Path
    names: tuple[str, ...]
    load: Callable[[int], NDArray[Any]]
    first_line: int | None = None
    lines: NDArray[np.int64] | None = None
    header_line: int | None = None
    decimal: str = "."
    notes: tuple[str, ...] = ()

    def row(self, index: int) -> str:
        """Name a row the way a user counts.

        Parameters
        ----------
        index
            Row from 0.

        Returns
        -------
        str
            Such as ``"row 17 (line 31)"``, or ``"row 17"`` if the file has no lines.
        """
        if self.lines is not None:
            return f"row {index + 1} (line {int(self.lines[index])})"
        if self.first_line is not None:
            return f"row {index + 1} (line {self.first_line + index})"
        return f"row {index + 1}"

    def label(self, key: str | int) -> str:
        """Return ``"file, column 'name'"`` for messages."""
        shown = f"'{key}'" if isinstance(key, str) else str(key)
        return f"{self.path}, column {shown}"

    def column(self, key: str | int) -> NDArray[np.float64]:
        """Return a column's numbers.

        Parameters
        ----------
        key
            Name, or number from 1.

        Returns
        -------
        numpy.ndarray
            Finite values as they stand in the file, shape (n,).

        Raises
        ------
        BadInput
            If there is no such column, or a cell is empty, no number, NaN or infinite.
        """
        cells = self.load(self.place(key))
        if cells.ndim != 1:
            shape = " x ".join(str(n) for n in cells.shape) or "one value"
            raise BadInput(
                self.label(key), f"is no vector but {shape}", "give a vector of one value a sample"
            )
        if cells.dtype.kind in "biuf":
            with np.errstate(all="ignore"):  # a long double may become infinite
                values = cells.astype(np.float64)
        elif cells.dtype.kind == "O":
            values = self._numbers(cells, key)
        else:
            raise BadInput(
                self.label(key), f"holds {cells.dtype.name}, not numbers", "export it as numbers"
            )
        finite = np.isfinite(values)
        if not finite.all():
            index = int(np.argmin(finite))
            raise self._bad_cell(key, index, f"holds {_shown(cells[index])}, not a finite number")
        return values

    def _numbers(self, cells: NDArray[Any], key: str | int) -> NDArray[np.float64]:
        values = np.empty(len(cells))
        for index, cell in enumerate(cells):
            if isinstance(cell, str):
                if not is_number(cell, self.decimal):
                    raise self._bad_cell(key, index, _complaint(cell))
                cell = cell.strip().replace(self.decimal, ".")
            elif cell is None:
                raise self._bad_cell(key, index, "is empty")
            elif not isinstance(cell, bool | int | float | np.integer | np.floating | np.bool_):
                raise self._bad_cell(key, index, f"holds {_shown(cell)}, not a number")
            try:
                values[index] = float(cell)
            except (OverflowError, TypeError) as error:
                raise self._bad_cell(key, index, f"holds {_shown(cell)}, not a number") from error
        return values

    def _bad_cell(self, key: str | int, index: int, what: str) -> BadInput:
        mend = "correct the cell, or cut the row out of the file"
        if self.decimal == "." and re.search(r"'[+-]?\d+,\d+'", what):
            mend = 'set decimal = "," if the comma is the decimal mark'
        return BadInput(f"{self.label(key)}, {self.row(index)}", what, mend)

    def place(self, key: str | int) -> int:
        """Give the place of a column among the others, from 0.

        Raises
        ------
        BadInput
            If there is none of that name or number.
        """
        named = [name for name in self.names if name]
        if isinstance(key, int):
            if 1 <= key <= len(self.names):
                return key - 1
            raise BadInput(
                self.label(key),
                f"does not exist, the file has {len(self.names)} columns",
                f"give a number from 1 to {len(self.names)}",
            )
        if key in self.names and key:
            return self.names.index(key)
        if not named:
            raise BadInput(
                self.label(key),
                "does not exist, the columns have no names",
                f"give a number from 1 to {len(self.names)}",
            )
        line = f" (header in line {self.header_line})" if self.header_line is not None else ""
        raise BadInput(
            self.label(key), f"does not exist{line}", f"{_nearest(key, named)}{_listed(named)}"
        )


def check_names(path: Path, names: Sequence[str], where: str = "header") -> None:
    """Refuse two columns of one name, and more columns than a recording has.

    Parameters
    ----------
    path
        The file.
    names
        The columns' names; empty ones do not count.
    where
        What holds the names.

    Raises
    ------
    BadInput
        If a name comes twice, or there are more than 10 000.
    """
    if len(names) > _MOST_COLUMNS:
        raise BadInput(
            f"{path}, {where}",
            f"has {len(names)} columns, more than {_MOST_COLUMNS}",
            "save only the recording's columns, one row a sample",
        )
    seen: dict[str, int] = {}
    for number, name in enumerate(names, start=1):
        if name and name in seen:
            raise BadInput(
                f"{path}, {where}",
                f"columns {seen[name]} and {number} are both named '{name}'",
                "rename one of them",
            )
        seen[name] = number


def _nearest(key: str, names: Sequence[str]) -> str:
    folded = {name.casefold(): name for name in names}
    short = key.casefold()[:_LONGEST_NAME]
    close = difflib.get_close_matches(short, list(folded), n=1, cutoff=0.5)
    return f"did you mean '{folded[close[0]]}'? " if close else ""


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(f"'{name[:_LONGEST_NAME]}'" for name in names[:_MOST_NAMES])
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return f"it has {shown}{more}"


def _shown(cell: object) -> str:
    if isinstance(cell, list | tuple | np.ndarray):
        return "a list"
    if isinstance(cell, dict) or hasattr(cell, "_fieldnames"):
        return "a table"
    text = repr(cell.item() if isinstance(cell, np.generic) else cell)
    return text if len(text) <= 60 else text[:57] + "..."


def _complaint(cell: str) -> str:
    return f"holds {_shown(cell)}, not a number" if cell.strip() else "is empty"
