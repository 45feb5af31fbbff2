"""What a user may name by mistake is refused in one line; limits are lowered, files harmless."""

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

BINARY = [form for form in file_formats.FORMATS if form not in ("csv", "jsonl")]


def written(folder, form, data=None):
    path = folder / f"run.{form}"
    path.write_bytes(file_formats.content(form, data))
    return path


@pytest.mark.parametrize("form", BINARY)
@pytest.mark.parametrize("share", [0.0, 0.3, 0.7])
def test_a_file_that_is_cut_off(tmp_path, form, share):
    path = written(tmp_path, form)
    os.truncate(path, int(share * path.stat().st_size))
    has(refused(tmp_path, source(path.name)), path.name)


@pytest.mark.parametrize("form", ["json", "npz", "mat", "parquet", "h5", "mcap", "bag", "db3"])
def test_a_file_of_another_format_than_its_suffix(tmp_path, form):
    (tmp_path / f"run.{form}").write_bytes(file_formats.content("csv"))
    has(refused(tmp_path, source(f"run.{form}")), f"run.{form}")


@pytest.mark.parametrize("form", ["csv", "npz", "mcap"])
@pytest.mark.parametrize(
    "make",
    [Path.mkdir, os.mkfifo, lambda path: path.symlink_to("gone"), lambda path: path.touch()],
    ids=["folder", "pipe", "dangling link", "empty"],
)
def test_no_file_with_content(tmp_path, form, make):
    make(tmp_path / f"run.{form}")
    has(refused(tmp_path, source(f"run.{form}")), f"run.{form}")


def test_an_array_that_is_too_large(tmp_path, monkeypatch):
    path = written(tmp_path, "h5")
    monkeypatch.setattr(safe_read, "LARGEST_ARRAY", 1000)
    with pytest.raises(BadInput, match=r"run\.h5: .*MiB"), open_hdf5(path) as file:
        read_array(file["q"])


def test_a_text_that_is_too_large(tmp_path, monkeypatch):
    (tmp_path / "a.json").write_text("[1, 2]")
    assert read_json(tmp_path / "a.json") == [1, 2]
    with pytest.raises(BadInput, match=r"a\.json: .*MiB"):
        read_text(tmp_path / "a.json", largest=5)
    monkeypatch.setattr(safe_read, "LARGEST_TEXT", 5)
    with pytest.raises(BadInput, match=r"a\.json: .*MiB"):
        read_json(tmp_path / "a.json")


def test_objects_are_not_unpickled(tmp_path):
    """A pickle can run any code; NumPy stores arrays of objects as one."""
    values = file_formats.columns()
    written(tmp_path, "npz", values | {"q": values["q"].astype(object)})
    has(refused(tmp_path, source("run.npz")), "run.npz", "'q'")


def test_memory_that_does_not_suffice(tmp_path, monkeypatch):
    def full(*_, **__):
        raise MemoryError

    written(tmp_path, "npz")
    monkeypatch.setattr(np, "squeeze", full)
    has(refused(tmp_path, source("run.npz")), "run.npz", "'q'")


def test_patterns_leave_out_hidden_files_and_reach_other_folders(tmp_path):
    (tmp_path / "in").mkdir()
    for name in ("b.csv", "a.csv", "._a.csv", "in/a.csv"):  # macOS writes the hidden one
        (tmp_path / name).write_bytes(file_formats.content("csv"))

    def names(pattern, folder=tmp_path):
        return [one.name for one in read(folder, source(pattern))]

    assert names("*.csv") == names("../*.csv", tmp_path / "in") == ["a", "b"]
    assert names(str(tmp_path / "*.csv")) == ["a", "b"]
    assert names("**/a.csv") == ["a", "in-a"]
    has(refused(tmp_path, source("*.bag")), "'*.bag'", str(tmp_path))


def test_a_name_that_is_not_utf_8(tmp_path):
    name = os.fsdecode(b"run\xff.csv")
    (tmp_path / name).write_bytes(file_formats.content("csv"))
    has(refused(tmp_path, source("*.csv")), "run\\udcff.csv")


def test_hdf5_follows_no_link_to_another_file(tmp_path):
    written(tmp_path, "h5").rename(tmp_path / "other.h5")
    with h5py.File(written(tmp_path, "h5"), "r+") as file:
        del file["q"]
        file["q"] = h5py.ExternalLink("other.h5", "/q")
    has(refused(tmp_path, source("run.h5")), "'q'")


def test_hdf5_that_is_none_or_lacks_the_array(tmp_path):
    path = written(tmp_path, "h5")
    with open_hdf5(path) as file:
        np.testing.assert_array_equal(read_array(file["q"]), file_formats.columns()["q"])
    with pytest.raises(BadInput, match=r"run\.h5"), open_hdf5(path) as file:
        read_array(file["x"])
    with pytest.raises(BadInput, match=r"run\.h5"), open_hdf5(path) as file:
        read_array(file["/"])


def test_json_that_is_none():
    for text in ("", "{", "[1,]", "{'a': 1}"):
        with pytest.raises(BadInput, match=r"^here: .*; mend it$"):
            parse_json("here", text, "mend it")
