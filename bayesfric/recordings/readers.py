"""Readers of files: each opens one format as a table, and leaves its rows as they are."""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import io
import re
import warnings
import zipfile
from array import array
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from importlib import import_module
from itertools import islice, pairwise
from pathlib import Path
from typing import Any, Literal, Self, TextIO

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from bayesfric.base.errors import BadInput
from bayesfric.base.options import Options
from bayesfric.base.safe_read import check_file, parse_json, unreadable
from bayesfric.recordings.recognition import with_clocks
from bayesfric.recordings.tables import Table, is_number

LoadColumn = Callable[[int], NDArray[Any]]

# fmt: off
Format = Literal[
    "csv", "xlsx", "hdf5", "mat", "json", "jsonl", "npy", "parquet", "npz", "ros", "mdf", "tdms",
    "ulog", "wpilog",
]
# fmt: on


class TableOptions(Options):
    """How a file is laid out."""

    format: Format | None = Field(
        None, description="File format; by the suffix, or else by the content, if left out."
    )
    delimiter: Literal[",", ";", ":", "|", " ", "\t", "tab", "whitespace"] | None = Field(
        None, description="Text: what is between columns; detected if left out."
    )
    decimal: Literal[".", ","] | None = Field(
        None, description="Text: decimal mark; detected if left out."
    )
    skip_rows: int = Field(0, ge=0, description="Text: lines to skip at the beginning of the file.")
    table: str | None = Field(
        None,
        description="Nested files: dotted path of keys (or structs, or numbers of a list from 0), "
        "path of groups, sheet, or topic of a ROS bag.",
    )
    where: dict[str, bool | int | float | str] = Field(
        default_factory=dict, description="Only the rows of these values: { episode_index = 3 }."
    )

    @model_validator(mode="after")
    def _two_marks(self) -> Self:
        if self.delimiter is not None and self.delimiter == self.decimal:
            raise ValueError(f"'delimiter' and 'decimal' are both '{self.decimal}'")
        return self


def read_table(path: Path, options: TableOptions) -> Table:
    """Open a recorded file, by its suffix, else by its content; columns are read when asked for."""
    kind = options.format or _folder_kind(path)
    if kind is None or not path.is_dir():
        hint = "give a file, a pattern such as '*.csv', or the folder of a ROS 2 bag or of LeRobot"
        if check_file(path, hint) == 0:
            raise BadInput(str(path), "is empty", "check whether the recorder wrote anything")
    kind = kind or _file_kind(path)
    with _damage_named(path, kind):
        table = _READERS[kind][0](path, options)

    def load(index: int) -> NDArray[Any]:
        with _damage_named(path, kind, table.label(table.names[index] or index + 1)):
            return table.load(index)

    readable = dataclasses.replace(table, load=load)
    # the stamps of a message and of its receipt are of one row
    paired = readable if table.clocks or kind == "ros" else with_clocks(readable)
    return paired.only(options.where)


def is_recording(path: Path) -> bool:
    """Whether something is a file, or a folder that is read as one."""
    return path.is_file() or _folder_kind(path) is not None


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, or of the names and SHA-256 of a folder's sorted files."""
    try:
        if path.is_dir():
            files = _parquet_files(path) or sorted(x for x in path.iterdir() if x.is_file())
            names = "".join(f"{x.relative_to(path)}\0{sha256(x)}\n" for x in files)
            return hashlib.sha256(names.encode()).hexdigest()
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise unreadable(path, error) from error


def _folder_kind(path: Path) -> Format | None:
    """Return the format of a folder that is read as one recording."""
    if (path / "metadata.yaml").is_file():
        return "ros"
    return "parquet" if (path / "meta" / "info.json").is_file() else None


def _file_kind(path: Path) -> Format:
    """Return a file's format by its suffix; of other files, and of text, by its first bytes."""
    kind = _SUFFIXES.get(path.suffix.lower())
    if kind not in (None, "csv"):
        return kind
    try:
        with path.open("rb") as stream:
            start = stream.read(512)
    except OSError as error:
        raise unreadable(path, error) from error
    for known, (_, _, magic) in _READERS.items():
        if magic and start.startswith(magic):
            return known
    if kind is None and b"\0" in start and not start.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
        hint = f"export it as CSV, or set format to {', '.join(_READERS)}"
        raise BadInput(str(path), f"neither suffix '{path.suffix}' nor content is known", hint)
    return "csv"


def _library(path: Path, name: str, extra: str) -> Any:
    """Import the library that reads a format, which only its users need."""
    try:
        return import_module(name)
    except ImportError as error:
        problem = f"is read by {name.partition('.')[0]}, which is not installed"
        raise BadInput(str(path), problem, f"pip install 'bayesfric[{extra}]'") from error


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
        problem = f"is not a readable {kind} file ({type(error).__name__}: {error})"
        raise BadInput(where or str(path), problem, "export it again; it may be cut off") from error


@contextmanager
def _open_text(path: Path) -> Iterator[TextIO]:
    """Open a text, which must be UTF-8, or UTF-16 with a byte order mark."""
    with path.open("rb") as data:
        wide = data.peek(2)[:2] in (BOM_UTF16_LE, BOM_UTF16_BE)
        try:
            yield io.TextIOWrapper(data, encoding="utf-16" if wide else "utf-8-sig")
        except UnicodeDecodeError as error:
            # of what was read last
            where = f"{path}, byte {data.tell() - len(error.object) + error.start}"
            problem = f"is not UTF-{16 if wide else 8} text"
            raise BadInput(where, problem, "save it as UTF-8") from error


def _read_text(path: Path) -> str:
    with _open_text(path) as stream:
        return stream.read()


def _cells(values: list[Any]) -> NDArray[Any]:
    """Return cells as an array of numbers, (n,) or (n, k), or of objects."""
    plain = [v.tolist() if isinstance(v, np.ndarray | np.generic) else v for v in values]
    with suppress(ValueError):  # lists of different lengths
        if (numbers := np.array(plain)).dtype.kind in "biuf":
            return numbers
    return np.array(plain, dtype=object)


# --- delimited text -----------------------------------------------------------------------------


def _read_delimited(path: Path, options: TableOptions) -> Table:
    """Detect marks, header and a row of units; refuse rows of another width, with their line."""
    head = list(islice(_lines(path, options.skip_rows + 1), 400))
    if not head:
        after = f" after {options.skip_rows} skipped lines" if options.skip_rows else ""
        raise BadInput(str(path), f"is empty{after}", "check whether the recorder wrote anything")
    lines, texts = zip(*head, strict=True)
    if any(map(_TRACE_VARIABLE.match, texts)):
        return _read_trace(path, (line for _, line in _lines(path, lines[0])), options)
    delimiter, decimal = _marks(texts, options)
    table, first = _titled(path, lines, [_split(line, delimiter) for line in texts], decimal)
    if first == len(head):
        problem = "holds a header but no row of numbers"
        raise BadInput(str(path), problem, "check the recorder's export")
    # texts of a long table take ten times the memory of its numbers
    used = array("i", (n for n, _ in _lines(path, lines[first])))
    body, shape = (line for _, line in _lines(path, lines[first])), (len(used), len(table.names))
    load = _numbers(body, shape, delimiter) if decimal == "." else None
    load = load or _texts(path, _lines(path, lines[first]), shape[1], delimiter)
    comma = ("numbers have a decimal comma",) if decimal == "," else ()
    notes = (*comma, *table.notes)
    return dataclasses.replace(table, load=load, lines=used, decimal=decimal, notes=notes)


def _lines(path: Path, first: int) -> Iterator[tuple[int, str]]:
    """Read number and text of the lines that are not blank, from number ``first`` on."""
    with _open_text(path) as stream:
        for n, line in enumerate(stream, 1):
            if n >= first and line.strip():
                # of a commented header, as numpy.savetxt writes it, the mark is no cell
                text = line.lstrip("#").lstrip() if line[0] == "#" else line
                yield n, text.removesuffix("\n")


def _numbers(body: Iterable[str], shape: tuple[int, int], delimiter: str) -> LoadColumn | None:
    """Read a table of nothing but finite numbers; pandas takes a third of a second to import."""
    mark = None if delimiter == "whitespace" else delimiter
    try:
        numbers = np.loadtxt(body, delimiter=mark, comments=None, ndmin=2)
    except ValueError:
        return None
    # larger ones are whole numbers that would be rounded
    exact = numbers.min() > -(2.0**53) and numbers.max() < 2.0**53
    return numbers.T.__getitem__ if exact and numbers.shape == shape else None


def _texts(path: Path, lines: Iterable[tuple[int, str]], width: int, delimiter: str) -> LoadColumn:
    """Read a table of any cells: a column of nothing but ``true`` and ``false``, or of text."""
    rows = list[list[str]]()
    for n, line in lines:
        rows.append(cells := _split(line, delimiter))
        if len(cells) != width:
            problem = f"has {len(cells)} cells, the table has {width} columns"
            raise BadInput(f"{path}, line {n}", problem, "correct the row, or cut the file there")

    def load(index: int) -> NDArray[Any]:
        cells = np.array([row[index] for row in rows], dtype=object)
        flags = {*cells} <= {"True", "TRUE", "true", "False", "FALSE", "false"}
        return np.char.lower(cells.astype(str)) == "true" if flags else cells

    return load


def _titled(
    path: Path, lines: Sequence[int], rows: Sequence[Sequence[str]], decimal: str = "."
) -> tuple[Table, int]:
    """Make a table without cells of the ``rows`` above them; returns the index of the first row."""
    flags = [[is_number(cell, decimal) for cell in row] for row in rows]
    header, first, width = _find_header(path, lines, rows, flags)
    names, units, notes = [""] * width, list[str](), list[str]()
    top = first if header is None else header
    if header is not None:
        names = list(rows[header])
    if header is not None and first - header > 1:
        is_units = len(rows[header + 1]) == width
        units = [cell.strip("[]()") for cell in rows[header + 1]] if is_units else []
        what = "taken as units" if is_units else "left out"
        notes.append(f"line {lines[header + 1]} {what}")
    if top:
        notes.append(f"{lines[top] - 1} lines above the table skipped")
    used, at, load = lines[first:], f"line {lines[top]}", list[NDArray[Any]]().__getitem__
    table = Table(str(path), names, load, units, lines=used, header=at, notes=tuple(notes))
    return table, first


def _split(line: str, delimiter: str) -> list[str]:
    """Split a line into its cells, without quotes and surrounding spaces."""
    if delimiter == "whitespace":
        return [cell.strip('"') for cell in line.split()]
    if '"' not in line:
        return [cell.strip() for cell in line.split(delimiter)]
    try:
        cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    except csv.Error:  # a cell of more than 131072 characters
        return [line]
    return [cell.strip() for cell in cells]


def _marks(lines: Sequence[str], options: TableOptions) -> tuple[str, str]:
    """Return delimiter and decimal mark: as given, or those with which most cells are numbers."""
    delimiters = [",", ";", "\t", "|", "whitespace"]
    if options.delimiter:
        names = {"tab": "\t", " ": "whitespace"}
        delimiters = [names.get(options.delimiter, options.delimiter)]
    counts = list[tuple[int, int, str, str]]()
    for decimal in (options.decimal,) if options.decimal else (".", ","):
        for delimiter in (mark for mark in delimiters if mark != decimal):
            cells = (_split(line, delimiter) for line in lines)
            flags = [[is_number(cell, decimal) for cell in row] for row in cells]
            width = _width(flags)
            numbers = sum(sum(f) for f in flags if len(f) == width > 1)
            counts.append((numbers, -width, delimiter, decimal))
    return max(counts, key=lambda count: count[:2])[2:]


def _width(flags: Sequence[Sequence[bool]]) -> int:
    """Return the number of columns of the lines with most numbers, 0 if there are none."""
    counts = Counter[int]()
    for line in flags:
        counts[len(line)] += sum(line)
    weight, width = max(((weight, width) for width, weight in counts.items()), default=(0, 0))
    return width if weight else 0


def _find_header(
    path: Path, lines: Sequence[int], rows: Sequence[Sequence[str]], flags: Sequence[Sequence[bool]]
) -> tuple[int | None, int, int]:
    """Find header and first row of a table, and its number of columns."""
    width = _width(flags)
    like = [len(row) == width for row in rows]
    fitting = (n for n, row in enumerate(flags) if like[n] and 2 * sum(row) >= width > 0)
    first = next(fitting, -1)
    if first < 0 and len(rows) > 2:
        problem = "in no row is half of the cells numbers"
        hint = "check delimiter, decimal and skip_rows, or whether this is a text table at all"
        raise BadInput(f"{path}, line {lines[len(rows) - 1]}", problem, hint)
    if first < 0:
        return 0, len(rows), width
    while first > 0 and like[first - 1] and any(flags[first - 1]):
        first -= 1
    # pandas' names of columns without one are 0, 1, ..., behind an empty name of its index
    counted = [str(k) for k in range(width)]
    decimals = all("." in cell for cell in rows[min(first + 1, len(rows) - 1)])
    if list(rows[first]) in (["", *counted[:-1]], counted * decimals) and width > 1:
        return first, first + 1, width
    if first and not like[first - 1] and any(flags[first - 1]):
        # a serial log may begin within a row
        if first == 1 or (like[first - 2] and not any(flags[first - 2])):
            return first - 2 if first > 1 else None, first, width
        # data that would be lost silently
        problem = f"has {len(rows[first - 1])} cells, the rows below have {width}"
        hint = "correct the row, or set skip_rows if it is no row of the table"
        raise BadInput(f"{path}, line {lines[first - 1]}", problem, hint)
    if not first or not like[first - 1]:
        return None, first, width
    missing = {"", "nan", "na", "n/a", "null", "none", "inf", "-inf", "-", "--", "?"}
    with_units = first > 1 and like[first - 2] and not any(flags[first - 2])
    with_units = with_units and missing.isdisjoint(cell.casefold() for cell in rows[first - 1])
    return first - 1 - with_units, first, width


# Traces of CODESYS and TwinCAT: "key; value" lines, and per variable a block of "; time; value".
_TRACE_VARIABLE = re.compile(r"\d+\.Variable\s*;(.*)")


def _read_trace(path: Path, lines: Iterable[str], options: TableOptions) -> Table:
    """Read a PLC's trace, one column a variable with time stamps of its own."""
    blocks = dict[str, list[list[str]]]()
    for line in lines:
        if name := _TRACE_VARIABLE.match(line):
            rows = blocks.setdefault(name[1].strip(), [])
        elif line.lstrip().startswith(";") and blocks:
            rows.append([cell.strip() for cell in line.split(";")[1:3]])
    columns = dict[str, _Column]()
    for variable, rows in blocks.items():
        cells = np.array(rows, dtype=object).reshape(-1, 2)
        columns[f"{variable}/time"] = "", "", cells[:, 0]
        columns[variable] = "", f"{variable}/time", cells[:, 1]
    return _stamped(path, columns, options.table)


def _read_xlsx(path: Path, options: TableOptions) -> Table:
    """Read a sheet, ``options.table`` if several hold cells, with its header as in text."""
    import pandas as pd

    _library(path, "openpyxl", "xlsx")
    sheets = pd.read_excel(path, sheet_name=None, header=None, engine="openpyxl")
    sheets = {str(name): sheet for name, sheet in sheets.items() if sheet.size}
    frame = sheets[_one_of(path, list(sheets), options.table)]
    cells = frame.astype(object).where(frame.notna(), "").head(400).to_numpy().tolist()
    texts = [[str(cell).strip() for cell in row] for row in cells]
    # titles above the table do not fill its columns
    rows = [row[: max((n for n, cell in enumerate(row, 1) if cell), default=0)] for row in texts]
    marks = (options.decimal,) if options.decimal else (".", ",")
    decimal = max(marks, key=lambda mark: sum(is_number(x, mark) for row in rows for x in row))
    table, first = _titled(path, range(1, len(frame) + 1), rows, decimal)
    body = frame.iloc[first:].infer_objects()
    columns = [body[k].to_numpy() for k in body]
    return dataclasses.replace(table, load=columns.__getitem__, decimal=decimal)


def _one_of(path: Path, names: Sequence[str], wanted: str | None) -> str:
    """Return the table that was named, or the only one."""
    if wanted in names or (wanted is None and len(names) == 1):
        return wanted or names[0]
    if wanted is not None:
        raise _absent(f"{path}, table '{wanted}'", "no such table", names)
    if not names:
        raise BadInput(str(path), "holds no table of numbers", "check what was recorded")
    known = ", ".join(map(repr, names[:20]))
    raise BadInput(str(path), f"holds several tables ({known})", "name one with table")


def _absent(where: str, what: str, known: Sequence[str], otherwise: str = "") -> BadInput:
    """Say that something is not there, and what is."""
    listed = ", ".join(map(repr, filter(None, known[:20])))
    return BadInput(where, f"there is {what}", f"it has {listed}" if listed else otherwise)


# --- JSON ---------------------------------------------------------------------------------------


def _read_json(path: Path, options: TableOptions) -> Table:
    """Read a list of objects or of rows, or an object of lists, by its path or the only one."""
    data = _flat(_inside(str(path), parse_json(str(path), _read_text(path)), options.table))
    where = "" if options.table is None else f"{options.table}."
    while tables := _tables_in(data, where):
        name = _one_of(path, list(tables), None)
        data, where = _flat(tables[name]), f"{name}."
    if isinstance(data, list):
        return _from_rows(path, data)
    if not isinstance(data, dict) or not any(isinstance(value, list) for value in data.values()):
        problem = "is neither a list of objects nor an object of lists"
        raise BadInput(str(path), problem, "give the dotted path to it with table")
    cells = [
        partial(_cells, v) if isinstance(v, list) else partial(np.array, None)
        for v in data.values()
    ]
    return Table(str(path), list(data), lambda index: cells[index]())


def _read_json_lines(path: Path, options: TableOptions) -> Table:
    """Read an object a line, one column a key, at the path ``options.table`` in each."""
    text = enumerate(_read_text(path).split("\n"), start=1)
    places = {n: (f"{path}, line {n}", line) for n, line in text if line.strip()}
    parsed = ((where, parse_json(where, line)) for where, line in places.values())
    rows = [_inside(where, row, options.table) for where, row in parsed]
    return _from_rows(path, rows, list(places))


def _inside(where: str, data: Any, table: str | None) -> Any:
    """Follow a dotted path of keys, and of numbers of a list's items from 0."""
    for key in [] if table is None else table.split("."):
        inner = data
        if isinstance(data, list):
            inner = {str(number): item for number, item in enumerate(data)}
        if not isinstance(inner, dict) or key not in inner:
            known = list(inner) if isinstance(inner, dict) else []
            where = f"{where}, table '{table}'"
            raise _absent(where, f"no key '{key}'", known, "give the path to the rows")
        data = inner[key]
    return data


def _flat(data: Any) -> Any:
    """Name what is inside objects of an object by its dotted path; return other data."""
    if not isinstance(data, dict):
        return data
    columns = dict[str, Any]()
    for key, value in data.items():
        inner = _flat(value)
        nested = inner is not value
        columns |= {f"{key}.{k}": v for k, v in inner.items()} if nested else {key: value}
    return columns


def _tables_in(data: Any, path: str = "") -> dict[str, Any]:
    """Find the tables by their paths inside an object or a list that is no table itself.

    Lists of objects, of rows that begin with time stamps, or of episodes: objects of lists that are
    longer than there are objects, as samples are more than signals.
    """
    if isinstance(data, list):
        values = [v for row in data if isinstance(row, dict) for v in row.values()]
        episodes = any(isinstance(v, list) and len(v) > len(data) for v in values)
        return {f"{path}{number}": item for number, item in enumerate(data)} if episodes else {}
    items = data.items() if isinstance(data, dict) else ()
    lists = {key: v for key, v in items if isinstance(v, list) and v}
    if all(map(_begins_with_stamps, lists.values())):
        return {path + key: rows for key, rows in lists.items()}
    objects = {k: v for k, v in lists.items() if all(isinstance(row, dict) for row in v)}
    inner = [_tables_in(v, f"{path}{key}.") or {path + key: v} for key, v in objects.items()]
    return {key: value for tables in inner for key, value in tables.items()}


def _begins_with_stamps(rows: list[Any]) -> bool:
    """Whether the first values of rows of several numbers increase."""
    lists = [row for row in rows if isinstance(row, list) and len(row) > 1]
    stamps = [row[0] for row in lists if isinstance(row[0], int | float)]
    return 1 < len(stamps) == len(rows) and all(a < b for a, b in pairwise(stamps))


def _from_rows(path: Path, rows: list[Any], lines: Sequence[int] | None = None) -> Table:
    """Make a table of rows, objects or lists of numbers, at some ``lines`` of the file."""
    if not rows:
        raise BadInput(str(path), "holds no rows", "check the recorder's export")
    kind = "an object" if isinstance(rows[0], dict) else "a list"
    width = len(rows[0]) if isinstance(rows[0], list) else 0
    # where only a later row holds an object, its cell is wrong
    if isinstance(rows[0], dict) and any(isinstance(value, dict) for value in rows[0].values()):
        rows = [*map(_flat, rows)]
    names = list(dict.fromkeys(key for row in rows if isinstance(row, dict) for key in row))

    def load(index: int) -> NDArray[Any]:
        return _cells([row[index] if width else row.get(names[index]) for row in rows])

    table = Table(str(path), [""] * width or names, load, lines=lines, by_rows=True)
    for number, row in enumerate(rows):
        if not isinstance(row, list if width else dict) or (width and len(row) != width):
            problem = f"is not {kind}{f' of {width} values' if width else ''} as row 1"
            raise BadInput(f"{path}, {table.row(number)}", problem, "cut it out")
    return table


# --- NumPy, Parquet, HDF5 and MATLAB ------------------------------------------------------------


def _read_npy(path: Path, _: TableOptions) -> Table:
    """Map a structured array, one column a field, or a matrix; no pickle is opened."""
    array = np.load(path, mmap_mode="r", allow_pickle=False)
    fields = array.dtype.names
    if array.ndim != (1 if fields else 2):
        problem = f"holds an array of shape {array.shape}"
        raise BadInput(str(path), problem, "save a structured array (n,), or numbers (n, columns)")

    def load(index: int) -> NDArray[Any]:
        return np.array(array[fields[index]] if fields else array[:, index])

    return Table(str(path), fields or ("",) * array.shape[1], load, by_rows=True)


def _read_npz(path: Path, _: TableOptions) -> Table:
    """Read an archive, one column an array, each when asked for; no pickle is opened."""
    with zipfile.ZipFile(path) as archive:  # NumPy leaves a file open that is none
        names = [name.removesuffix(".npy") for name in archive.namelist()]

    def load(index: int) -> NDArray[Any]:
        with np.load(path, allow_pickle=False) as arrays:
            return np.squeeze(np.asarray(arrays[names[index]]))

    return Table(str(path), names, load)


def _read_parquet(path: Path, _: TableOptions) -> Table:
    """Read a file, or LeRobot's folder, one column a field, and a signal of a named feature."""
    pa, pq = (_library(path, name, "parquet") for name in ("pyarrow", "pyarrow.parquet"))
    files = _parquet_files(path)[1:] if path.is_dir() else [path]
    if not files:
        raise BadInput(str(path), "holds no data/**/*.parquet", "download the data, too")
    schema, parts = pq.read_schema(files[0]), _lerobot_names(path)
    names = list(schema.names)
    places: list[tuple[int, int | None]] = [(index, None) for index in range(len(names))]
    for feature in (name for name in parts if name in schema.names):
        names += [f"{feature}.{part}" for part in parts[feature]]
        places += [(schema.names.index(feature), k) for k in range(len(parts[feature]))]

    def load(index: int) -> NDArray[Any]:
        index, part = places[index]
        kind, name = schema.types[index], schema.names[index]
        plain = getattr(kind, "value_type", kind)
        unlike = (pa.types.is_nested, pa.types.is_time, pa.types.is_binary)
        if any(is_kind(plain) for is_kind in unlike):
            problem = f"holds {str(kind)[:60]}, not numbers"
            raise BadInput(f"{path}, column '{name}'", problem, "export it as numbers")
        # by name: a name with a dot also selects a field inside a table
        tables = [pq.read_table(x, columns=[name], partitioning=None) for x in files]
        column = pa.concat_tables(tables).column(name)
        if plain is kind and not column.null_count and not pa.types.is_decimal(kind):
            return np.asarray(column.to_numpy())
        cells = _cells(column.to_pylist())
        return cells if part is None else cells.reshape(len(cells), -1)[:, part]

    units = ["s" if parts and name == "timestamp" else "" for name in names]
    note = "timestamp: LeRobot writes frame_index / fps, not when it was measured"
    notes = (note,) * ("s" in units)
    return Table(str(path), names, load, units=units, by_rows=True, notes=notes)


def _parquet_files(folder: Path) -> list[Path]:
    """Return the description of a LeRobot data set and its files of samples."""
    info = folder / "meta" / "info.json"
    return [info, *sorted(folder.glob("data/**/*.parquet"))] if info.is_file() else []


def _lerobot_names(path: Path) -> dict[str, list[str]]:
    """Return the names of each feature's signals of a LeRobot folder, or of a file inside one."""
    for folder in (path, *path.parents[1:3]):
        if (info := folder / "meta" / "info.json").is_file():
            names = dict[str, list[str]]()
            for feature, about in parse_json(str(info), _read_text(info))["features"].items():
                parts = about.get("names")
                parts = next(iter(parts.values())) if isinstance(parts, dict) else parts
                if about["dtype"].startswith("float") and parts:
                    names[feature] = list(map(str, parts))
            return names
    return {}


def _read_hdf5(path: Path, options: TableOptions, *, matlab: bool = False) -> Table:
    """Read a file, one column a dataset, named by its path below the group ``options.table``."""
    # h5py takes long to import, which only reading HDF5 should cost
    import h5py

    columns = dict[str, _Column]()

    def visit(name: str, item: Any) -> None:
        # MATLAB's internal datasets begin with #
        if isinstance(item, h5py.Dataset) and not name.startswith("#"):
            columns[name] = "", "", partial(load, name)

    wanted = (options.table or "").replace("." if matlab else "/", "/")

    def load(name: str) -> NDArray[Any]:
        with h5py.File(path, "r") as file:
            dataset, where = file[name], f"{path}, column '{name}'"
            kind = dataset.attrs.get("MATLAB_class", b"")
            # MATLAB's text and cells are numbers to HDF5
            if kind in (b"char", b"cell", b"function_handle") or dataset.dtype.kind not in "biuf":
                problem = f"holds {kind.decode() or dataset.dtype.name}, not numbers"
                raise BadInput(where, problem, "export a vector of numbers")
            if dataset.shape is None or dataset.attrs.get("MATLAB_empty", 0):
                return np.empty(0)
            if dataset.ndim > 2 and sorted(dataset.shape)[-3] > 1:
                problem = f"has {dataset.ndim} axes, as images have"
                raise BadInput(where, problem, "export a vector of numbers")
            # MATLAB stores arrays transposed, and knows no vectors
            values = np.asarray(dataset[()])
            return np.squeeze(values.T if matlab else values)

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    if not columns:
        raise BadInput(str(path), "holds no datasets of numbers", "check the export")
    return _stamped(path, columns, wanted, by_rows=False)


def _prefix(path: Path, names: Sequence[str], wanted: str | None) -> str:
    """Return the path of the group that is the table: as named, or the only one."""
    groups = list(dict.fromkeys(name.rpartition("/")[0] for name in names))
    group = (wanted or "").strip("/") or (groups[0] if len(groups) == 1 else "")
    prefix = f"{group}/" if group else ""
    if not any(name.startswith(prefix) for name in names):
        where = f"{path}, table '{group}'"
        raise _absent(where, "no such group of columns", groups, "leave table out")
    return prefix


def _read_matlab(path: Path, options: TableOptions) -> Table:
    """Read a file, one column a variable; ``options.table`` is a dotted path of structs."""
    with path.open("rb") as file:
        start = file.read(516)
    # of version 7.3, which is HDF5 behind a header of 512 bytes
    if start.startswith(b"MATLAB 7.3") or b"\x89HDF" in (start[:4], start[512:]):
        return _read_hdf5(path, options, matlab=True)
    from scipy.io import loadmat

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # objects have no names, and seem doubled
        content = loadmat(path, simplify_cells=True)
    content = {key: value for key, value in content.items() if not str(key).startswith("__")}
    variables = _flat(_inside(str(path), content, options.table))
    if not isinstance(variables, dict) or not variables:
        where = f"{path}, table '{options.table}'" if options.table else str(path)
        raise BadInput(where, "holds no variables", "name a struct of vectors with table")
    values = list(variables.values())
    return Table(str(path), list(map(str, variables)), lambda index: np.asarray(values[index]))


# --- measurement data files: signals with time stamps of their own ------------------------------


# Unit of a column, the name of the column of its time stamps, both may be empty, and its cells, or
# what reads them.
_Column = tuple[str, str, Any]


def _stamped(
    path: Path,
    columns: Mapping[str, _Column],
    wanted: str | None,
    *,
    notes: tuple[str, ...] = (),
    by_rows: bool = True,
) -> Table:
    """Make a table of columns in groups, of which ``wanted`` is one."""
    stamps = {clock for _, clock, _ in columns.values()}
    prefix = _prefix(path, [name for name in columns if name not in stamps], wanted)
    used = {k.removeprefix(prefix): x for k, x in columns.items() if k.startswith(prefix)}
    cells = [x for _, _, x in used.values()]
    return Table(
        str(path),
        list(used),
        lambda index: np.asarray(x() if callable(x := cells[index]) else x),
        units=[unit for unit, _, _ in used.values()],
        clocks={k: clock.removeprefix(prefix) for k, (_, clock, _) in used.items() if clock},
        notes=notes,
        by_rows=by_rows,
    )


def _read_mdf(path: Path, options: TableOptions) -> Table:
    """Read an MDF file, one column a channel, named by its group if there are several."""
    mdf = _library(path, "asammdf", "mdf").MDF(path)
    columns = dict[str, _Column]()
    for number, group in enumerate(mdf.groups):
        label = getattr(group.channel_group, "acq_name", "") or f"group {number}"
        label = f"{label} {number}" if f"{label}/time" in columns else label
        master, clock = mdf.masters_db.get(number), ""
        if master is not None:
            clock = f"{label}/time"
            columns[clock] = "s", "", partial(mdf.get_master, number)
        for index, channel in enumerate(group.channels):
            if index != master:
                unit = mdf.get_channel_unit(group=number, index=index) or ""
                load = partial(mdf.get, group=number, index=index)
                columns[f"{label}/{channel.name}"] = unit, clock, lambda load=load: load().samples
    return _stamped(path, columns, options.table)


def _read_tdms(path: Path, options: TableOptions) -> Table:
    """Read a TDMS file, one column a channel; a waveform's stamps are from its start and step."""
    tdms = _library(path, "nptdms", "tdms").TdmsFile
    with tdms.open(path) as file:
        channels = {f"{g.name}/{c.name}": c for g in file.groups() for c in g.channels()}
        about = {name: (dict(c.properties), len(c)) for name, c in channels.items()}
    keys = ("wf_start_time", "wf_start_offset", "wf_increment")
    starts = [p["wf_start_time"] for p, _ in about.values() if p.get("wf_start_time") is not None]

    def stamps(start: Any, offset: float | None, step: float, count: int) -> NDArray[np.float64]:
        since = 0.0 if start is None else (start - min(starts)) / np.timedelta64(1, "s")
        return np.asarray(since + (offset or 0.0) + step * np.arange(count))

    def load(group: str, channel: str) -> NDArray[Any]:
        with tdms.open(path) as file:
            return np.asarray(file[group][channel][:])

    columns, waves = dict[str, _Column](), dict[Any, str]()
    for name, (properties, count) in about.items():
        group, _, channel = name.rpartition("/")
        clock = ""
        if properties.get("wf_increment"):
            wave: Any = (group, *map(properties.get, keys), count)
            named = f"{name if group in (w[0] for w in waves) else group}/time"
            clock = waves.setdefault(wave, named)
            columns.setdefault(clock, ("s", "", partial(stamps, *wave[1:])))
        unit = str(properties.get("unit_string", ""))
        columns[name] = unit, clock, partial(load, group, channel)
    return _stamped(path, columns, options.table)


def _read_ulog(path: Path, options: TableOptions) -> Table:
    """Read a PX4 log, one column a field of a topic; ``options.table`` is a topic."""
    log = _library(path, "pyulog", "ulog").ULog(str(path))
    columns = dict[str, _Column]()
    for topic in log.data_list:
        label = f"{topic.name}_{topic.multi_id}" if topic.multi_id else topic.name
        fields, clock = dict(topic.data), f"{label}/time"
        columns[clock] = "s", "", fields.pop("timestamp") / 1e6  # in us since boot
        columns |= {f"{label}/{field}": ("", clock, data) for field, data in fields.items()}
    lost = sum(dropout.duration for dropout in log.dropouts)
    notes = (f"{len(log.dropouts)} dropouts of {lost} ms in all",) if lost else ()
    return _stamped(path, columns, options.table, notes=notes)


_WPILOG_TYPES = {"double": "<f8", "float": "<f4", "int64": "<i8", "boolean": "?"}


def _read_wpilog(path: Path, options: TableOptions) -> Table:
    """Read WPILib's data log, version 1.0: entries of numbers in any order, with stamps in us."""

    def number(stream: io.BytesIO, size: int) -> int:
        return int.from_bytes(stream.read(size), "little")

    data = io.BytesIO(path.read_bytes())
    if not data.read(8).startswith(b"WPILOG"):
        raise BadInput(str(path), "is no WPILib data log", "give the .wpilog of a robot")
    data.read(number(data, 4))
    entries, records = dict[int, str](), dict[str, tuple[str, list[tuple[int, bytes]]]]()
    while head := data.read(1):
        widths = (head[0] & 3) + 1, (head[0] >> 2 & 3) + 1, (head[0] >> 4 & 7) + 1
        entry, size, stamp = (number(data, width) for width in widths)
        payload = data.read(size)
        if entry == 0 and payload[:1] == b"\0":  # an entry starts: its number, name and type
            start = io.BytesIO(payload[1:])
            entry, name = number(start, 4), start.read(number(start, 4)).decode().lstrip("/")
            entries[entry] = name
            records.setdefault(name, (start.read(number(start, 4)).decode(), []))
        elif entry in entries and len(payload) == size:
            records[entries[entry]][1].append((stamp, payload))
    columns = dict[str, _Column]()
    for name, (kind, rows) in records.items():
        dtype = _WPILOG_TYPES.get(kind.removesuffix("[]"))
        if rows and dtype:
            stamps, cells = zip(*sorted(rows, key=lambda row: row[0]), strict=True)
            columns[f"{name}/time"] = "s", "", np.array(stamps) / 1e6
            values = np.frombuffer(b"".join(cells), dtype)
            if kind.endswith("[]"):
                values = _cells([np.frombuffer(cell, dtype) for cell in cells])
            columns[name] = "", f"{name}/time", values
    return _stamped(path, columns, options.table)


# --- ROS ----------------------------------------------------------------------------------------

_TIMES: dict[str, Any] = {
    "builtin_interfaces/msg/Time": np.datetime64,
    "builtin_interfaces/msg/Duration": np.timedelta64,
}
# Units by message definition, by the beginning of a column's name.
_UNITS = {
    # an effort is in N m, or in A, as its driver has it
    "sensor_msgs/msg/JointState": {"position": "rad", "velocity": "rad/s"},
    "geometry_msgs/msg/WrenchStamped": {"wrench.force": "N", "wrench.torque": "N m"},
}
# Packages of messages without measurements.
_NOT_MEASURED = "rcl_interfaces rosbag2_interfaces rosgraph_msgs diagnostic_msgs tf2_msgs"


def _read_bag(path: Path, options: TableOptions) -> Table:
    """Read one topic, ``options.table``, a row a message, with the time that it was ``received``.

    Columns are fields by path, as ``wrench.torque.z`` and ``data[3]``, and joints' signals by name,
    as ``effort[knee]``.
    """
    bags, types = (_library(path, f"rosbags.{name}", "ros") for name in ("highlevel", "typesys"))
    # bags of sqlite3 before ROS 2 Iron hold no definitions
    latest = types.get_typestore(types.Stores.LATEST)
    with bags.AnyReader([path], default_typestore=latest) as reader:
        topic, kind, connections = _topic(path, reader, options.table)
        rows = list[dict[str, Any]]()
        for connection, stamp, raw in reader.messages(connections=connections):
            row = {"received": np.datetime64(stamp, "ns")}
            rows.append(row | _fields(reader.deserialize(raw, connection.msgtype)))
    # of the first message that has each: joints may take turns
    first = {name: value for row in reversed(rows) for name, value in row.items()}
    names = list(dict.fromkeys(name for row in rows for name in row))
    by_name = _UNITS.get(kind, {}).items()
    units = [next((unit for begin, unit in by_name if x.startswith(begin)), "") for x in names]
    times = (np.datetime64, np.timedelta64)
    units = ["s" if isinstance(first[x], times) else u for x, u in zip(names, units, strict=True)]

    def load(index: int) -> NDArray[Any]:
        values = [row.get(names[index]) for row in rows]
        time = isinstance(first[names[index]], times)
        return np.array(values, first[names[index]].dtype) if time else _cells(values)

    where, notes = f"{path}, table '{topic}'", (f"topic {topic} ({kind}), {len(rows)} messages",)
    return Table(where, names, load, units=units, notes=notes, by_rows=True)


def _topic(path: Path, reader: Any, wanted: str | None) -> tuple[str, str, Sequence[Any]]:
    """Choose a topic: its name, its type and its connections."""
    topics = {name: topic for name, topic in reader.topics.items() if topic.msgcount}
    types = {name: topic.msgtype or "several types" for name, topic in topics.items()}
    unlike = (*_NOT_MEASURED.split(), "std_msgs/msg/String")
    useful = [name for name, kind in types.items() if not kind.startswith(unlike)]
    name = _one_of(path, list(topics) if wanted or not useful else useful, wanted)
    if (kind := types[name]) not in reader.typestore.fielddefs:
        problem = f"holds messages of {kind}, of which there is no one definition"
        hint = "record one type a topic, as MCAP, which holds definitions, or 'ros2 bag convert' it"
        raise BadInput(f"{path}, table '{name}'", problem, hint)
    return name, kind, topics[name].connections


def _fields(message: Any) -> dict[str, Any]:
    """Return a message's values by their paths, and those of its joints also by joint."""
    values = dict[str, Any]()
    joints: Any = getattr(message, "name", None) or getattr(message, "joint_names", None)
    if not isinstance(joints, list) or not all(isinstance(joint, str) for joint in joints):
        joints = []

    def walk(value: Any, name: str) -> None:
        if isinstance(value, list) and value and hasattr(value[0], "__msgtype__"):
            for k, part in enumerate(value):
                walk(part, f"{name}[{k}]")
        elif (kind := getattr(value, "__msgtype__", None)) in _TIMES:
            values[name] = _TIMES[kind](int(value.sec) * 10**9 + int(value.nanosec), "ns")
        elif kind:
            for field in dataclasses.fields(value):
                if not field.name.startswith("_"):
                    inner = f"{name}.{field.name}" if name else field.name
                    walk(getattr(value, field.name), inner)
        else:
            values[name] = value
            is_list = isinstance(value, np.ndarray | list) and len(value) == len(joints)
            if is_list and not any(isinstance(part, str) for part in value):
                values.update((f"{name}[{j}]", x) for j, x in zip(joints, value, strict=True))

    walk(message, "")
    return values


# Reader, suffixes and first bytes of each format.
_READERS: dict[Format, tuple[Callable[[Path, TableOptions], Table], tuple[str, ...], bytes]] = {
    "csv": (_read_delimited, (".csv", ".tsv", ".txt", ".dat"), b""),
    "xlsx": (_read_xlsx, (".xlsx", ".xlsm"), b""),
    "hdf5": (_read_hdf5, (".h5", ".hdf5"), b"\x89HDF"),
    "mat": (_read_matlab, (".mat",), b"MATLAB "),
    "json": (_read_json, (".json",), b""),
    "jsonl": (_read_json_lines, (".jsonl", ".ndjson"), b""),
    "npy": (_read_npy, (".npy",), b"\x93NUMPY"),
    "parquet": (_read_parquet, (".parquet",), b"PAR1"),
    "npz": (_read_npz, (".npz",), b""),
    "ros": (_read_bag, (".bag", ".mcap", ".db3"), b"\x89MCAP"),
    "mdf": (_read_mdf, (".mf4", ".mdf"), b"MDF     "),
    "tdms": (_read_tdms, (".tdms",), b"TDSm"),
    "ulog": (_read_ulog, (".ulg",), b"ULog"),
    "wpilog": (_read_wpilog, (".wpilog",), b"WPILOG"),
}
_SUFFIXES = {suffix: kind for kind, (_, suffixes, _) in _READERS.items() for suffix in suffixes}
