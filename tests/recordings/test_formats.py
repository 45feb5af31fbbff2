"""The same numbers come out of every format and dialect."""

import hashlib
import io
import json
import tracemalloc

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from bayesfric.base.errors import BadInput
from bayesfric.recordings.readers import TableOptions, read_table, sha256
from bayesfric.recordings.source import Position
from tests.recordings import file_formats

from .samples import has, lines, numbered, read, refused, source, swing, write

HEADER = "t,q,tau"


def same(recording):
    t, q, tau = swing()
    np.testing.assert_allclose(recording.time, t, rtol=1e-14)
    np.testing.assert_allclose(recording.position, q, rtol=1e-14)
    np.testing.assert_allclose(recording.torque, tau, rtol=1e-14)


DIALECTS = {
    "plain": lines(),
    "tab": [line.replace(",", "\t") for line in lines()],
    "semicolon": [line.replace(",", ";") for line in lines()],
    "bar": [line.replace(",", "|") for line in lines()],
    "spaces": ["  " + line.replace(",", "   ") for line in lines()],
    "comma and space": [line.replace(",", ", ") for line in lines()],
    "quoted": ['"' + line.replace(",", '","') + '"' for line in lines()],
    "preamble": ["Recorder 3.2", "Date:;2020-07-06", "", *lines()],
    "units row": [HEADER, "s,rad,N m", *lines()[1:]],
    "hash": ["# " + HEADER, *lines()[1:]],
    "numpy": ["# made by hand", "# " + HEADER.replace(",", " "), *lines()[1:]],
    "blank lines": [*lines()[:30], "", *lines()[30:], "", ""],
    "a serial log that begins within a row": [HEADER, "0.5,7.25", *lines()[1:]],
}


@pytest.mark.parametrize("name", DIALECTS)
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_dialects(tmp_path, name, end):
    write(tmp_path, end.join(DIALECTS[name]) + end)
    same(read(tmp_path, numbered() if name == "numpy" else source())[0])


def test_a_text_is_read_without_being_held(tmp_path):
    count = 50_000
    np.savetxt(tmp_path / "run.csv", np.random.default_rng(0).normal(size=(count, 3)), "%.15f", ",")
    tracemalloc.start()
    table = read_table(tmp_path / "run.csv", TableOptions())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert np.all([np.isfinite(table.values(key)).sum() == count for key in (1, 2, 3)])
    # three numbers and a line's, twice where arrays grow; a line of text alone takes 100 bytes
    assert peak < 2 * count * (3 * 8 + 4)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_encodings(tmp_path, encoding):
    text = "\n".join(lines(header="t,winkel°,tau"))
    write(tmp_path, text, encoding=encoding)
    same(read(tmp_path, source(position=Position(column="winkel°", unit="rad")))[0])


@pytest.mark.parametrize(("mark", "delimiter"), [(";", None), (";", ";"), ("\t", None)])
def test_decimal_comma(tmp_path, mark, delimiter):
    text = [line.replace(",", mark).replace(".", ",") for line in lines()]
    write(tmp_path, "\n".join(text))
    for decimal in (",", None):
        same(read(tmp_path, source(decimal=decimal, delimiter=delimiter))[0])
    assert read_table(tmp_path / "run.csv", TableOptions()).decimal == ","


@pytest.mark.parametrize("suffix", [".csv", ".tsv", ".txt", ".dat", ".CSV", ".log"])
def test_headerless(tmp_path, suffix):
    write(tmp_path, "\n".join(["1,2,3", *lines(header=None)]), "run" + suffix)
    same(read(tmp_path, numbered("run" + suffix, skip_rows=1))[0])


def content():
    return dict(zip(HEADER.split(","), swing(), strict=True))


def nested(where, rows=False):
    table = {key: value.tolist() for key, value in content().items()}
    inner = pd.DataFrame(table).to_dict("records") if rows else table
    for key in reversed(where):
        inner = {"mass": 0.5, key: inner}
    return json.dumps(inner).encode()


def shaped(*shape):
    return {key: value.reshape(shape) for key, value in content().items()}


def structs():
    out = io.BytesIO()
    savemat(out, {"log": {"joint": content(), "who": "me"}})
    return out.getvalue()


@pytest.mark.parametrize(
    ("form", "table", "data"),
    [
        ("parquet", None, file_formats.content("parquet", data=content() | {"note": ["x"] * 200})),
        *(("mat", None, file_formats.content("deflated.mat", data=shaped(*s)))
          for s in ((-1,), (-1, 1), (1, -1))),
        ("mat", "log.joint", structs()),
        ("npy", None, file_formats.content("npy", data=content())),
        ("npz", None, file_formats.content("npz", data=content())),
        ("npz", None, file_formats.content("deflated.npz", data=content())),
        ("json", None, nested([])),
        ("json", "log.joint", nested(["log", "joint"])),
        ("json", None, nested([], rows=True)),
        ("json", None, nested(["entries"], rows=True)),
        ("json", "entries", nested(["entries"], rows=True)),
        ("json", "test.1", json.dumps(
            {"test": [{}, {k: [*v] for k, v in content().items()}]}).encode()),
    ],
)  # fmt: skip
def test_binary_formats_and_json(tmp_path, form, table, data):
    (tmp_path / f"run.{form}").write_bytes(data)
    more = {"table": table} if table else {}
    same(read(tmp_path, source(f"run.{form}", **more))[0])
    if form == "parquet":
        same(read(tmp_path, numbered("run.parquet"))[0])
    if form == "npy":
        np.save(tmp_path / "run.npy", np.stack(list(content().values()), axis=1))
        same(read(tmp_path, numbered("run.npy"))[0])


def test_json_of_several_tables(tmp_path):
    """Rows of numbers that begin with stamps are tables; so are episodes, objects of long lists."""
    rows = np.stack(swing(), axis=1)
    tests = {"sysid": True, "slow": rows.tolist(), "fast": rows.tolist()}
    (tmp_path / "rows.json").write_text(json.dumps(tests))
    same(read(tmp_path, numbered("rows.json", table="slow"))[0])
    episode = {key: value.tolist() for key, value in content().items()}
    (tmp_path / "run.json").write_text(json.dumps({"hz": 100, "data": [episode, episode]}))
    (tmp_path / "one.json").write_text(json.dumps({"hz": 100, "data": [episode]}))
    same(read(tmp_path, source("one.json"))[0])
    for file, tables in {
        "rows.json": ("'slow'", "'fast'"),
        "run.json": ("data.0", "data.1"),
    }.items():
        has(refused(tmp_path, source(file)), file, *tables)
    ragged = {"test": [[0.0, 1.0, 2.0], [0.1, 1.0]] * 100}
    (tmp_path / "ragged.json").write_text(json.dumps(ragged))
    has(refused(tmp_path, source("ragged.json", table="test")), "ragged.json", "row 2")


def test_sha256(tmp_path, monkeypatch):
    path = write(tmp_path, "\n".join(lines()))
    assert sha256(path) == hashlib.sha256(path.read_bytes()).hexdigest()
    assert read(tmp_path)[0].sha256 == sha256(path)

    def denied(*_args, **_kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(type(path), "open", denied)
    with pytest.raises(BadInput, match="permission"):
        sha256(path)


def test_patterns_and_names(tmp_path):
    for name in ("a/run.csv", "b/run.csv", "b/other.csv"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        write(tmp_path, "\n".join(lines()), name)
    recordings = read(tmp_path, source(["**/run.csv", "b/*.csv"]))
    assert [r.name for r in recordings] == ["a-run", "b-run", "other"]
    assert read(tmp_path, source("b/other.csv", name="mine"))[0].name == "mine"
    for name in ("b/other.txt", "b/run[1].csv"):
        write(tmp_path, "\n".join(lines()), name)
    assert [r.name for r in read(tmp_path, source("b/other.*"))] == ["other.csv", "other.txt"]
    same(read(tmp_path, source("b/run[1].csv"))[0])  # no pattern, as there is such a file


# -- real files


def test_recorder_preamble_of_a_real_file(real_data):
    path = real_data / "screw-worm" / "driveNo3" / "steady_state" / "0.096kg" / "10.csv"
    table = read_table(path, source())
    assert table.names[1:] == ["Velocity actual value averaged", "Torque actual value averaged"]
    assert table.column(1)[:2].tolist() == [0.0, 51.2]
    assert table.column(2)[:2].tolist() == [-15.0, -10.0]
    assert table.column("Torque actual value averaged")[:2].tolist() == [-10.6, -10.9]
    assert len(table.column(3)) == 500
    assert table.row(0) == "row 1 (line 15)"
