"""Unfit files of the binary formats and JSON are refused in one line."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from tests.recordings import file_formats

from .samples import has, refused, source, swing


def with_q(values):
    return lambda t, q, tau: {"t": t, "q": values(q), "tau": tau}


def with_one(value):
    return with_q(lambda q: np.where(np.arange(q.size) == 16, value, q))


@pytest.mark.parametrize("form", ["npz", "deflated.mat", "parquet", "json"])
@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (with_one(np.nan), ["'q'", "row 17"]),
        (with_one(np.inf), ["'q'", "row 17"]),
        (lambda t, q, tau: {"t": t, "q": q, "tauu": tau}, ["'tau'", "'tauu'"]),
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
    (tmp_path / f"run.{form}").write_bytes(file_formats.content(form, data=content))
    has(refused(tmp_path, source(f"run.{form}")), f"run.{form}", *parts)


def with_row(change):
    rows = pd.DataFrame(file_formats.columns()).to_dict("records")
    change(rows[16])
    return json.dumps(rows)


@pytest.mark.parametrize(
    ("text", "table", "parts"),
    [
        *((text, None, []) for text in (
            "3", '"x"', "null", "{}", '{"a": 1}', "[1, 2]", "[]")),
        ('{"log": {"rows": []}}', "log.entries", ["'entries'", "'rows'"]),
        ('{"log": {"rows": []}}', "log.rows", []),
        ('{"a": [{"t": 1}], "b": [{"t": 1}]}', None, ["'a'", "'b'"]),
        (with_row(lambda row: row.pop("q")), None, ["'q'", "row 17"]),
        *((with_row(lambda row, x=x: row.update(q=x)), None, ["'q'", "row 17"]) for x in (
            None, [1.0], {"x": 1}, "high")),
    ],
)  # fmt: skip
def test_unfit_json(tmp_path, text, table, parts):
    (tmp_path / "run.json").write_text(text)
    used = source("run.json", **({"table": table} if table else {}))
    has(refused(tmp_path, used), "run.json", *parts)


def test_struct_that_is_not_there(tmp_path):
    savemat(tmp_path / "run.mat", {"log": file_formats.columns(), "x": 1.0})
    has(refused(tmp_path, source("run.mat", table="logg")), "'logg'", "'log'")
    has(refused(tmp_path, source("run.mat", table="x")), "'x'")
