"""Recordings nobody would make: damaged at byte level, or made of odd parts."""

import io
import json
import zipfile
from copy import deepcopy
from functools import cache

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.io import savemat

from tests.hostile import good
from tests.hostile.mutation import mutated

ODD_TEXT = (
    "", " ", "nan", "NaN", "inf", "-inf", "1e999", "-1e-999", "1e308", "-1e308", "1e-320", "0",
    "-0", "1_0", "0x1F", "1,5", "1.5.2", "--1", "+", ".", "e5", "1e", "True", "false", "None",
    "2020-01-01", "1+2j", '"', '""', '"1"', "'", "#", "\\", "\t", ";", "|", "\x0b", "\x0c",
    "\x1b[31m", "\x85", "\u2028", "\u00a0", "\u0661", "\ufeff", "é", "😀", "=1+1", "9" * 400,
    "1" * 25, "18446744073709551616", "-9223372036854775809", "a" * 300, "\0",
)  # fmt: skip
ODD_VALUES = (
    np.nan, np.inf, -np.inf, 1e308, -1e308, 1e200, 1e16, -1e16, 1e-320, 1e-200, 0.0, -0.0, 1e15,
)  # fmt: skip
ODD_NAMES = (
    "", "q", "Q", "t ", "tau\n", "a.b", "q.", "/q", "../q", "\ufeffq", "q\0", "é", "t" * 400,
)  # fmt: skip
ODD_JSON = (
    None, True, "x", "", "1", [], [1], {}, {"a": 1}, 10**400, -(10**30), float("nan"),
    float("inf"), 1e308, "\ud800", "\0", [[[]]],
)  # fmt: skip
# of .npy headers, which numpy reads as Python
ODD_TYPES = (
    "'<f8'", "'|O'", "'<U9999999'", "'|V0'", "'<f16'", "[('a','<f8')]", "'<f8,<i4'", "'x'",
    "'<M8[ns]'", "'<f8'*9", "b'<f8'", "None", "[[['a']]]", "'<c16'", "'>f8'",
)  # fmt: skip
ODD_SHAPES = (
    "(250,)", "(250,)", "()", "(0,)", "(-1,)", "(250, 1)", "(1e3,)", "(10**9,)",
    "(99999999999999,)", "(9223372036854775807,)", "(2**70,)", "(1000000000000000000000,)",
    "(250,)*9", "'a'", "(True,)", "250", "(((((250,),),),),)", "(3000000000,)",
)  # fmt: skip


@cache
def _good(form):
    return good.content(form)


def damaged(form, rng):
    """A good file with some bytes changed."""
    return mutated(_good(form), rng, near=None if "json" in form or form in "csv tsv" else 120)


def _pick(rng, values):
    return values[int(rng.integers(len(values)))]


def odd_columns(rng):
    """Columns of the good recording with odd values, lengths, types and shapes."""
    data = good.columns()
    for _ in range(int(rng.integers(1, 3))):
        name = _pick(rng, list(data))
        values = np.atleast_1d(data[name])
        match int(rng.integers(14)):
            case 0 if values.dtype.kind == "f" and values.size:
                values = values.copy()
                at = rng.integers(values.size, size=int(rng.integers(1, 4)))
                with np.errstate(all="ignore"):
                    values.flat[at] = _pick(rng, ODD_VALUES)
            case 1 if values.dtype.kind == "f":
                values = np.full(values.shape, _pick(rng, ODD_VALUES))
            case 2 if values.dtype.kind == "f":
                with np.errstate(all="ignore"):
                    values = values * 10.0 ** rng.uniform(-330, 308)
            case 3:
                values = values[: int(rng.integers(len(values) + 1))]
            case 4:
                values = np.repeat(values, 2)
            case 5:
                values = values[::-1]
            case 6:
                values = np.sort(values)
            case 7 if values.dtype.kind == "f":
                kinds = ["?", "i1", "u8", ">f4", "f2", "c16", "S5", "U3", "M8[ns]", "m8[s]"]
                kind = _pick(rng, kinds)
                with np.errstate(all="ignore"):
                    values = np.nan_to_num(values).astype("i8").astype(kind)
            case 8:
                values = np.stack([values, values])
            case 9:
                values = values.ravel()[:1].reshape(()) if values.size else values
            case 10:
                values = values.reshape(-1, 1, 1)
            case 11:
                data[_pick(rng, ODD_NAMES)] = data.pop(name)
                continue
            case 12:
                values = np.empty(0)
            case _:
                if values.dtype.kind == "f" and values.size:
                    noise = rng.standard_normal(values.shape)
                    values = values + noise * 10.0 ** rng.uniform(-18, 2)
        data[name] = values
    return data


def odd_csv(rng):
    lines = _good("csv").decode().split("\n")
    mark = _pick(rng, [",", ";", "\t", "|", " ", "  ", ", "])
    rows = [line.split(",") for line in lines]
    for _ in range(int(rng.integers(1, 4))):
        row = _pick(rng, rows[:5]) if rng.random() < 0.5 else _pick(rng, rows)
        match int(rng.integers(8)):
            case 0 if row:
                row[int(rng.integers(len(row)))] = _pick(rng, ODD_TEXT)
            case 1:
                row.append(_pick(rng, ODD_TEXT))
            case 2:
                row.clear()
                row.append(_pick(rng, ODD_TEXT))
            case 3:
                rows.insert(int(rng.integers(8)), [_pick(rng, ODD_TEXT)] * int(rng.integers(1, 6)))
            case 4:
                text, column = _pick(rng, ODD_TEXT), int(rng.integers(3))
                for other in rows[1:]:
                    if len(other) > column:
                        other[column] = text
            case 5:
                del rows[: int(rng.integers(1, 4))]
                rows = rows or [[""]]
            case 6:
                del rows[int(rng.integers(1, 8)) :]
            case _:
                at = int(rng.integers(len(rows)))
                rows[at:at] = [list(row)] * int(rng.integers(1, 30))
    end = _pick(rng, ["\n", "\r\n", "\r", "\n\n", "\n\r"])
    text = end.join(mark.join(row) for row in rows)
    encoding = _pick(rng, ["utf-8"] * 6 + ["utf-8-sig", "utf-16", "utf-16-le", "latin-1", "utf-32"])
    return text.encode(encoding, errors="replace")


def odd_json(rng):
    if rng.random() < 0.5:
        table = {k: np.asarray(v).ravel().tolist() for k, v in good.columns().items()}
        for _ in range(int(rng.integers(1, 4))):
            name = _pick(rng, list(table))
            value = deepcopy(_pick(rng, ODD_JSON))
            if rng.random() < 0.5 and table[name] and isinstance(table[name], list):
                table[name][int(rng.integers(len(table[name])))] = value
            elif rng.random() < 0.5:
                table[name] = value
            else:
                table[_pick(rng, ODD_NAMES)] = table.pop(name)
        data = table
    else:
        data = json.loads(_good("rows.json"))
        for _ in range(int(rng.integers(1, 4))):
            at = int(rng.integers(len(data)))
            if rng.random() < 0.3 or not isinstance(data[at], dict) or not data[at]:
                data[at] = deepcopy(_pick(rng, ODD_JSON))
            elif rng.random() < 0.5:
                data[at][_pick(rng, list(data[at]))] = deepcopy(_pick(rng, ODD_JSON))
            else:
                data[at][_pick(rng, ODD_NAMES)] = data[at].pop(_pick(rng, list(data[at])))
    for _ in range(int(rng.integers(0, 3))):
        data = {_pick(rng, ODD_NAMES): data} if rng.random() < 0.5 else [data]
    text = json.dumps(data, ensure_ascii=rng.random() < 0.7)
    return text.encode(_pick(rng, ["utf-8"] * 4 + ["utf-16", "utf-8-sig"]), errors="surrogatepass")


def _npy(header, body, version=(1, 0)):
    text = header.encode("latin-1", errors="replace")
    width = 2 if version == (1, 0) else 4
    return b"\x93NUMPY" + bytes(version) + len(text).to_bytes(width, "little") + text + body


def odd_npz(rng):
    """Archives with odd members; their headers are text that numpy reads as Python."""
    out = io.BytesIO()
    if rng.random() < 0.5:
        columns = {k: v for k, v in odd_columns(rng).items() if k and "\0" not in k}
        np.savez(out, **{k if k != "file" else "f": v for k, v in columns.items()})
        return out.getvalue()
    body = np.arange(good.N, dtype="<f8").tobytes()
    descr, shape = _pick(rng, ODD_TYPES), _pick(rng, ODD_SHAPES)
    order = _pick(rng, ["False", "False", "True", "None", "'x'"])
    header = f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}"
    match int(rng.integers(8)):
        case 0:
            header = "[" * int(rng.integers(1, 5000))
        case 1:
            header = header[: int(rng.integers(len(header)))]
        case 2:
            header = "{" + "'a':" * 2000
    member = _npy(header + "\n", body, _pick(rng, [(1, 0), (1, 0), (2, 0), (3, 0), (9, 9)]))
    if rng.random() < 0.2:
        member = member[: int(rng.integers(len(member)))]
    method = _pick(rng, [0, 8, 8, 12, 14])
    with zipfile.ZipFile(out, "w", method) as archive:
        odd = _pick(rng, ["../x.npy", "/etc/x.npy", "q", "a/", "x\n.npy"])
        plain = _npy("{'descr': '<f8', 'fortran_order': False, 'shape': (250,), }\n", body)
        for name in ("t.npy", "q.npy", "tau.npy", odd):
            archive.writestr(name, member if rng.random() < 0.5 else plain)
    data = bytearray(out.getvalue())
    if rng.random() < 0.3:
        # the flags, method and sizes that local and central directory repeat
        at = data.rfind(b"PK\x01\x02") + int(rng.integers(6, 30))
        data[at] = int(rng.integers(256))
    return bytes(data)


def odd_mat(rng):
    out = io.BytesIO()
    columns: dict = {}
    for name, values in odd_columns(rng).items():
        name = name if name.isidentifier() and len(name) < 30 else "x"
        kind = np.asarray(values).dtype.kind
        columns[name] = values if kind not in "SMm" else np.asarray(values).astype("U")
    match int(rng.integers(6)):
        case 0:
            columns["c"] = np.array([[1.0, "a", 2.0, "b"]], dtype=object)
        case 1:
            columns["q"] = np.array([{"a": 1.0}, {"b": {"c": 2}}], dtype=object)
        case 2:
            from scipy.sparse import csc_array

            columns[_pick(rng, ["q", "x"])] = csc_array(np.eye(int(rng.integers(1, 5))))
        case 3:
            deep = 1.0
            for _ in range(int(rng.integers(1, 25))):
                deep = {"a": deep}
            columns["s"] = deep
        case 4:
            columns["q"] = "text"
    arrays = {k: np.ascontiguousarray(v) for k, v in columns.items() if isinstance(v, np.ndarray)}
    packed, way = bool(rng.random() < 0.3), _pick(rng, ["row", "column"])
    savemat(out, columns | arrays, do_compression=packed, oned_as=way)
    data = out.getvalue()
    return mutated(data, rng) if rng.random() < 0.5 else data


def odd_parquet(rng):
    n = good.N
    data = {k: np.asarray(v) for k, v in odd_columns(rng).items()}
    arrays, names = [], []
    for name, values in data.items():
        values = np.resize(values.ravel(), n) if values.size else np.zeros(n)
        names.append(name)
        try:
            arrays.append(pa.array(values))
        except pa.ArrowException:
            arrays.append(pa.array(np.arange(float(n))))
    at = int(rng.integers(len(arrays)))
    floats = np.linspace(0, 1, n).tolist()
    match int(rng.integers(12)):
        case 0:
            arrays[at] = pa.array([[x] for x in floats])
        case 1:
            arrays[at] = pa.array([{"t": x, "q": {"z": x}} for x in floats])
        case 2:
            arrays[at] = pa.array([[(1, x)] for x in floats], pa.map_(pa.int32(), pa.float64()))
        case 3:
            arrays[at] = pa.array([int(x * 100) for x in floats], pa.time32("ms"))
        case 4:
            arrays[at] = pa.array([int(x * 100) for x in floats], pa.duration("ns"))
        case 5:
            arrays[at] = pa.nulls(n, _pick(rng, [pa.null(), pa.float64(), pa.list_(pa.int8())]))
        case 6:
            arrays[at] = pa.array(["x"] * n).dictionary_encode()
        case 7:
            arrays[at] = pa.array([b"\xff"] * n)
        case 8:
            arrays[at] = pa.array(floats, mask=np.arange(n) == int(rng.integers(n)))
        case 9:
            from decimal import Decimal

            arrays[at] = pa.array([Decimal(i) for i in range(n)], pa.decimal128(38, 2))
        case 10:
            names[at] = _pick(rng, names)
        case 11:
            arrays[at] = pa.array([int(x * 1e6) for x in floats], pa.timestamp("us", "UTC"))
    if rng.random() < 0.3:
        names.append(_pick(rng, ["q.z", "t.q", "q", "", "tau.list.element"]))
        arrays.append(pa.array(floats))
    out = io.BytesIO()
    try:
        pq.write_table(pa.Table.from_arrays(arrays, names=names), out, row_group_size=50)
    except (pa.ArrowException, ValueError):
        return b"PAR1"
    return out.getvalue()


ODD = {"csv": odd_csv, "json": odd_json, "npz": odd_npz, "mat": odd_mat, "parquet": odd_parquet}
