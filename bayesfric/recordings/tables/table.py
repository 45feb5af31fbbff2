"""A table of numbers in a file: cells that are not finite numbers are refused with their place."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.base.errors import BadInput, nearest

# possessive, so that it fails at the first wrong character
_NUMBER = re.compile(r"[+-]?(\d++(\.\d*+)?|\.\d++)([eE][+-]?\d++)?")
# Values of a column listed where the requested one is missing.
_MAX_SHOWN = 20
_MOST_COLUMNS = 10_000
_PLAIN = (bool, int, float, np.integer, np.floating, np.bool_)
_ONE_OF_SEVERAL = re.compile(r"(.+)\[(\d{1,9})\]", re.DOTALL)
_LISTS = (list, tuple, np.ndarray)


def is_number(text: str, decimal: str = ".") -> bool:
    """Whether text is a plain decimal number: ``-2.5e-3``; not ``nan``, ``0x1F``, ``1_0``."""
    text = text.strip()
    if decimal != ".":
        if "." in text:
            return False
        text = text.replace(decimal, ".")
    return _NUMBER.fullmatch(text) is not None


@dataclass(frozen=True)
class Table:
    """Columns of one file, or in memory.

    ``load`` gives the raw cells of a column by its index from 0: a numeric array (n,), or an
    object array (n,) if some cell is no number. A column may hold k values a sample: an object
    array (n,) of lists, or an array (n, k) or (k, n), of which ``"name[3]"`` is the fourth signal.
    """

    where: str  # the file, for messages
    names: Sequence[str]  # one a column, empty for one without; no name comes twice
    load: Callable[[int], NDArray[Any]]
    names_at: str = "header"  # place of the names, for messages
    lines: Sequence[int] | None = None  # line of every row (n,) in a text file
    header_line: int | None = None
    decimal: str = "."  # mark of cells that are text
    notes: tuple[str, ...] = ()  # a sentence for every choice made in reading
    units: Sequence[str] = ()  # one a column as in the file, empty for none
    by_rows: bool = False  # whether the first axis of an array is always that of the samples
    rows: int | None = None  # number in the file, where only some are used
    kept: NDArray[np.intp] | None = None  # indices of the rows used; None for all
    _columns: dict[tuple[int, int | None], NDArray[np.float64]] = field(
        default_factory=dict, init=False
    )

    def __post_init__(self) -> None:
        check_names(self.where, self.names, self.names_at)

    def row(self, index: int) -> str:
        """Name a row, given from 0, the way a user counts: ``"row 17 (line 31)"``."""
        return row_name(index if self.kept is None else int(self.kept[index]), self.lines)

    def label(self, key: str | int) -> str:
        """Return ``"file, column 'name'"`` for messages."""
        shown = f"'{key}'" if isinstance(key, str) else str(key)
        return f"{self.where}, column {shown}"

    def column(self, key: str | int) -> NDArray[np.float64]:
        """Return a column's numbers by name or number from 1; all must be finite."""
        place = self.place(key)
        if place not in self._columns:
            self._columns[place] = self._checked(self._cells(key), key)
        return self._columns[place]

    def only(self, conditions: Mapping[str, bool | int | float | str]) -> Table:
        """Select the rows in which columns equal values."""
        table = self
        for name, value in conditions.items():
            key = int(name) if name.isdecimal() and name not in self.names else name
            cells: NDArray[Any] = table._cells(key)
            if isinstance(value, str):
                cells = np.array([str(cell).strip() for cell in cells], dtype=object)
            else:
                cells = table._checked(cells, key)
            rows = np.flatnonzero(cells == value)
            if not rows.size:
                present = list(dict.fromkeys(cells.tolist()))
                shown = [
                    _shown(v) if isinstance(v, str) else f"{v:.10g}" for v in present[:_MAX_SHOWN]
                ]
                more = f" and {len(present) - _MAX_SHOWN} more" if len(present) > _MAX_SHOWN else ""
                problem = f"is {_shown(value)} in no row"
                hint = f"it has {', '.join(shown)}{more}"
                raise BadInput(f"{table.label(key)}, where", problem, hint)
            table = table.at(rows, len(cells))
        return table

    def at(self, rows: NDArray[np.intp], count: int) -> Table:
        """Select some of ``count`` rows, which every column must have."""
        if self.kept is None:
            return replace(self, kept=rows, rows=count)
        return replace(self, kept=self.kept[rows])

    def _cells(self, key: str | int) -> NDArray[Any]:
        """Return the raw cells of the rows used, (n,) or, of several signals, (n, k)."""
        place, index = self.place(key)
        cells = self.load(place)
        # of samples there are more than signals
        if cells.ndim == 2 and not self.by_rows and cells.shape[1] > cells.shape[0]:
            cells = cells.T
        if self.kept is not None and cells.ndim:
            if len(cells) != self.rows:
                problem = f"has {len(cells)} values, the column in where has {self.rows}"
                raise BadInput(self.label(key), problem, "give columns of one length")
            cells = cells[self.kept]
        return cells if index is None else self._signal(cells, index, key)

    def _signal(self, cells: NDArray[Any], index: int, key: str | int) -> NDArray[Any]:
        """Select one of several signals of a column."""
        if cells.ndim == 1 and cells.size and isinstance(cells[0], _LISTS):
            width = len(cells[0])  # those of one length are a matrix by now
            wrong = (isinstance(cell, _LISTS) and len(cell) == width for cell in cells)
            row = list(wrong).index(False)
            problem = f"holds {_shown(cells[row])}, the first row a list of {width}"
            raise self._bad_cell(key, row, problem)
        if cells.ndim != 2:
            raise BadInput(self.label(key), "holds no lists", "leave the index in brackets out")
        count = cells.shape[1]
        if index >= count:
            hint = f"give an index from 0 to {count - 1}" if count else "choose another column"
            raise BadInput(self.label(key), f"holds {count} values a sample", hint)
        return cells[:, index]

    def _checked(self, cells: NDArray[Any], key: str | int) -> NDArray[np.float64]:
        if cells.ndim != 1:
            shape = " x ".join(str(n) for n in cells.shape) or "one value"
            hint = "give a vector of one value a sample"
            if cells.ndim == 2:
                hint = f"name one of its signals with an index from 0, such as '{key}[0]'"
            raise BadInput(self.label(key), f"is no vector but {shape}", hint)
        if cells.dtype.kind in "biuf":
            with np.errstate(all="ignore"):  # a long double may become infinite
                values = cells.astype(np.float64, copy=False)
        elif cells.dtype.kind == "O":
            values = np.array([self._number(cell, key, i) for i, cell in enumerate(cells)], float)
        else:
            raise BadInput(
                self.label(key), f"holds {cells.dtype.name}, not numbers", "export it as numbers"
            )
        finite = np.isfinite(values)
        if not finite.all():
            index = int(np.argmin(finite))
            raise self._bad_cell(key, index, f"holds {_shown(cells[index])}, not a finite number")
        return values

    def _number(self, cell: Any, key: str | int, index: int) -> float:
        if cell is None or (isinstance(cell, str) and not cell.strip()):
            raise self._bad_cell(key, index, "is empty")
        if isinstance(cell, str) and is_number(cell, self.decimal):
            return float(cell.strip().replace(self.decimal, "."))
        try:
            if isinstance(cell, _PLAIN):
                return float(cell)
        except OverflowError:
            pass
        raise self._bad_cell(key, index, f"holds {_shown(cell)}, not a number")

    def _bad_cell(self, key: str | int, index: int, problem: str) -> BadInput:
        hint = "correct the cell, or cut the row out of the file"
        return BadInput(f"{self.label(key)}, {self.row(index)}", problem, hint)

    def place(self, key: str | int) -> tuple[int, int | None]:
        """Return the index of a column, and of a signal in it, by name or number from 1."""
        if isinstance(key, str) and key and key in self.names:
            return list(self.names).index(key), None
        part = _ONE_OF_SEVERAL.fullmatch(key) if isinstance(key, str) else None
        if part and part[1] in self.names:
            return list(self.names).index(part[1]), int(part[2])
        count, named = len(self.names), [name for name in self.names if name]
        if isinstance(key, int):
            if 1 <= key <= count:
                return key - 1, None
            problem = f"does not exist, the file has {count} columns"
        elif not named:
            problem = "does not exist, the columns have no names"
        else:
            line = f" (header in line {self.header_line})" if self.header_line is not None else ""
            raise BadInput(self.label(key), f"does not exist{line}", nearest(key, named))
        raise BadInput(self.label(key), problem, f"give a number from 1 to {count}")


def row_name(index: int, lines: Sequence[int] | None) -> str:
    """Name a row, given from 0, and its line of a text file."""
    return f"row {index + 1}" + ("" if lines is None else f" (line {lines[index]})")


def column_cells(series: Any) -> NDArray[Any]:
    """Return the cells of a pandas column, as numbers where all are."""
    if series.dtype.kind in "biuf" and isinstance(series.dtype, np.dtype):
        return np.array(series)
    return np.asarray(series.to_numpy(dtype=object, na_value=None))


def check_names(where: str, names: Sequence[str], names_at: str) -> None:
    """Refuse repeated names, and too many columns."""
    if len(names) > _MOST_COLUMNS:
        raise BadInput(
            f"{where}, {names_at}",
            f"has {len(names)} columns, more than {_MOST_COLUMNS}",
            "save only the recording's columns, one row a sample",
        )
    numbers: dict[str, int] = {}
    for number, name in enumerate(names, start=1):
        if name and name in numbers:
            problem = f"columns {numbers[name]} and {number} are both named '{name}'"
            raise BadInput(f"{where}, {names_at}", problem, "rename one of them")
        numbers[name] = number


def _shown(cell: object) -> str:
    if isinstance(cell, _LISTS):
        return f"a list of {len(cell)}"
    if isinstance(cell, dict):
        return "a table"
    text = repr(cell.item() if isinstance(cell, np.generic) else cell)
    return text if len(text) <= 60 else text[:57] + "..."
