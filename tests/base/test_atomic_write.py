"""Files and folders are written completely or not at all."""

import pytest

from bayesfric.base.atomic_write import add_files, new_folder, write_files
from bayesfric.base.errors import BadInput


def content(folder):
    return {str(p.relative_to(folder)): p.is_file() and p.read_text() for p in folder.rglob("*")}


@pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt])
@pytest.mark.parametrize("writer", [new_folder, add_files])
def test_a_block_that_fails_changes_nothing(tmp_path, writer, error):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "a").write_text("old")
    before = content(tmp_path)

    def fail():
        with writer(tmp_path / "run") as partial:
            (partial / "a").write_text("new")
            raise error

    with pytest.raises(error):
        fail()
    assert content(tmp_path) == before


def test_a_block_that_succeeds_replaces_the_folder_or_adds_to_it(tmp_path):
    run = tmp_path / "new" / "run"
    for writer, name in ((new_folder, "a"), (new_folder, "b"), (add_files, "c")):
        with writer(run) as partial:
            (partial / name).write_text(name)
    assert content(tmp_path) == {"new": False, "new/run": False, "new/run/b": "b", "new/run/c": "c"}
    assert run.stat().st_mode == (tmp_path / "new").stat().st_mode


def test_the_target_of_a_replaced_link_is_unchanged(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "disk" / "a").write_text("old")
    (tmp_path / "run").symlink_to("disk")
    with new_folder(tmp_path / "run") as partial:
        (partial / "a").write_text("new")
    assert not (tmp_path / "run").is_symlink()
    assert content(tmp_path) == {"disk": False, "disk/a": "old", "run": False, "run/a": "new"}


def test_of_several_files_all_or_none_are_written(tmp_path):
    first, second = tmp_path / "a", tmp_path / "b"
    second.write_text("old")
    for other, match in ((second, "b: exists already"), (second / "x", "x: cannot be written")):
        with pytest.raises(BadInput, match=match):
            write_files({first: "1", other: "2"})
        assert content(tmp_path) == {"b": "old"}
    write_files({first: "1", second: "2"}, replace=True)
    assert content(tmp_path) == {"a": "1", "b": "2"}
