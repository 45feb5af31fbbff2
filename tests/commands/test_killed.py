"""A fit that a user or the machine ends leaves nothing half-written, and no lock."""

import os
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest

from bayesfric.commands.fit import run_lock
from bayesfric.inference.sampling import sampling
from bayesfric.inference.target import Target
from bayesfric.report import run_directory
from tests.conftest import REPOSITORY

from .bench import has, simulated
from .test_fit import FEW, draws

pytestmark = pytest.mark.usefixtures("nothing_explained", "no_figures")

COMMAND = ("fit", "few.toml", "-o", "run")
SIGNALS = (signal.SIGINT, signal.SIGTERM)
# the command line in a process that ends itself as it starts to write
KILLED = """\
import os, signal
from bayesfric.commands import cli
from bayesfric.diagnostics import explanation
from bayesfric.report import run_directory
explanation.LEAST_OUTPUTS = 10**9
run_directory.posterior_tree = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
cli.main()
"""


@pytest.fixture(autouse=True)
def signals_are_heard():
    """A process started in the background (nohup, a shell's ``&``) would ignore SIGINT."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def here(bench):
    simulated(bench.folder / "few.toml", FEW)
    return bench


def ended_apart(folder, *words):
    return subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        check=False,
    )


def in_the_likelihood(monkeypatch, stop):
    def warm_up(warm, *_):
        monkeypatch.setattr(Target, "__call__", stop)
        warm.run(10)

    monkeypatch.setattr(sampling, "_warm_up", warm_up)


def in_the_writing(monkeypatch, stop):
    monkeypatch.setattr(run_directory, "posterior_tree", stop)


@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize("moment", [in_the_likelihood, in_the_writing])
def test_a_stopped_fit_leaves_nothing(here, monkeypatch, moment, number):
    before = here.held()
    moment(monkeypatch, lambda *_: os.kill(os.getpid(), number))
    ended = here.run(*COMMAND, "--json")
    assert (ended.code, ended.out) == (130, "")
    assert ended.err == "bayesfric: interrupted, nothing was written\n"
    assert here.held() == before


def test_after_a_kill_the_same_fit_comes_to_the_same_bytes(here):
    before = set(here.held())
    assert here.run("fit", "few.toml", "-o", "whole").code == 3
    killed = ended_apart(here.folder, "-c", KILLED, *COMMAND)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert not (here.folder / "run").exists()
    assert here.run(*COMMAND).code == 3
    assert {path.parts[0] for path in set(here.held()) - before} == {"whole", "run"}
    expected = draws(here.folder / "whole")
    for name, values in draws(here.folder / "run").items():
        np.testing.assert_array_equal(values, expected[name], err_msg=name)


def test_the_second_of_two_is_told(here):
    before = here.held()
    with run_lock(here.folder / "run"):
        has(here.refused(*COMMAND), "run: another process is making this run", "wait for it")
    assert here.held() == before


def test_an_interrupted_import_ends_like_anything_else(tmp_path):
    """A dataclass is made by an exec of text; after that ``-m`` would end by the signal itself."""
    (tmp_path / "within.py").write_text(
        "from bayesfric.commands import cli\n"
        "cli.app = lambda **_: exec('raise KeyboardInterrupt')\n"
        "cli.main()\n",
        encoding="utf-8",
    )
    ended = ended_apart(tmp_path, "-m", "within")
    assert ended.returncode == 130
    assert ended.stderr == "bayesfric: interrupted, nothing was written\n"


@pytest.fixture
def full_disk(tmp_path):
    """A disk of half a megabyte, of which 30 kB are free."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", str(place)]
    if not shutil.which("mount") or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("only root can mount a small disk")
    (place / "ballast").write_bytes(bytes((512 - 30) * 1024))
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


def test_a_full_disk(here, full_disk):
    ended = here.run("fit", "few.toml", "-o", full_disk / "run", "--json")
    assert (ended.code, ended.out) == (2, "")
    has(ended.err, "run: cannot be written (No space left on device)", "name another folder")
    assert [path.name for path in full_disk.iterdir()] == ["ballast"]
