"""Names and letters that a terminal or a disk does not take, and disks that take no more."""

import os
import resource
import subprocess
import sys

import pytest

from tests.commands.bench import simulated
from tests.commands.test_fit import FEW


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("names")
    text = FEW.replace("[self_check]\nrecordings = 10", "[self_check]\nrecordings = 0")
    simulated(made / "few.toml", text)
    done = ran(made, "fit", "few.toml", "-o", "run")
    assert done.returncode == 3, done.stderr
    return made


def ran(folder, *words, stdout=subprocess.PIPE, largest=None, **environment):
    def limited():
        if largest is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))

    return subprocess.run(
        [sys.executable, "-m", "bayesfric", *words],
        stdout=stdout,
        stderr=subprocess.PIPE,
        cwd=folder,
        env={**os.environ, **environment},
        preexec_fn=limited,
        check=False,
    )


def refused(done, *parts):
    err = done.stderr.decode()
    assert done.returncode == 2, err
    assert err.startswith("bayesfric: "), err
    assert err.count("\n") == 1, err
    assert all(part in err for part in parts), err


@pytest.mark.parametrize("words", [("check", "few.toml", "--json"), ("compare", "run")])
def test_a_terminal_that_takes_few_letters(folder, words):
    done = ran(folder, *words, PYTHONIOENCODING="ascii")
    assert done.returncode == 0, done.stderr
    done.stdout.decode("ascii")
    if "--json" in words:
        assert b"\\x" not in done.stdout


def test_a_terminal_on_a_full_disk(folder):
    with open("/dev/full", "wb") as full:  # noqa: PTH123
        refused(ran(folder, "init", "motor-axis", stdout=full), "output: cannot", "No space left")


@pytest.mark.parametrize(
    "words",
    [
        ("fit", "few.toml", "-o", "new"),
        ("simulate", "few.toml", "-o", "new.csv"),
        ("init", "motor-axis", "-o", "new.toml"),
        ("report", "run", "--paper"),
        ("export", "run", "--to", "csv", "-o", "new"),
        ("compare", "run", "-o", "new"),
    ],
    ids=lambda words: words[0],
)
def test_a_disk_that_takes_no_more(folder, words):
    before = {path for path in folder.rglob("*") if "__pycache__" not in path.parts}
    done = ran(folder, *words, largest=1000, NUMBA_DISABLE_CACHING="1")
    refused(done, "File too large")
    assert {path for path in folder.rglob("*") if "__pycache__" not in path.parts} == before


def test_a_name_that_is_not_utf_8_is_told_before_anything_is_done(folder):
    before = sorted(folder.rglob("*"))
    done = ran(folder, "fit", "few.toml", "-o", os.fsdecode(b"new\xff"))
    refused(done, "new\\udcff", "not UTF-8")
    assert sorted(folder.rglob("*")) == before


def test_a_run_whose_name_is_not_utf_8(folder):
    name = os.fsdecode(b"run\xff")
    (folder / "run").rename(folder / name)
    try:
        for words in (("report", name), ("export", name, "--to", "urdf")):
            refused(ran(folder, *words), "run\\udcff", "not UTF-8")
    finally:
        (folder / name).rename(folder / "run")
