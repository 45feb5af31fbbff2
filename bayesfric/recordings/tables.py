"""A table: named columns of numbers, each with its unit, its own time stamps and NaN in holes."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.base.errors import BadInput, nearest
from bayesfric.recordings import units
from bayesfric.recordings.arrays import Array, Flags, Index, near, pchip

# possessive, so that it fails at the first wrong character
_NUMBER = re.compile(r"[+-]?(\d++(\.\d*+)?|\.\d++)([eE][+-]?\d++)?")
_ISO_8601 = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d")
_DURATION = re.compile(r"(\d+ days? )?\d+:\d\d:\d\d")
_ONE_OF_SEVERAL = re.compile(r"(.+)\[(\d{1,9})\]", re.DOTALL)
_LISTS = (list, tuple, np.ndarray)
Key = str | int
_LENGTHS = "give columns of one length"
# Text of cells without a value; other text that is no number is refused.
_EMPTY = {"", "nan", "na", "n/a", "<na>", "nat", "null", "none", "-", "--"}


def is_number(text: str, decimal: str = ".") -> bool:
    """Whether text is a plain decimal number: ``-2.5e-3``; not ``nan``, ``0x1F``, ``1_0``."""
    plain = text.strip().replace(".", "x").replace(decimal, ".") if decimal != "." else text.strip()
    return _NUMBER.fullmatch(plain) is not None


@dataclass(frozen=True)
class Table:
    """Columns of one file, or in memory.

    ``load`` gives the raw cells of a column by its index from 0: (n,), or of k signals (n, k) or
    (k, n), of which ``"name[3]"`` is the fourth. Cells may be objects.
    """

    where: str  # the file, for messages
    names: Sequence[str]  # one a column, empty for one without
    load: Callable[[int], NDArray[Any]]
    units: Sequence[str] = ()  # one a column as in the file, empty for none
    # names of the columns of time stamps, by the names of the columns that have stamps of their own
    clocks: Mapping[str, str] = field(default_factory=dict)
    unpaired: Mapping[str, str] = field(default_factory=dict)  # clocks that a column may have
    lines: Sequence[int] | None = None  # line of every row (n,) in a text file
    header: str = ""  # place of the names in a text file, for messages
    decimal: str = "."  # mark of cells that are text
    notes: tuple[str, ...] = ()  # a sentence for every choice made in reading
    by_rows: bool = False  # whether the first axis of an array is always that of the samples
    rows: Index | None = None  # indices of the rows used; None for all
    count: int | None = None  # rows in the file, where only some are used
    epoch: np.datetime64 | None = None  # from which dates count; None for each column's first
    _columns: dict[str | int, Array] = field(default_factory=dict, init=False)

    def row(self, index: int) -> str:
        """Name a row, given from 0, the way a user counts: ``"row 17 (line 31)"``."""
        row = index if self.rows is None else int(self.rows[index])
        return f"row {row + 1}" + ("" if self.lines is None else f" (line {self.lines[row]})")

    def label(self, key: str | int) -> str:
        """Return ``"file, column 'name'"`` for messages."""
        return self.where if key == "" else f"{self.where}, column {key!r}"

    def place(self, key: str | int) -> tuple[int, int | None]:
        """Return the index of a column, and of a signal in it, by name or number from 1."""
        names, at = list(self.names), f" in {self.header}" if self.header else ""
        numbered = f"give a number from 1 to {len(names)}"
        if isinstance(key, int):
            if 1 <= key <= len(names):
                return key - 1, None
            raise BadInput(self.label(key), "does not exist", numbered)
        part = _ONE_OF_SEVERAL.fullmatch(key)
        name, signal = (part[1], int(part[2])) if part and key not in names else (key, None)
        if not name or name not in names:
            if known := list(filter(None, names)):
                raise BadInput(self.label(key), f"does not exist{at}", nearest(key, known))
            raise BadInput(self.label(key), "does not exist, the columns have no names", numbered)
        if names.count(name) > 1:
            numbers = [str(number) for number, other in enumerate(names, start=1) if other == name]
            every = "both" if len(numbers) == 2 else "all"
            problem = f"columns {' and '.join(numbers)} are {every} named {name!r}{at}"
            raise BadInput(self.where, problem, "give the column's number, or rename one of them")
        return names.index(name), signal

    def values(self, key: str | int) -> Array:
        """Return a column ``(n,)`` by name or number from 1, NaN where a cell is no number.

        Dates become seconds since the first, and durations seconds.
        """
        if key in self._columns:
            return self._columns[key]
        cells = self.cells(key)
        if cells.ndim != 1:
            shape = " x ".join(map(str, cells.shape)) or "one value"
            hint = f"name one of its signals, such as '{key}[0]'"
            hint = hint if cells.ndim == 2 else "give a vector of one value a sample"
            raise BadInput(self.label(key), f"is no vector but {shape}", hint)
        if cells.dtype.kind in "biuf":
            with np.errstate(over="ignore"):  # a long double may become infinite
                return cells.astype(np.float64, copy=False)
        if (dates := as_dates(cells)) is not None:
            if dates.dtype.kind == "M":
                first = dates[~np.isnat(dates)].min() if self.epoch is None else self.epoch
                dates = dates - first
            values = np.asarray(dates / np.timedelta64(1, "ns"), dtype=np.float64) / 1e9
        elif cells.dtype.kind == "O":
            values = np.array([_number(cell, self.decimal) for cell in cells], dtype=np.float64)
        else:
            problem = f"holds {cells.dtype.name}"
            raise BadInput(self.label(key), problem, "export it as numbers")
        self._columns[key] = values
        return values

    def column(self, key: str | int) -> Array:
        """Return a column ``(n,)`` whose numbers must all be finite."""
        values = self.values(key)
        finite = np.isfinite(values)
        if not finite.all():
            row = int(np.argmin(finite))
            where, cell = f"{self.label(key)}, {self.row(row)}", self.cells(key)[row]
            text = repr(cell.item() if isinstance(cell, np.generic) else cell)[:60]
            problem = "is empty" if text in ("None", "''") else f"holds {text}, not a finite number"
            raise BadInput(where, problem, "correct the cell, or cut the row out of the file")
        return values

    def holes(self, key: str | int) -> Flags:
        """Flag the cells ``(n,)`` without a value, unlike those with something else."""
        flags = np.isnan(self.values(key))
        if flags.any() and (cells := self.cells(key)).dtype.kind == "O":
            numbers = (np.isfinite(_number(cell, self.decimal)) for cell in cells)
            flags &= [_is_empty(x) or number for x, number in zip(cells, numbers, strict=True)]
        return flags

    def decoded(self, columns: Mapping[str | int, Array], notes: Sequence[str]) -> Table:
        """Replace the numbers of some columns, NaN where a number is none, as of a failed read."""
        table = replace(self, notes=(*self.notes, *notes))
        table._columns.update({**self._columns, **columns})
        return table

    def is_dated(self, key: str | int) -> bool:
        """Whether a column holds dates or durations."""
        return as_dates(self.cells(key)) is not None

    def cells(self, key: str | int) -> NDArray[Any]:
        """Return the raw cells of the rows used, (n,) or, of several signals, (n, k)."""
        place, signal = self.place(key)
        cells = self.load(place)
        # of samples there are more than signals
        if cells.ndim == 2 and not self.by_rows and cells.shape[1] > cells.shape[0]:
            cells = cells.T
        if self.rows is not None and cells.ndim:
            if len(cells) != self.count:
                problem = f"has {len(cells)} values, other columns have {self.count}"
                raise BadInput(self.label(key), problem, _LENGTHS)
            cells = cells[self.rows]
        if signal is None:
            return cells
        if cells.ndim == 1 and any(isinstance(cell, _LISTS) for cell in cells):
            lists = (cell if isinstance(cell, _LISTS) else () for cell in cells)
            parts = [part[signal] if signal < len(part) else None for part in lists]
            return np.array(parts, dtype=object)
        if cells.ndim != 2:
            raise BadInput(self.label(key), "holds no lists", "leave the index in brackets out")
        if signal >= (count := cells.shape[1]):
            hint = f"give an index from 0 to {count - 1}"
            raise BadInput(self.label(key), f"holds {count} values a sample", hint)
        return cells[:, signal]

    def signals(self, name: str) -> list[str]:
        """Name the signals of a column that has several a row, as ``"name[3]"``; else itself."""
        cells = self.cells(name)
        if cells.ndim == 2:
            count = cells.shape[1]
        else:
            lists = (len(cell) for cell in np.atleast_1d(cells) if isinstance(cell, _LISTS))
            count = max(lists, default=0)
        return [f"{name}[{k}]" for k in range(count)] or [name]

    def at(self, rows: Index, count: int) -> Table:
        """Select some of ``count`` rows, which every column must have."""
        chosen = rows if self.rows is None else self.rows[rows]
        table = replace(self, rows=chosen, count=self.count or count)
        read = {key: values[rows] for key, values in self._columns.items() if values.size == count}
        table._columns.update(read)
        return table

    def only(self, conditions: Mapping[str, bool | int | float | str]) -> Table:
        """Select the rows in which columns equal values."""
        table = self
        for name, value in conditions.items():
            key = int(name) if name.isdecimal() and name not in self.names else name
            if isinstance(value, str):
                cells = np.array([str(cell).strip() for cell in table.cells(key)], dtype=object)
            else:
                cells = table.column(key)
            rows = np.flatnonzero(cells == value)
            if not rows.size:
                present = [v if isinstance(v, str) else f"{v:.10g}" for v in dict.fromkeys(cells)]
                hint = f"it has {', '.join(present[:20])}{', ...' * (len(present) > 20)}"
                raise BadInput(f"{table.label(key)}, where", f"is {value!r} in no row", hint)
            table = table.at(rows, len(cells))
        return table

    def stamps(self, key: str | int) -> Array:
        """Return time stamps ``(n,)``, NaN in holes; the others must increase."""
        times, rows = self.values(key), np.flatnonzero(~self.holes(key))
        time = times[rows]
        wrong = ~(np.diff(time) > 0.0)
        if not wrong.any() and np.isfinite(time).all():
            return times
        filled = self.at(rows, times.size)
        filled.column(key)  # names a cell that is no number
        index = int(np.argmax(wrong)) + 1
        # a clock that was set back is in order before and after
        set_back = np.count_nonzero(time < np.maximum.accumulate(time)) > 3 * wrong.sum()
        problem = f"goes back in time, from {time[index - 1]:.9g} to {time[index]:.9g}"
        hint = "split the file there" if set_back else "sort the rows by time"
        if time[index] == time[index - 1]:
            problem = f"repeats the time stamp {time[index]:.9g} of the row before"
            hint = "cut the repeated rows out, or record time with finer resolution"
        raise BadInput(f"{self.label(key)}, {filled.row(index)}", problem, hint)

    def without_repeats(self, keys: Sequence[str | int], clock: str | int) -> Table:
        """Leave out rows that repeat the time stamp and all values of the row before."""
        if self.clocks or not self.values(clock).size:
            return self
        again = np.diff(self.values(clock)) == 0.0
        for key in keys if again.any() else ():
            values = self.values(key)
            if values.size != again.size + 1:
                return self
            again &= (np.diff(values) == 0.0) | np.isnan(values[1:] + values[:-1])
        if not again.any():
            return self
        rows = np.flatnonzero(~np.append(False, again))
        note = f"repeats: {int(again.sum())} of {again.size + 1} rows repeat the one before"
        return replace(self.at(rows, again.size + 1), notes=(*self.notes, f"{note}, left out"))

    def doubts(self, keys: Sequence[str | int]) -> list[str]:
        """Say which of some columns may be of other clocks than the rows by which they are read."""
        places = dict.fromkeys(self.place(key)[0] for key in keys if key)
        names = [self.names[place] for place in places]
        if not (doubtful := [name for name in names if name in self.unpaired]):
            return []
        clocks = f"but may be of another clock ({self.unpaired[doubtful[0]]})"
        return [f"time: {', '.join(doubtful)} are paired by rows, {clocks}"]

    def clock(self, key: str | int) -> str | None:
        """Return the name of the column of a column's own time stamps."""
        return self.clocks.get(self.names[self.place(key)[0]])

    def aligned(
        self, keys: Sequence[Key], first: Key, clock: Key | None, stamps: Array, flag: Key | None
    ) -> tuple[Table, Index]:
        """Bring columns to the rows in which all have a value; returns these rows, too.

        Rows are those of ``first``, at ``stamps`` (n,) of ``clock``. A column with other stamps, or
        empty in more than a tenth of the rows, is interpolated by time, across up to five median
        steps, a ``flag`` by the last value before.
        """
        used = ~self.holes(first)
        if not used.any():
            return self, np.arange(used.size)
        if stamps.size != used.size:
            problem = f"has {used.size} values, the time column has {stamps.size}"
            raise BadInput(self.label(first), problem, _LENGTHS)
        base, columns, lacking = used.copy(), dict[str | int, Array](), list[str]()
        own_stamps = list[str | int]()
        for key in keys:
            present, time = ~self.holes(key), stamps
            own_clock = self.clock(key) if clock in self.clocks.values() else None
            if own_clock is not None and clock is not None and own_clock != clock:
                marks = (
                    self.units[self.place(x)[0]] if self.units else "" for x in (own_clock, clock)
                )
                own, base_unit = (units.scale([mark or "s"], "time") for mark in marks)
                time = self.stamps(own_clock) * (own / base_unit)
            if present.size != time.size:
                problem = f"has {present.size} values, column '{first}' has {time.size}"
                raise BadInput(self.label(key), problem, _LENGTHS)
            if time is stamps and not present.all():
                lacking.append(repr(key))
            columns[key] = self.values(key)
            stamped = present & np.isfinite(time)
            steps = np.diff(time[stamped])
            by_row = time is stamps and present[base].mean() >= 0.9
            if by_row or key == clock or not steps.size or not np.all(steps > 0.0):
                used &= present
                continue
            values = columns[key][stamped]
            before = np.searchsorted(time[stamped], stamps, "right") - 1
            inside = (before >= 0) & (stamps <= time[stamped][-1])
            wide = np.append(steps > 5.0 * np.median(steps), False)
            used &= inside & ~wide[before]
            smooth, straight = (f(stamps, time[stamped], values) for f in (pchip, np.interp))
            # next to a gap there is no slope
            smooth = np.where(near(wide, 1)[before], straight, smooth)
            columns[key] = values[before] if key == flag else smooth
            own_stamps.append(key)
        rows, notes = np.flatnonzero(used), list(self.notes)
        if not rows.size:
            hint = "check their time stamps" if own_stamps else "check the export"
            raise BadInput(self.where, "in no row have all columns a value", hint)
        if rows.size == used.size and not own_stamps:
            return self, rows
        if own_stamps:
            clocks = ", ".join(sorted({repr(x) for key in own_stamps if (x := self.clock(key))}))
            note = f"time: {', '.join(map(repr, own_stamps))} have stamps of their own"
            notes.append(f"{note} ({clocks or 'other rows'}), interpolated at those of {first!r}")
        if rows.size < used.size:
            why = f": cells of columns {', '.join(lacking)} hold no value" if lacking else ""
            notes.append(f"holes: {used.size - rows.size} of {used.size} rows left out{why}")
        table = replace(self.at(rows, used.size), notes=tuple(notes))
        table._columns.update({key: values[rows] for key, values in columns.items()})
        return table, rows


def as_dates(cells: NDArray[Any]) -> NDArray[Any] | None:
    """Read cells ``(n,)`` of dates or durations, or of their text; ``None`` if they are others."""
    if cells.ndim == 1 and cells.dtype.kind == "O":
        first = next((cell for cell in cells if not _is_empty(cell)), None)
        text = first.strip() if isinstance(first, str) else ""
        dated = isinstance(first, date) or _ISO_8601.match(text)
        if not dated and not isinstance(first, timedelta) and not _DURATION.match(text):
            return None
        import pandas as pd

        if dated:
            dates = pd.to_datetime(pd.Series(cells), utc=True, format="ISO8601", errors="coerce")
            cells = dates.dt.tz_localize(None).to_numpy()
        else:
            cells = pd.to_timedelta(pd.Series(cells), errors="coerce").to_numpy()
    if cells.dtype.kind not in "mM" or np.isnat(cells).all():
        return None
    return cells.astype(f"{cells.dtype.kind}8[ns]")


def _is_empty(cell: Any) -> bool:
    """Whether a cell holds no value, unlike one with something else than a number."""
    text = "[]" if isinstance(cell, _LISTS) else str(cell).strip()
    return text.casefold() in _EMPTY


def _number(cell: Any, decimal: str) -> float:
    """Return a cell as a number, NaN where it is none."""
    if isinstance(cell, str):
        return float(cell.strip().replace(decimal, ".")) if is_number(cell, decimal) else np.nan
    try:
        return np.nan if isinstance(cell, _LISTS) else float(cell)
    except (TypeError, ValueError, OverflowError):
        return np.nan
