"""Readers of files: each opens one format as a table, and leaves its rows as they are."""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import io
import warnings
import zipfile
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from bayesfric.base.errors import BadInput
from bayesfric.base.options import Options
from bayesfric.base.safe_read import check_file, parse_json, unreadable
from bayesfric.recordings.tables import Table, is_number

Format = Literal["csv", "hdf5", "mat", "json", "jsonl", "npy", "parquet", "npz", "ros"]


class TableOptions(Options):
    """How a file is laid out."""

    format: Format | None = Field(None, description="File format; by the suffix if left out.")
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

    @model_validator(mode="after")
    def _two_marks(self) -> Self:
        if self.delimiter is not None and self.delimiter == self.decimal:
            raise ValueError(f"'delimiter' and 'decimal' are both '{self.decimal}'")
        return self


def read_table(path: Path, options: TableOptions) -> Table:
    """Open a recorded file; its columns are read when asked for.

    The format goes by the suffix unless ``options`` give it.
    """
    kind = options.format or ("ros" if _is_bag(path) else _SUFFIXES.get(path.suffix.lower()))
    if kind != "ros" or not _is_bag(path):
        hint = "give a file, a pattern such as '*.csv', or the folder of a ROS 2 bag"
        if check_file(path, hint) == 0:
            raise BadInput(str(path), "is empty", "check whether the recorder wrote anything")
    if kind is None:
        problem = f"the suffix '{path.suffix}' is of no known format"
        raise BadInput(str(path), problem, f"set format to {', '.join(_READERS)}")
    with _damage_named(path, kind):
        table = _READERS[kind][0](path, options)

    def load(index: int) -> NDArray[Any]:
        with _damage_named(path, kind, table.label(table.names[index] or index + 1)):
            return table.load(index)

    return dataclasses.replace(table, load=load).only(options.where)


def is_recording(path: Path) -> bool:
    """Whether something is a file, or a folder that is read as one."""
    return path.is_file() or _is_bag(path)


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, or of the names and SHA-256 of a folder's sorted files."""
    try:
        if path.is_dir():
            files = sorted(file for file in path.iterdir() if file.is_file())
            names = "".join(f"{file.name}\0{sha256(file)}\n" for file in files)
            return hashlib.sha256(names.encode()).hexdigest()
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise unreadable(path, error) from error


def _is_bag(path: Path) -> bool:
    return path.is_dir() and (path / "metadata.yaml").is_file()


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


def _read_text(path: Path) -> str:
    """Return a file's text, which must be UTF-8, or UTF-16 with a byte order mark."""
    data = path.read_bytes()
    kind = "UTF-16" if data.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) else "UTF-8"
    try:
        return data.decode("utf-16" if kind == "UTF-16" else "utf-8-sig")
    except UnicodeDecodeError as error:
        where = f"{path}, byte {error.start}"
        raise BadInput(where, f"is not {kind} text", "save it as UTF-8") from error


def _cells(values: list[Any]) -> NDArray[Any]:
    """Return cells as an array of numbers, (n,) or (n, k), or of objects."""
    plain = [v.tolist() if isinstance(v, np.ndarray | np.generic) else v for v in values]
    with suppress(ValueError):  # lists of different lengths
        if (numbers := np.array(plain)).dtype.kind in "biuf":
            return numbers
    return np.array(plain, dtype=object)


# --- delimited text -----------------------------------------------------------------------------


def _read_delimited(path: Path, options: TableOptions) -> Table:
    """Detect delimiter, header and a row of units; pandas takes the numbers out.

    Unlike pandas' detection this refuses a decimal comma and rows of another width, with their
    line.
    """
    # pandas takes a third of a second to import, which only reading should cost
    import pandas as pd

    text = _read_text(path).replace("\r\n", "\n").replace("\r", "\n").split("\n")
    lines = [n for n, line in enumerate(text, 1) if n > options.skip_rows and line.strip()]
    if not lines:
        after = f" after {options.skip_rows} skipped lines" if options.skip_rows else ""
        raise BadInput(str(path), f"is empty{after}", "check whether the recorder wrote anything")
    # of a commented header, as numpy.savetxt writes it, the mark is no cell
    text = [line.lstrip("#").lstrip() if line.startswith("#") else line for line in text]
    head = [text[n - 1] for n in lines[:400]]
    delimiter = _delimiter(path, head, options)
    rows = [_split(line, delimiter) for line in head]
    flags = [[is_number(cell, options.decimal) for cell in row] for row in rows]
    width = _width(flags)
    header, first = _find_header(path, lines, rows, flags, width)
    body = [text[n - 1] for n in lines[first:]]
    if not body:
        problem = "holds a header but no row of numbers"
        raise BadInput(str(path), problem, "check the recorder's export")
    for n, line in zip(lines[first:], body, strict=True):
        if (count := len(_split(line, delimiter))) != width:
            problem = f"has {count} cells, the table has {width} columns"
            raise BadInput(f"{path}, line {n}", problem, "correct the row, or cut the file there")
    separator = r"\s+" if delimiter == "whitespace" else delimiter
    try:
        frame = pd.read_csv(
            io.BytesIO("\n".join(body).encode()), sep=separator, header=None,
            decimal=options.decimal, na_filter=False, skipinitialspace=True, low_memory=False,
        )  # fmt: skip
    except (pd.errors.ParserError, ValueError) as error:
        problem = f"is not readable as CSV ({error})"
        raise BadInput(str(path), problem, "check its rows and quotes") from error
    if frame.shape != (len(body), width):
        problem = f"has {len(body)} lines of {width} cells, read as {frame.shape[0]} rows of "
        raise BadInput(str(path), f"{problem}{frame.shape[1]}", "close the quotes")
    names, units, notes = [""] * width, list[str](), list[str]()
    if header is not None:
        names = list(rows[header])
        if first - header == 2:
            units = [cell.strip("[]()") for cell in rows[header + 1]]
            notes.append(f"line {lines[header + 1]} taken as a row of units and skipped")
    top = first if header is None else header
    if top:
        notes.append(f"{lines[top] - 1} lines above the table skipped")
    return Table(
        str(path),
        names,
        lambda index: frame.iloc[:, index].to_numpy(),
        units=units,
        lines=lines[first:],
        header=f"line {lines[top]}",
        decimal=options.decimal,
        notes=tuple(notes),
    )


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


def _delimiter(path: Path, lines: Sequence[str], options: TableOptions) -> str:
    """Return the given delimiter, or the one with which most cells are numbers."""
    if options.delimiter:
        return {"tab": "\t", " ": "whitespace"}.get(options.delimiter, options.delimiter)

    def best(decimal: str) -> tuple[int, str]:
        counts = list[tuple[int, str]]()
        for delimiter in (",", ";", "\t", "|", "whitespace"):
            cells = (_split(line, delimiter) for line in lines if delimiter != decimal)
            flags = [[is_number(cell, decimal) for cell in row] for row in cells]
            width = _width(flags)
            counts.append((sum(sum(f) for f in flags if len(f) == width > 1), delimiter))
        return max(counts, key=lambda count: count[0])

    count, delimiter = best(options.decimal)
    if options.decimal == "." and best(",")[0] > count:
        raise BadInput(str(path), "its numbers have a decimal comma", 'set decimal = ","')
    return delimiter


def _width(flags: Sequence[Sequence[bool]]) -> int:
    """Return the number of columns of the lines with most numbers, 0 if there are none."""
    counts = Counter[int]()
    for line in flags:
        counts[len(line)] += sum(line)
    weight, width = max(((weight, width) for width, weight in counts.items()), default=(0, 0))
    return width if weight else 0


def _find_header(
    path: Path,
    lines: Sequence[int],
    rows: Sequence[Sequence[str]],
    flags: Sequence[Sequence[bool]],
    width: int,
) -> tuple[int | None, int]:
    """Find header and first row of the table of ``width`` columns."""
    like = [len(row) == width for row in rows]
    fitting = (n for n, row in enumerate(flags) if like[n] and 2 * sum(row) >= width > 0)
    first = next(fitting, -1)
    if first < 0 and len(rows) > 2:
        problem = "in no row is half of the cells numbers"
        hint = "check delimiter, decimal and skip_rows, or whether this is a text table at all"
        raise BadInput(f"{path}, line {lines[len(rows) - 1]}", problem, hint)
    if first < 0:
        return 0, len(rows)
    while first > 0 and like[first - 1] and any(flags[first - 1]):
        first -= 1
    # pandas' names of columns without one are 0, 1, ..., behind an empty name of its index
    counted = [str(k) for k in range(width)]
    decimals = all("." in cell for cell in rows[min(first + 1, len(rows) - 1)])
    if list(rows[first]) in (["", *counted[:-1]], counted * decimals) and width > 1:
        return first, first + 1
    if first and not like[first - 1] and any(flags[first - 1]):
        # data that would be lost silently
        problem = f"has {len(rows[first - 1])} cells, the rows below have {width}"
        hint = "correct the row, or set skip_rows if it is no row of the table"
        raise BadInput(f"{path}, line {lines[first - 1]}", problem, hint)
    if not first or not like[first - 1]:
        return None, first
    missing = {"", "nan", "na", "n/a", "null", "none", "inf", "-inf", "-", "--", "?"}
    with_units = first > 1 and like[first - 2] and not any(flags[first - 2])
    with_units = with_units and missing.isdisjoint(cell.casefold() for cell in rows[first - 1])
    return first - 1 - with_units, first


# --- JSON ---------------------------------------------------------------------------------------


def _read_json(path: Path, options: TableOptions) -> Table:
    """Read a list of objects, or an object of lists; one column a key.

    It is at the path ``options.table``, at the top, or the only list of objects in the file.
    """
    data = _inside(str(path), parse_json(str(path), _read_text(path)), options.table)
    if options.table is None and isinstance(data, dict):
        rows = [
            key
            for key, value in data.items()
            if isinstance(value, list) and value and all(isinstance(row, dict) for row in value)
        ]
        if len(rows) > 1:
            problem = f"holds several tables ({', '.join(map(repr, rows[:20]))})"
            raise BadInput(str(path), problem, "name one with table")
        data = data[rows[0]] if rows else data
    if isinstance(data, list):
        return _from_rows(path, data)
    if not isinstance(data, dict) or not any(isinstance(value, list) for value in data.values()):
        problem = "is neither a list of objects nor an object of lists"
        raise BadInput(str(path), problem, "give the dotted path to it with table")
    values = [value if isinstance(value, list) else None for value in data.values()]

    def load(index: int) -> NDArray[Any]:
        value = values[index]
        return np.array(None) if value is None else _cells(value)

    return Table(str(path), list(data), load)


def _read_json_lines(path: Path, options: TableOptions) -> Table:
    """Read an object a line, one column a key; blank lines are left out.

    ``options.table`` is the path of keys to the object with the columns, the same in each line.
    """
    text = enumerate(_read_text(path).split("\n"), start=1)
    places = {n: (f"{path}, line {n}", line) for n, line in text if line.strip()}
    parsed = ((where, parse_json(where, line)) for where, line in places.values())
    rows = [_inside(where, row, options.table) for where, row in parsed]
    return _from_rows(path, rows, list(places))


def _inside(where: str, data: Any, table: str | None) -> Any:
    """Follow a dotted path of keys."""
    for key in [] if table is None else table.split("."):
        if not isinstance(data, dict) or key not in data:
            known = ", ".join(map(repr, data)) if isinstance(data, dict) else ""
            hint = f"it has {known}" if known else "give the path to the rows"
            raise BadInput(f"{where}, table '{table}'", f"there is no key '{key}'", hint)
        data = data[key]
    return data


def _from_rows(path: Path, rows: list[Any], lines: Sequence[int] | None = None) -> Table:
    """Make a table of objects, one a row, at some ``lines`` of the file."""
    if not rows:
        raise BadInput(str(path), "holds no rows", "check the recorder's export")
    names = list(dict.fromkeys(key for row in rows if isinstance(row, dict) for key in row))

    def load(index: int) -> NDArray[Any]:
        return _cells([row.get(names[index]) for row in rows])

    table = Table(str(path), names, load, lines=lines, by_rows=True)
    wrong = next((k for k, row in enumerate(rows) if not isinstance(row, dict)), None)
    if wrong is not None:
        where = f"{path}, {table.row(wrong)}"
        raise BadInput(where, "is no object", "give an object a row")
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
    with zipfile.ZipFile(path) as archive:
        names = [name.removesuffix(".npy") for name in archive.namelist()]

    def load(index: int) -> NDArray[Any]:
        with np.load(path, allow_pickle=False) as arrays:
            return np.squeeze(np.asarray(arrays[names[index]]))

    return Table(str(path), names, load)


def _read_parquet(path: Path, _: TableOptions) -> Table:
    """Read a file, one column a field, each when asked for."""
    # pyarrow takes long to import, which only reading Parquet should cost
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = pq.read_schema(path)

    def load(index: int) -> NDArray[Any]:
        kind, name = schema.types[index], schema.names[index]
        plain = getattr(kind, "value_type", kind)
        unlike = (pa.types.is_nested, pa.types.is_time, pa.types.is_duration, pa.types.is_binary)
        if any(is_kind(plain) for is_kind in unlike):
            problem = f"holds {str(kind)[:60]}, not numbers"
            raise BadInput(f"{path}, column '{name}'", problem, "export it as numbers")
        # by name: a name with a dot also selects a field inside a table
        with pq.ParquetFile(path) as file:
            column = file.read(columns=[name]).column(name)
        if plain is kind and not column.null_count and not pa.types.is_decimal(kind):
            return np.asarray(column.to_numpy())
        return _cells(column.to_pylist())

    return Table(str(path), schema.names, load, by_rows=True)


def _read_hdf5(path: Path, options: TableOptions) -> Table:
    """Read a file, one column a dataset, named by its path below the group that is the table.

    Without ``options.table``, its path, the only group with datasets, else the whole file.
    """
    return _datasets(path, options.table or "", matlab=False)


def _datasets(path: Path, table: str, *, matlab: bool) -> Table:
    # h5py takes long to import, which only reading HDF5 should cost
    import h5py

    datasets: list[str] = []

    def visit(name: str, item: Any) -> None:
        # MATLAB's internal datasets begin with #
        if isinstance(item, h5py.Dataset) and not name.startswith("#"):
            datasets.append(name)

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    if not datasets:
        raise BadInput(str(path), "holds no datasets of numbers", "check the export")
    groups = list(dict.fromkeys(name.rpartition("/")[0] for name in datasets))
    table = table.strip("/") or (groups[0] if len(groups) == 1 else "")
    prefix = f"{table}/" if table else ""
    names = [name.removeprefix(prefix) for name in datasets if name.startswith(prefix)]
    if not names:
        known = ", ".join(f"'{name}'" for name in groups[:20] if name)
        hint = f"it has {known}" if known else "leave table out"
        raise BadInput(f"{path}, table '{table}'", "there is no such group with datasets", hint)

    def load(index: int) -> NDArray[Any]:
        with h5py.File(path, "r") as file:
            dataset = file[prefix + names[index]]
            kind = dataset.attrs.get("MATLAB_class", b"")
            # MATLAB's text and cells are numbers to HDF5
            if kind in (b"char", b"cell", b"function_handle") or dataset.dtype.kind not in "biuf":
                text = kind.decode() if isinstance(kind, bytes) and kind else dataset.dtype.name
                where, problem = f"{path}, column '{names[index]}'", f"holds {text}, not numbers"
                raise BadInput(where, problem, "export it as numbers")
            if dataset.shape is None or dataset.attrs.get("MATLAB_empty", 0):
                return np.empty(0)
            # MATLAB stores arrays transposed, and knows no vectors
            values = np.asarray(dataset[()])
            return np.squeeze(values.T if matlab else values)

    return Table(str(path), names, load, clocks=_clocks(names))


def _clocks(names: Sequence[str]) -> dict[str, str]:
    """Give the columns of each group that holds time stamps those as their clocks."""
    stamps = ("time", "timestamp", "timestamps", "stamp", "stamps", "t")
    groups = {name: name.rpartition("/") for name in names if "/" in name}
    times = {group: name for name, (group, _, last) in groups.items() if last.lower() in stamps}
    clocks = {name: times[group] for name, (group, _, _) in groups.items() if group in times}
    return {name: clock for name, clock in clocks.items() if name != clock}


def _read_matlab(path: Path, options: TableOptions) -> Table:
    """Read a file, one column a variable; ``options.table`` is a dotted path of structs."""
    with path.open("rb") as file:
        start = file.read(516)
    # of version 7.3, which is HDF5 behind a header of 512 bytes
    if start.startswith(b"MATLAB 7.3") or b"\x89HDF" in (start[:4], start[512:]):
        return _datasets(path, (options.table or "").replace(".", "/"), matlab=True)
    from scipy.io import loadmat

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # objects have no names, and seem doubled
        content = loadmat(path, simplify_cells=True)
    content = {key: value for key, value in content.items() if not str(key).startswith("__")}
    variables = _inside(str(path), content, options.table)
    if not isinstance(variables, dict) or not variables:
        where = f"{path}, table '{options.table}'" if options.table else str(path)
        raise BadInput(where, "holds no variables", "name a struct of vectors with table")
    values = list(variables.values())
    return Table(str(path), list(map(str, variables)), lambda index: np.asarray(values[index]))


# --- ROS ----------------------------------------------------------------------------------------

_STAMP, _DURATION = "builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"
# Units by message definition, by the beginning of a column's name.
_UNITS = {
    "sensor_msgs/msg/JointState": {"position": "rad", "velocity": "rad/s", "effort": "N m"},
    "geometry_msgs/msg/WrenchStamped": {"wrench.force": "N", "wrench.torque": "N m"},
}
# Message types without measurements.
_NOT_MEASURED = (
    "rcl_interfaces/", "rosbag2_interfaces/", "rosgraph_msgs/", "diagnostic_msgs/", "tf2_msgs/",
    "std_msgs/msg/String",
)  # fmt: skip


def _read_bag(path: Path, options: TableOptions) -> Table:
    """Read one topic, a row a message; ``options.table`` is the topic, if there are several.

    Columns are fields by path, as ``wrench.torque.z`` and ``data[3]``, and joints' signals by name,
    as ``effort[knee]``. ``received`` and stamps are in s since the first message.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        hint = "pip install 'bayesfric[ros]'"
        raise BadInput(str(path), "is a ROS bag, read by rosbags", hint) from error
    # bags of sqlite3 before ROS 2 Iron hold no definitions
    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
        topic, kind, connections = _topic(path, reader, options.table)
        received, rows = list[int](), list[dict[str, Any]]()
        for connection, stamp, raw in reader.messages(connections=connections):
            received.append(int(stamp))
            rows.append(_fields(reader.deserialize(raw, connection.msgtype)))
    # of the first message that has each: joints may take turns
    first = {name: value for row in reversed(rows) for name, value in row.items()}
    names = list(dict.fromkeys(name for row in rows for name in row))
    units = [("s" if _is_time(first[name]) else _unit(kind, name)) for name in names]

    def load(index: int) -> NDArray[Any]:
        if index == 0:
            return _since_first(received)
        name = names[index - 1]
        values: list[Any] = [row.get(name) for row in rows]
        if not _is_time(first[name]):
            return _cells(values)
        stamps = [int(v.sec) * 10**9 + int(v.nanosec) for v in values]
        if first[name].__msgtype__ == _STAMP:
            return _since_first(stamps)
        return np.array([stamp / 10**9 for stamp in stamps])

    return Table(
        f"{path}, table '{topic}'",
        ["received", *names],
        load,
        units=["s", *units],
        notes=(f"topic {topic} ({kind}), {len(rows)} messages",),
        by_rows=True,
    )


def _topic(path: Path, reader: Any, wanted: str | None) -> tuple[str, str, Sequence[Any]]:
    """Choose a topic: its name, its type and its connections."""
    topics = {name: topic for name, topic in reader.topics.items() if topic.msgcount}
    types = {name: topic.msgtype or "several types" for name, topic in topics.items()}
    useful = [name for name, kind in types.items() if not kind.startswith(_NOT_MEASURED)]
    if wanted is None and len(useful) == 1:
        wanted = useful[0]
    where = str(path) if wanted is None else f"{path}, table '{wanted}'"
    if wanted is None or wanted not in topics:
        known = ", ".join(f"'{name}'" for name in (useful or list(topics))[:20])
        problem = "there is no message on this topic" if wanted else "holds no one topic of numbers"
        hint = f"name one of {known} with table" if known else "check what was recorded"
        raise BadInput(where, problem, hint)
    kind = types[wanted]
    if kind not in reader.typestore.fielddefs:
        problem = f"holds messages of {kind}, of which there is no one definition"
        hint = "record one type a topic, as MCAP, which holds definitions, or 'ros2 bag convert' it"
        raise BadInput(where, problem, hint)
    return wanted, kind, topics[wanted].connections


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
        elif hasattr(value, "__msgtype__") and not _is_time(value):
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


def _unit(kind: str, name: str) -> str:
    units = _UNITS.get(kind, {}).items()
    return next((unit for begin, unit in units if name.startswith(begin)), "")


def _is_time(value: Any) -> bool:
    return getattr(value, "__msgtype__", None) in (_STAMP, _DURATION)


def _since_first(stamps: list[int]) -> NDArray[np.float64]:
    """Convert stamps in ns to seconds since the first, without loss."""
    return np.array([(stamp - stamps[0]) / 10**9 for stamp in stamps])


_READERS: dict[Format, tuple[Callable[[Path, TableOptions], Table], tuple[str, ...]]] = {
    "csv": (_read_delimited, (".csv", ".tsv", ".txt", ".dat")),
    "hdf5": (_read_hdf5, (".h5", ".hdf5")),
    "mat": (_read_matlab, (".mat",)),
    "json": (_read_json, (".json",)),
    "jsonl": (_read_json_lines, (".jsonl", ".ndjson")),
    "npy": (_read_npy, (".npy",)),
    "parquet": (_read_parquet, (".parquet",)),
    "npz": (_read_npz, (".npz",)),
    "ros": (_read_bag, (".bag", ".mcap", ".db3")),
}
_SUFFIXES = {suffix: kind for kind, (_, suffixes) in _READERS.items() for suffix in suffixes}
