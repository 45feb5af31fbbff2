"""Damaged or unfit files of the binary formats and JSON are refused in one line."""

import json
import pickle

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from bayesfric.errors import BadInput

from .samples import has, read, refused, source, swing


def arrays():
    return dict(zip(("t", "q", "tau"), swing(), strict=True))


def make(folder, form, content=None):
    path = folder / f"run.{form}"
    content = arrays() if content is None else content
    if form == "npz":
        np.savez(path, **content)
    elif form == "mat":
        savemat(path, content)
    elif form == "parquet":
        pd.DataFrame(content).to_parquet(path)
    else:
        path.write_text(json.dumps({k: np.asarray(v).tolist() for k, v in content.items()}))
    return path


@pytest.mark.parametrize("form", ["npz", "mat", "parquet", "json"])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.7, 0.99])
def test_truncated(tmp_path, form, share):
    path = make(tmp_path, form)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    has(refused(tmp_path, source(path.name)), path.name)


@pytest.mark.parametrize("form", ["npz", "mat", "parquet", "json"])
def test_noise(tmp_path, form):
    path = tmp_path / f"run.{form}"
    path.write_bytes(np.random.default_rng(1).bytes(5000))
    has(refused(tmp_path, source(path.name)), path.name)


@pytest.mark.parametrize("form", ["npz", "mat", "parquet", "json"])
def test_corrupted_never_escapes_as_another_error(tmp_path, form):
    path = make(tmp_path, form)
    whole = bytearray(path.read_bytes())
    rng = np.random.default_rng(2)
    for _ in range(60):
        broken = bytearray(whole)
        for place in rng.integers(0, len(broken), 8):
            broken[place] = rng.integers(0, 256)
        path.write_bytes(bytes(broken))
        try:
            read(tmp_path, source(path.name))
        except BadInput as error:
            assert path.name in str(error)  # noqa: PT017


@pytest.mark.parametrize("form", ["npz", "mat", "parquet", "json"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_not_finite(tmp_path, form, value):
    content = arrays()
    content["q"][16] = value
    path = make(tmp_path, form, content)
    has(refused(tmp_path, source(path.name)), path.name, "'q'", "row 17", "finite")


@pytest.mark.parametrize("form", ["npz", "mat", "parquet", "json"])
def test_missing_column(tmp_path, form):
    content = arrays()
    content["tauu"] = content.pop("tau")
    path = make(tmp_path, form, content)
    has(refused(tmp_path, source(path.name)), path.name, "'tau'", "did you mean 'tauu'")


@pytest.mark.parametrize("form", ["npz", "mat", "json"])
def test_unequal_lengths(tmp_path, form):
    content = arrays()
    content["tau"] = content["tau"][:-1]
    path = make(tmp_path, form, content)
    has(refused(tmp_path, source(path.name)), path.name, "'tau'", "199", "200")


@pytest.mark.parametrize("form", ["npz", "mat", "json"])
def test_matrix_in_place_of_a_vector(tmp_path, form):
    content = arrays()
    content["q"] = np.column_stack([content["q"]] * 2)
    path = make(tmp_path, form, content)
    has(refused(tmp_path, source(path.name)), path.name, "'q'")


@pytest.mark.parametrize("form", ["npz", "mat", "parquet", "json"])
def test_text_in_place_of_numbers(tmp_path, form):
    content = arrays()
    content["q"] = np.array(["a"] * 200)
    path = make(tmp_path, form, content)
    has(refused(tmp_path, source(path.name)), path.name, "'q'")


def test_parquet_null(tmp_path):
    frame = pd.DataFrame(arrays()).astype({"q": "Float64"})
    frame.loc[16, "q"] = pd.NA
    frame.to_parquet(tmp_path / "run.parquet")
    has(refused(tmp_path, source("run.parquet")), "run.parquet", "'q'", "row 17", "empty")


def test_matlab_73(tmp_path):
    path = tmp_path / "run.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n")
    has(refused(tmp_path, source("run.mat")), "run.mat", "cut off")


def test_struct_that_is_not_there(tmp_path):
    savemat(tmp_path / "run.mat", {"log": arrays(), "x": 1.0})
    has(refused(tmp_path, source("run.mat", table="logg")), "'logg'", "'log'")
    has(refused(tmp_path, source("run.mat", table="x")), "'x'", "no struct")


def test_pickled_array(tmp_path):
    content = arrays()
    content["q"] = np.array([*content["q"]], dtype=object)
    np.savez(tmp_path / "run.npz", **content)
    has(refused(tmp_path, source("run.npz")), "run.npz", "'q'", "pickle")


def test_pickle_in_place_of_an_archive(tmp_path):
    (tmp_path / "run.npz").write_bytes(pickle.dumps(arrays()))
    has(refused(tmp_path, source("run.npz")), "run.npz")


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
