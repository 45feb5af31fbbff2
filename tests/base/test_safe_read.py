"""Files named by mistake are refused in one line; limits are lowered, files harmless."""

import os
from pathlib import Path

import h5py
import numpy as np
import pytest

from bayesfric.base import safe_read
from bayesfric.base.errors import BadInput
from bayesfric.base.safe_read import open_hdf5, parse_json, read_array, read_json, read_text
from tests.recordings import file_formats
from tests.recordings.samples import has, read, refused, source


def write(folder, form, data=None):
    path = folder / f"run.{form}"
    path.write_bytes(file_formats.content(form, data))
    return path


@pytest.mark.parametrize("form", [x for x in file_formats.FORMATS if x not in ("csv", "jsonl")])
def test_a_file_that_is_cut_off_or_of_another_format(tmp_path, form):
    path = write(tmp_path, form)
    size = path.stat().st_size
    for share in (0.7, 0.3, 0.0):
        os.truncate(path, int(share * size))
        has(refused(tmp_path, source(path.name)), path.name)
    path.write_bytes(file_formats.content("csv"))
    if form not in ("npy", "7.3.mat"):
        has(refused(tmp_path, source(path.name)), path.name)


@pytest.mark.parametrize("form", ["csv", "mcap"])
@pytest.mark.parametrize(
    "create",
    [Path.mkdir, os.mkfifo, lambda path: path.symlink_to("gone"), lambda path: path.touch()],
    ids=["folder", "pipe", "dangling link", "empty"],
)
def test_a_path_without_content(tmp_path, form, create):
    create(tmp_path / f"run.{form}")
    has(refused(tmp_path, source(f"run.{form}")), f"run.{form}")


def test_an_array_that_is_too_large(tmp_path, monkeypatch):
    path = write(tmp_path, "h5")
    monkeypatch.setattr(safe_read, "LARGEST_ARRAY", 1000)
    with pytest.raises(BadInput, match=r"run\.h5: .*MiB"), open_hdf5(path) as file:
        read_array(file["q"])


def test_a_text_that_is_too_large(tmp_path):
    (tmp_path / "a.json").write_text("[1, 2]")
    assert read_json(tmp_path / "a.json") == [1, 2]
    with pytest.raises(BadInput, match=r"a\.json: .*MiB"):
        read_text(tmp_path / "a.json", largest=5)


def test_objects_are_not_unpickled(tmp_path):
    """A pickle can run any code; NumPy stores arrays of objects as one."""
    values = file_formats.columns()
    write(tmp_path, "npz", values | {"q": values["q"].astype(object)})
    has(refused(tmp_path, source("run.npz")), "run.npz", "'q'")


def test_patterns_leave_out_hidden_files_and_reach_other_folders(tmp_path):
    (tmp_path / "in").mkdir()
    for name in ("b.csv", "a.csv", "._a.csv", "in/a.csv"):  # macOS writes the hidden one
        (tmp_path / name).write_bytes(file_formats.content("csv"))

    def names(pattern, folder=tmp_path):
        return [recording.name for recording in read(folder, source(pattern))]

    assert names("*.csv") == names("../*.csv", tmp_path / "in") == ["a", "b"]
    assert names(str(tmp_path / "*.csv")) == ["a", "b"]
    assert names("**/a.csv") == ["a", "in-a"]
    has(refused(tmp_path, source("*.bag")), "'*.bag'", str(tmp_path))


def test_a_name_that_is_not_utf_8(tmp_path):
    name = os.fsdecode(b"run\xff.csv")
    (tmp_path / name).write_bytes(file_formats.content("csv"))
    has(refused(tmp_path, source("*.csv")), "run\\udcff.csv")


def test_hdf5_follows_no_link_to_another_file(tmp_path):
    write(tmp_path, "h5").rename(tmp_path / "other.h5")
    with h5py.File(write(tmp_path, "h5"), "r+") as file:
        del file["q"]
        file["q"] = h5py.ExternalLink("other.h5", "/q")
    has(refused(tmp_path, source("run.h5")), "'q'")


@pytest.mark.parametrize("name", ["x", "/"])
def test_hdf5_without_the_array(tmp_path, name):
    path = write(tmp_path, "h5")
    with open_hdf5(path) as file:
        np.testing.assert_array_equal(read_array(file["q"]), file_formats.columns()["q"])
    with pytest.raises(BadInput, match=r"run\.h5"), open_hdf5(path) as file:
        read_array(file[name])


@pytest.mark.parametrize("text", ["", "{", "[1,]", "{'a': 1}"])
def test_text_that_is_not_json(text):
    with pytest.raises(BadInput, match=r"^source: .*; correct it$"):
        parse_json("source", text, "correct it")
