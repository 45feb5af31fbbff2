"""Files and folders are written whole or not at all."""

import pytest

from bayesfric.base.atomic_write import add_files, new_folder, write_files
from bayesfric.base.errors import BadInput


def held(folder):
    return {str(p.relative_to(folder)): p.is_file() and p.read_text() for p in folder.rglob("*")}


@pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt])
@pytest.mark.parametrize("place", [new_folder, add_files])
def test_a_block_that_fails_changes_nothing(tmp_path, place, error):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "a").write_text("old")
    before = held(tmp_path)

    def fails():
        with place(tmp_path / "run") as partial:
            (partial / "a").write_text("new")
            raise error

    with pytest.raises(error):
        fails()
    assert held(tmp_path) == before


def test_a_block_that_succeeds_replaces_the_folder_or_adds_to_it(tmp_path):
    run = tmp_path / "new" / "run"
    for place, name in ((new_folder, "a"), (new_folder, "b"), (add_files, "c")):
        with place(run) as partial:
            (partial / name).write_text(name)
    assert held(tmp_path) == {"new": False, "new/run": False, "new/run/b": "b", "new/run/c": "c"}
    assert run.stat().st_mode == (tmp_path / "new").stat().st_mode


def test_what_a_link_names_stays_when_it_is_replaced(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "disk" / "a").write_text("old")
    (tmp_path / "run").symlink_to("disk")
    with new_folder(tmp_path / "run") as partial:
        (partial / "a").write_text("new")
    assert not (tmp_path / "run").is_symlink()
    assert (held(tmp_path)["run/a"], held(tmp_path)["disk/a"]) == ("new", "old")


def test_of_several_files_all_or_none_is_written(tmp_path):
    first, second = tmp_path / "a", tmp_path / "b"
    second.write_text("old")
    with pytest.raises(BadInput, match="b: exists already"):
        write_files({first: "1", second: "2"})
    assert held(tmp_path) == {"b": "old"}
    with pytest.raises(BadInput, match="x: cannot be written"):
        write_files({first: "1", second / "x": "2"})
    assert held(tmp_path) == {"b": "old"}
    write_files({first: "1", second: "2"}, replace=True)
    assert held(tmp_path) == {"a": "1", "b": "2"}
