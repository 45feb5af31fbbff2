"""A terminal that lacks letters, and a disk that takes no more."""

import os
import resource
import subprocess
import sys

import pytest

from tests.commands.bench import has, simulated
from tests.commands.test_fit import FEW


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("disk")
    text = FEW.replace("[self_check]\nrecordings = 10", "[self_check]\nrecordings = 0")
    simulated(made / "few.toml", text)
    done = ran(made, "fit", "few.toml", "-o", "run")
    assert done.returncode == 3, done.stderr
    return made


def ran(folder, *words, largest=None, **environment):
    def limited():
        if largest is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))

    return subprocess.run(
        [sys.executable, "-m", "bayesfric", *words],
        capture_output=True,
        cwd=folder,
        env={**os.environ, **environment},
        preexec_fn=limited,
        check=False,
    )


def test_a_terminal_that_shows_few_letters(folder):
    done = ran(folder, "compare", "run", PYTHONIOENCODING="ascii")
    assert done.returncode == 0, done.stderr
    done.stdout.decode("ascii")


@pytest.mark.parametrize(
    "words",
    [
        ("fit", "few.toml", "-o", "new"),
        ("simulate", "few.toml", "-o", "new.csv"),
        ("report", "run", "--paper"),
    ],
    ids=lambda words: words[0],
)
def test_a_disk_that_takes_no_more(folder, words):
    def held():
        paths = (p for p in folder.rglob("*") if p.is_file() and "__pycache__" not in p.parts)
        return {path: path.read_bytes() for path in paths}

    before = held()
    done = ran(folder, *words, largest=1000, NUMBA_DISABLE_CACHING="1")
    assert done.returncode == 2, done.stderr
    assert done.stderr.count(b"\n") == 1
    has(done.stderr.decode(), "bayesfric: ", "File too large")
    assert held() == before
