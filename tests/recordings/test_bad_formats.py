"""Unfit files of the binary formats and JSON are refused in one line; damage: tests/hostile."""

import json

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from .samples import has, refused, source, swing


def arrays():
    return dict(zip(("t", "q", "tau"), swing(), strict=True))


def make(folder, form, content):
    path = folder / f"run.{form}"
    if form == "npz":
        np.savez(path, **content)
    elif form == "mat":
        savemat(path, content)
    elif form == "parquet":
        pq.write_table(pa.table(content), path)
    else:
        path.write_text(json.dumps({k: np.asarray(v).tolist() for k, v in content.items()}))
    return path


def with_q(values):
    return lambda t, q, tau: {"t": t, "q": values(q), "tau": tau}


def with_one(value):
    return with_q(lambda q: np.where(np.arange(q.size) == 16, value, q))


@pytest.mark.parametrize("form", ["npz", "mat", "parquet", "json"])
@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (with_one(np.nan), ["'q'", "row 17", "finite"]),
        (with_one(np.inf), ["'q'", "row 17", "finite"]),
        (lambda t, q, tau: {"t": t, "q": q, "tauu": tau}, ["'tau'", "did you mean 'tauu'"]),
        (lambda t, q, tau: {"t": t, "q": q, "tau": tau[:-1]}, ["'tau'", "199", "200"]),
        (with_q(lambda q: np.column_stack([q, q])), ["'q'"]),
        (with_q(lambda q: np.array(["a"] * q.size)), ["'q'"]),
    ],
    ids=["nan", "inf", "name", "length", "matrix", "text"],
)
def test_unfit(tmp_path, form, change, parts):
    content = change(*swing())
    if form == "parquet" and {np.shape(values) for values in content.values()} != {(200,)}:
        pytest.skip("Parquet has vectors of one length")
    path = make(tmp_path, form, content)
    has(refused(tmp_path, source(path.name)), path.name, *parts)


def test_parquet_null(tmp_path):
    frame = pd.DataFrame(arrays()).astype({"q": "Float64"})
    frame.loc[16, "q"] = pd.NA
    frame.to_parquet(tmp_path / "run.parquet")
    has(refused(tmp_path, source("run.parquet")), "run.parquet", "'q'", "row 17", "empty")


def test_struct_that_is_not_there(tmp_path):
    savemat(tmp_path / "run.mat", {"log": arrays(), "x": 1.0})
    has(refused(tmp_path, source("run.mat", table="logg")), "'logg'", "'log'")
    has(refused(tmp_path, source("run.mat", table="x")), "'x'", "no struct")


def test_json_key_that_is_not_there(tmp_path):
    (tmp_path / "run.json").write_text('{"log": {"rows": []}}')
    message = refused(tmp_path, source("run.json", table="log.entries"))
    has(message, "run.json", "'entries'", "'rows'")
    has(refused(tmp_path, source("run.json", table="log.rows")), "run.json", "no rows")


@pytest.mark.parametrize("text", ["3", '"x"', "null", "{}", '{"a": 1}', "[1, 2]", "[]", "[" * 9999])
def test_json_of_another_shape(tmp_path, text):
    (tmp_path / "run.json").write_text(text)
    has(refused(tmp_path, source("run.json")), "run.json")


def test_json_with_several_tables(tmp_path):
    (tmp_path / "run.json").write_text('{"a": [{"t": 1}], "b": [{"t": 1}]}')
    has(refused(tmp_path, source("run.json")), "'a'", "'b'", "table")


def test_json_row_without_a_key(tmp_path):
    rows = pd.DataFrame(arrays()).to_dict("records")
    del rows[16]["q"]
    (tmp_path / "run.json").write_text(json.dumps(rows))
    has(refused(tmp_path, source("run.json")), "run.json", "'q'", "row 17", "missing")


@pytest.mark.parametrize("value", [None, [1.0], {"x": 1}, "high"])
def test_json_cell_that_is_no_number(tmp_path, value):
    rows = pd.DataFrame(arrays()).to_dict("records")
    rows[16]["q"] = value
    (tmp_path / "run.json").write_text(json.dumps(rows))
    has(refused(tmp_path, source("run.json")), "run.json", "'q'", "row 17")
