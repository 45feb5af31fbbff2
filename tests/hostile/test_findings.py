"""Each input that once ended in something else than one line, as small as it can be written."""

import io
import json
import struct
import warnings
import zipfile
import zlib

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bayesfric.recordings.units import quantity
from tests.commands.bench import cases, has
from tests.hostile import good
from tests.hostile.rule import SECONDS, at_most, broken_rule, check, refuses


def refused(tmp_path, recording, form, *, extra="", parts=(), edit=("", "")):
    (tmp_path / f"run.{form}").write_bytes(recording)
    path = tmp_path / "c.toml"
    text = good.config(f"run.{form}", extra)
    assert edit[0] in text
    path.write_text(text.replace(*edit, 1) if edit[0] else text)
    refuses(path, *parts)


def rows(n=60):
    return good.content("csv", n).decode().splitlines()


ROWS = "\n".join(rows()[1:]) + "\n"
TIME = 'time = { column = "t", unit = "s" }'

# -- what cells, archives and arrays hold: form, bytes, further keys, words of the complaint


def npz(**members):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, member in members.items():
            archive.writestr(f"{name}.npy", member)
    return out.getvalue()


def npy(header="{'descr': '<f8', 'fortran_order': False, 'shape': (250,), }", body=None):
    text = header.encode()
    body = np.arange(250.0).tobytes() if body is None else body
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + body


def patched(data, offset, value):
    """Change bytes of each entry of an archive's central directory."""
    data = bytearray(data)
    at = data.find(b"PK\x01\x02")
    while at >= 0:
        data[at + offset : at + offset + len(value)] = value
        at = data.find(b"PK\x01\x02", at + 4)
    return bytes(data)


ARCHIVE = npz(t=npy(), q=npy(), tau=npy())


def element(kind, content):
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def integers(*values):
    return element(5, struct.pack(f"<{len(values)}i", *values))


def matrix(name, kind, shape, *parts):
    content = element(6, struct.pack("<II", kind, 0))
    content += integers(*shape) + element(1, name)
    return element(14, content + b"".join(parts))


def mat(*matrices):
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"".join(matrices)


BIG, NUMBERS = 2**31 - 1, np.arange(250.0).tobytes()
N = good.N


def doubled():
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # duplicate name
        for name in ("t", "q", "tau", "q"):
            archive.writestr(f"{name}.npy", npy())
    return out.getvalue()


def long_double():
    out, data = io.BytesIO(), good.columns()
    data["q"] = data["q"].astype(np.longdouble) * np.longdouble("1e4000")
    np.savez(out, **data)
    return out.getvalue()


def claimed(odd):
    others = (matrix(name, 6, (250, 1), element(9, NUMBERS)) for name in (b"t", b"tau"))
    return mat(matrix(b"q", *odd), *others)


def many_cells():
    """Each takes eight bytes in the file, and hundreds in memory."""
    packed = zlib.compress(matrix(b"q", 1, (3_000_000, 1), element(14, b"") * 3_000_000))
    return mat(struct.pack("<II", 15, len(packed)) + packed)


def with_q(form, q):
    return good.content(form, data=good.columns() | {"q": q})


def half_of_a_pair():
    data = {name: list(values) for name, values in good.columns().items()}
    return json.dumps({("\ud800tau" if k == "tau" else k): v for k, v in data.items()}).encode()


TEXTS = cases(
    # no row had as many cells as the header and half of them numbers: StopIteration
    ("few-numbers", "a,b,c,d,e\n1,x,y,z,w\n1,x,y,z,v\n", "", ["half of the cells"]),
    # csv.Error: field larger than field limit (131072)
    ("long-cell", '1,2,"' + "9" * 140_000 + '"\n', "", ["run.csv"]),
    ("long-line", "1,2,3\n" + "9" * 1_100_000 + "\n", "", ["line 2"]),
    # islice takes no number above sys.maxsize
    ("skip", "1,2,3\n" * 90, f"\nskip_rows = {2**63}", ["is empty after"]),
    # str.split takes more characters for space than pandas does
    ("vertical-tab", "t q\x0btau\n" + "1 2\x0b3\n" * 90, "\ndelimiter = ' '", ["run.csv"]),
    ("no-break", "t q\xa0tau\n" + "1 2\xa03\n" * 90, "\ndelimiter = ' '", ["run.csv"]),
    # pandas refuses these, and csv would take them for quotes or ends of line
    ("quote", "1,2,3\n" * 90, "\ndelimiter = '\"'", ["recordings.1.delimiter"]),
    ("newline", "1,2,3\n" * 90, '\ndelimiter = "\\n"', ["recordings.1.delimiter"]),
    ("digit", "1,2,3\n" * 90, '\ndelimiter = "2"', ["recordings.1.delimiter"]),
    ("letter", "1,2,3\n" * 90, '\ndelimiter = "é"', ["recordings.1.delimiter"]),
    # a terminal would have obeyed it
    ("escape", "t,q,\x1b[31mtau\n" + ROWS, "", ["\\x1b[31mtau"]),
    ("long-name", "t,q," + "x" * 90_000 + "\n" + ROWS, "", ["'tau'"]),
)
ARCHIVES = cases(
    ("version", patched(ARCHIVE, 6, b"\xff\x00"), ["run.npz", "NotImplementedError"]),
    ("encrypted", patched(ARCHIVE, 8, b"\x01"), ["run.npz", "RuntimeError"]),
    ("method", patched(ARCHIVE, 10, b"\x63"), ["run.npz", "NotImplementedError"]),
    ("lzma", patched(ARCHIVE, 10, b"\x0e"), ["run.npz"]),
    ("bzip2", patched(ARCHIVE, 10, b"\x0c"), ["run.npz"]),
    ("extra-field", patched(ARCHIVE, 30, b"\x01"), ["run.npz"]),
    ("token", npz(t=npy("{'descr': ("), q=npy(), tau=npy()), ["run.npz"]),
    ("deep", npz(t=npy("[" * 9000), q=npy("[" * 9000), tau=npy()), ["run.npz"]),
    # showed <ast.BinOp object at 0x7f...>
    (
        "sum",
        npz(q=npy("{'descr': '<f8'*9, 'fortran_order': 0, 'shape': ()}")),
        ["'q'", "header"],
    ),
    # a zip file behind a .npy header: numpy.load gives an array, which is no context
    ("array-then-zip", npy() + ARCHIVE, ["run.npz"]),
    ("doubled-names", doubled(), ["run.npz", "both named 'q'"]),
    ("long-double", long_double(), ["run.npz", "'q'", "finite"]),
)
MATRICES = cases(
    # more of everything than there are bytes
    ("text", (4, (BIG, 1), element(16, b""))),
    ("text-short", (4, (BIG, 2), element(16, b"x"))),
    ("text-wide", (4, (1, BIG), element(17, b"xx"))),
    ("struct", (2, (BIG, 1), integers(32), element(1, b""))),
    ("struct-0", (2, (BIG, BIG, 0), integers(8), element(1, b"a".ljust(8, b"\0")))),
    ("cell", (1, (BIG, 1))),
    ("cell-0", (1, (BIG, 0))),
    ("object", (3, (BIG, 1), element(1, b"c"), integers(32), element(1, b""))),
    ("numbers-0", (6, (BIG, BIG, 0), element(9, b""))),
    ("sparse", (5, (BIG, BIG), integers(), integers(0), element(9, b""))),
    ("sparse-wide", (5, (1, BIG), integers(9), integers(0, 99), element(9, bytes(8)))),
)
CELLS = cases(
    ("tables", np.array([{"a": 1.0}, {"a": 2.0}], dtype=object), ["row 1", "holds a table"]),
    ("complex", np.array([complex(x, 1.0) for x in range(N)], dtype=object),
     ["row 1", "not a number"]),
)  # fmt: skip
COLUMNS = cases(
    ("time32", pa.array(range(N), pa.time32("ms")), ["'q'", "time32[ms], not numbers"]),
    ("duration", pa.array(range(N), pa.duration("ns")), ["'q'", "not numbers"]),
    ("list", pa.array([[1.0]] * N), ["'q'", "no vector", "'q[0]'"]),
    ("ragged", pa.array([[1.0], [1.0, 2.0]] * (N // 2)), ["'q'", "row 1", "list"]),
    ("texts", pa.array([["a"]] * N), ["'q'", "'q[0]'"]),
    ("table", pa.array([{"q": 1.0}] * N), ["'q'", "struct", "not numbers"]),
    ("map", pa.array([[(1, 1.0)]] * N, pa.map_(pa.int8(), pa.float64())), ["'q'", "map"]),
    ("null", pa.nulls(N), ["'q'", "row 1", "is empty"]),
    ("gap", pa.array([1.0, None] * (N // 2)), ["'q'", "row 2", "is empty"]),
    ("bytes", pa.array([b"\xff"] * N), ["'q'", "binary, not numbers"]),
)


@pytest.mark.parametrize(("text", "extra", "parts"), TEXTS)
def test_text(tmp_path, text, extra, parts):
    refused(tmp_path, text.encode(), "csv", extra=extra, parts=parts)


@pytest.mark.parametrize(("recording", "parts"), ARCHIVES)
def test_npz(tmp_path, recording, parts):
    refused(tmp_path, recording, "npz", parts=parts)


@pytest.mark.parametrize("odd", MATRICES)
def test_mat_that_claims_much(tmp_path, odd):
    refused(tmp_path, claimed(odd), "mat", parts=["run.mat"])


def test_mat_of_many_empty_cells(tmp_path):
    made = many_cells()
    assert len(made) < 100_000
    refused(tmp_path, made, "mat", parts=["run.mat"])


@pytest.mark.parametrize(
    ("form", "column", "parts"),
    [
        *((("parquet", *one.values)) for one in COLUMNS),
        *(("deflated.mat", *one.values) for one in CELLS),
    ],
)
def test_a_column_that_holds_something_else(tmp_path, form, column, parts):
    refused(tmp_path, with_q(form, column), form.rpartition(".")[2], parts=["run.", "'q'", *parts])


def test_json_half_of_a_character_pair(tmp_path):
    refused(tmp_path, half_of_a_pair(), "json", parts=["'tau'", "\\ud800tau"])


@pytest.mark.parametrize(
    ("column", "change", "parts"),
    cases(
        ("position", 1, lambda v: v * 1e308, ["'q'", "check its unit"]),
        ("opposite", 1, lambda v: np.sign(v) * 1.7e308, ["'q'", "check its unit"]),
        ("torque", 2, lambda v: np.sign(v) * 1.7e308, ["'tau'", "check its unit"]),
        ("tiny-torque", 2, lambda v: v * 1e-320, ["'tau'"]),
        ("tiny-position", 1, lambda v: v * 1e-320, ["'q'"]),
        ("time", 0, lambda v: v * 1e300, ["'t'", "unit"]),
        ("time-denormal", 0, lambda v: v * 1e-310, ["run.csv", "unit of time"]),
        # a time before which all others vanish
        ("time-apart", 0, lambda v: np.r_[-1e14, v[1:] * 1e-3], ["'t'", "repeats"]),
        # slopes of PCHIP overflow between stamps so close
        ("time-close", 0, lambda v: np.r_[0, 1e-305, v[2:]], ["run.csv", "1e-305 s apart"]),
    ),
)
def test_numbers_that_leave_floating_point(tmp_path, column, change, parts):
    data = good.columns()
    name = list(data)[column]
    with np.errstate(all="ignore"):
        data[name] = change(data[name])
    cells = zip(*(map(repr, values.tolist()) for values in data.values()), strict=True)
    text = "\n".join(map(",".join, [tuple(data), *cells]))
    refused(tmp_path, text.encode(), "csv", parts=parts)


@pytest.mark.parametrize("values", [["1e308", "0"], ["-1e308", "1e308"]])
def test_huge_numbers_of_a_tiny_unit(tmp_path, values):
    """Raw numbers at the end of floating point may be fine in SI units."""
    data = rows(250)
    text = "\n".join(
        [data[0], *(f"{r.rpartition(',')[0]},{values[i % 7 > 3]}" for i, r in enumerate(data[1:]))]
    )
    (tmp_path / "run.csv").write_text(text)
    (tmp_path / "c.toml").write_text(good.config("run.csv").replace('"N m"', '"1e-308 N m"'))
    assert broken_rule(tmp_path / "c.toml") is None


def test_parquet_name_that_also_selects_a_field(tmp_path):
    """A column named a.b is not the field b of column a."""
    data = good.columns()
    table = pa.table(
        {"q": pa.array([{"x": -1.0}] * N), "q.x": data["q"], "t": data["t"], "tau": data["tau"]}
    )
    pq.write_table(table, tmp_path / "run.parquet")
    (tmp_path / "c.toml").write_text(good.config("run.parquet").replace('"q"', '"q.x"'))
    assert check(tmp_path / "c.toml").code == 0


# -- JSON


@pytest.mark.parametrize("depth", [5, 900, 990, 2000])
def test_json_cell_of_any_depth(tmp_path, depth):
    """Showing it needs as deep a stack as reading it, or deeper."""
    data = {name: list(values) for name, values in good.columns().items()}
    data["q"][3] = "@"
    text = json.dumps(data).replace('"@"', "[" * depth + "]" * depth)
    refused(tmp_path, text.encode(), "json", parts=["run.json"])


# -- units


@pytest.mark.parametrize(
    "text",
    [
        "9**9 **9 s", "9^9 ^9 s", "9²²²²²²²²² s", "9**9² ² s", "(" * 39 + ")" * 39, "1" * 80,
        "((((((((9**9)**9)**9)**9)**9)**9)**9)**9)s", "s/((((((9**9)**9)**9)**9)**9)**9)**9",
        "s" + "**2" * 25,
    ],
)  # fmt: skip
def test_unit_that_would_be_computed_for_ever(text):
    with at_most(SECONDS), pytest.raises(ValueError, match="time"):
        quantity(text, "time")


# -- configuration


@pytest.mark.parametrize(
    ("edit", "parts"),
    cases(
        ("long-word", f"[processing]\n{'a' * 400_000} = 1", ["c.toml", "unknown key"]),
        ("decimate", "[processing]\ndecimate = 1000000000", ["'run', decimate"]),
        ("decimate-400", f"[processing]\ndecimate = 1{'0' * 400}", ["'run', decimate"]),
        ("trim", "[processing]\ntrim = 1e300", ["'run', trim"]),
        ("trim-inf", '[processing]\ntrim = "1e308 s"', ["'run', trim"]),
        ("band", '[processing]\nband = "1e-300 Hz"', ["band", "next to nothing"]),
        ("band-narrow", '[processing]\nband = "1e-3 Hz"', ["'run', decimate"]),
        ("lowpass", '[processing]\nlowpass = "1e-300 Hz"', ["lowpass", "next to nothing"]),
    ),
)
def test_processing(tmp_path, edit, parts):
    refused(tmp_path, good.content("csv"), "csv", edit=("[processing]", edit), parts=parts)


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    cases(
        ("pattern", '"run.csv"', '"**x/*.csv"', ["recordings.1", "**x", "is no pattern"]),
        ("only-stars", '"run.csv"', '"***"', ["recordings.1", "is no pattern"]),
        ("unit-tiny", '"rad"', '"1e-320 rad"', ["'q'"]),
        ("unit-huge", '"rad"', '"1e300 rad"', ["'q'", "check its unit"]),
        ("unit-time", 'unit = "s"', 'unit = "1e-300 s"', ["run.csv", "unit of time"]),
        ("rate", TIME, "rate = 1e300", ["run.csv", "unit of time"]),
        ("rate-slow", TIME, 'rate = "1e-300 Hz"', ["run.csv"]),
        ("column", 'column = "q"', 'column = "' + "q" * 300_000 + '"', ["does not exist"]),
        ("column-400", 'column = "q"', f"column = 1{'0' * 400}", ["does not exist"]),
        ("times", 'unit = "rad"', 'unit = "1e200 rad", times = "q", times_unit = "1e200"', ["'q'"]),
        ("escape", '"rad"', '"\\u001b[31m"', ["\\x1b[31m"]),
        # in single quotes it is six characters
        ("no-nul", 'column = "q"', r"column = '\u0000'", [r"'\u0000'", "does not exist"]),
    ),
)
def test_configuration(tmp_path, old, new, parts):
    refused(tmp_path, good.content("csv"), "csv", edit=(old, new), parts=parts)


def test_long_trim_around_an_excluded_span_is_quick(tmp_path):
    """The excluded samples were widened by a convolution, in samples times trim."""
    n = 400_000
    t = np.arange(n) * 1e-4
    data = {"t": t, "q": np.sin(4 * t), "tau": np.cos(3 * t)}
    np.savez(tmp_path / "run.npz", **data)
    text = good.config("run.npz", "\nexclude = [[1.0, 2.0]]")
    (tmp_path / "c.toml").write_text(text.replace("order = 4", "order = 4\ntrim = 15.0"))
    assert broken_rule(tmp_path / "c.toml") is None


def test_a_choice_between_a_word_and_true(tmp_path):
    (tmp_path / "run.csv").write_bytes(good.content("csv"))
    text = good.config("run.csv").replace("[[rec", 'elements.motor.viscous = "-"\n\n[[rec', 1)
    (tmp_path / "c.toml").write_text(text)
    told = []
    assert broken_rule(tmp_path / "c.toml", "viscous", told=told) is None
    has(told[0].err, "got '-'", "a valid boolean or 'by-direction'")
