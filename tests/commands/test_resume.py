"""``bayesfric fit --resume``: runs interrupted as users and machines interrupt them."""

import errno
import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from bayesfric.base.errors import BadInput, Interrupted
from bayesfric.commands.fit import fit
from bayesfric.commands.unfinished import alone_in
from bayesfric.inference.sampling import checkpoint
from bayesfric.problem.config import read_config
from bayesfric.report import run_directory
from tests.conftest import REPOSITORY

from .bench import has, simulated, without_figures
from .test_fit import FEW, draws, without_seconds

pytestmark = pytest.mark.usefixtures("nothing_explained")

HIDDEN = ".run.checkpoint"


class Stop(Exception):
    pass


@pytest.fixture(autouse=True)
def ctrl_c_is_heard():
    """Started in the background (nohup, a shell's ``&``), this process would ignore SIGINT.

    So would its children; who starts the program like that does want it ignored.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="module", autouse=True)
def plain():
    """No figures; save after every block, however fast."""
    with pytest.MonkeyPatch.context() as patch:
        without_figures(patch)
        patch.setattr(checkpoint, "_SHARE", 1e9)
        yield


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    folder = tmp_path_factory.mktemp("measured")
    simulated(folder / "few.toml", FEW)
    return folder


@pytest.fixture(scope="module")
def whole(measured):
    """A run never interrupted: summary, draws, and what it showed of its progress."""
    seen = []
    summary = fit(read_config(measured / "few.toml"), measured / "whole", progress=seen.append)
    assert not list(measured.glob(".*"))
    return without_seconds(summary), draws(measured / "whole"), seen


@pytest.fixture
def here(bench, measured):
    for name in ("few.toml", "small.csv"):
        (bench.folder / name).write_bytes((measured / name).read_bytes())
    return bench


def same(folder, whole):
    """Every number of the run is that of the whole one, and nothing is left beside it."""
    summary, expected, _ = whole
    written = json.loads((folder / "run" / "summary.json").read_text(encoding="utf-8"))
    assert without_seconds(written) == summary
    found = draws(folder / "run")
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values, err_msg=name)
    assert not [path.name for path in folder.iterdir() if path.name.startswith(".")]


def stopped(folder, at, **options):
    """Interrupt by an exception from the ``at``-th call of the progress callback."""
    left = itertools.count(1)

    def progress(_):
        if next(left) == at:
            raise Stop

    with pytest.raises(Stop):
        fit(read_config(folder / "few.toml"), folder / "run", progress=progress, **options)


def resumed(folder):
    return fit(read_config(folder / "few.toml"), folder / "run", resume=True)


def blocks(whole):
    """Which calls of the progress callback come after a block."""
    return [k for k, seen in enumerate(whole[2], start=1) if seen.steps]


def test_interrupted_after_a_block_and_resumed(here, whole):
    """After every single block: ``tests/inference/test_checkpoint.py``."""
    assert len(blocks(whole)) > 5
    for k in blocks(whole)[::20]:
        stopped(here.folder, k)
        assert steps(here.folder) > 0
        resumed(here.folder)
        same(here.folder, whole)
        shutil.rmtree(here.folder / "run")


def refused(here, *arguments):
    """One line, exit code 2, and the checkpoint as it was."""
    return here.refused("fit", "few.toml", "-o", "run", *arguments)


def test_what_is_refused(here, whole):
    has(refused(here, "--resume"), "run: there is no checkpoint to resume; leave --resume out")
    stopped(here.folder, blocks(whole)[6])
    has(refused(here), "run: was interrupted", "add --resume to go on, or --force to start afresh")
    has(refused(here, "--resume", "--force"), "--resume: cannot go with --force")
    has(refused(here, "--resume", "--seed", "4"), "configuration.sampling.seed was 3 and is 4 now")
    config = here.folder / "few.toml"
    text = config.read_text(encoding="utf-8")
    config.write_text(text + '[priors]\n"motor.coulomb" = [0, 1]\n', encoding="utf-8")
    has(
        refused(here, "--resume"),
        f"{HIDDEN}: cannot be resumed: configuration.priors.motor.coulomb was not there and is",
    )
    # a remark changes nothing
    config.write_text(text + "# my knee\n", encoding="utf-8")
    recording = here.folder / "small.csv"
    raw = recording.read_bytes()
    recording.write_bytes(raw + b"\n")
    has(refused(here, "--resume"), "recording.small was ")
    recording.write_bytes(raw)
    path = here.folder / HIDDEN / "posterior.steps"
    path.write_bytes(path.read_bytes()[:-3000])
    resumed(here.folder)
    same(here.folder, whole)
    has(refused(here, "--resume"), "run: is finished; leave --resume out")


def test_force_starts_afresh(here, whole):
    stopped(here.folder, blocks(whole)[6])
    assert here.run("fit", "few.toml", "-o", "run", "--force").code == 3
    same(here.folder, whole)


# -- two at once


def test_the_second_of_two_is_told(here):
    with alone_in(here.folder / HIDDEN, here.folder / "run"):
        message = refused(here)
        has(message, "run: another process ", "is making this run", "wait for it")
        has(refused(here, "--resume"), "is making this run")
        with pytest.raises(BadInput), alone_in(here.folder / HIDDEN, here.folder / "run"):
            pass
    assert not (here.folder / HIDDEN).exists()


# -- signals


def begun(folder):
    """Start ``bayesfric fit`` in a process of its own."""
    words = ["tests.commands.slow_likelihood", "fit", "few.toml", "-o", "run"]
    return subprocess.Popen(
        [sys.executable, "-m", *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def steps(folder):
    """How many are in the file; a few of those of the last moment may be half written."""
    path = folder / HIDDEN / "posterior.steps"
    if not path.exists():
        return 0
    with path.open("rb") as file:
        line = file.readline()
        head, left = json.loads(line or "{}"), file.read()
    shape = head.get("walkers", 0), head.get("parameters", 0)
    return len(left) // checkpoint._row(*shape).itemsize


def wait_for(condition, process):
    for _ in range(12000):
        if condition() or process.poll() is not None:
            return
        time.sleep(0.005)


def test_ctrl_c_in_a_process_of_its_own(here, whole):
    """In between, a second process tries."""
    process = begun(here.folder)
    wait_for(lambda: steps(here.folder) > 0, process)
    time.sleep(0.015)
    has(here.run("fit", "few.toml", "-o", "run").err, "another process")
    asked = time.perf_counter()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    took = time.perf_counter() - asked
    assert (process.returncode, out) == (130, ""), err
    assert took < 5.0, took  # the step, the file, and the end of the interpreter
    assert err == (
        f"bayesfric: interrupted, {steps(here.folder)} steps are kept; go on with: "
        "bayesfric fit few.toml -o run --resume\n"
    )
    resumed(here.folder)
    same(here.folder, whole)


def test_an_interrupted_import_ends_like_anything_else(tmp_path):
    """A dataclass is made by an exec of text; after that ``-m`` would end by the signal itself."""
    (tmp_path / "within.py").write_text(
        "from bayesfric.commands import cli\n"
        "cli.app = lambda **_: exec('raise KeyboardInterrupt')\n"
        "cli.main()\n",
        encoding="utf-8",
    )
    ended = subprocess.run(
        [sys.executable, "-m", "within"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 130
    assert ended.stderr == "bayesfric: interrupted, nothing was written\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_handlers_are_put_back(here, number):
    def mine(*_):
        raise AssertionError

    previous = signal.signal(number, mine)
    try:
        with pytest.raises(Interrupted) as caught:
            fit(
                read_config(here.folder / "few.toml"),
                here.folder / "run",
                progress=lambda p: os.kill(os.getpid(), number) if p.steps else None,
            )
        assert signal.getsignal(number) is mine
    finally:
        signal.signal(number, previous)
    assert caught.value.signal == number
    assert caught.value.saved == steps(here.folder) == 12


def test_before_sampling_nothing_is_kept(here, monkeypatch):
    from bayesfric.fit import fit as method

    def interrupted(*_, **__):
        os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr(method, "starting_point", interrupted)
    ended = here.run("fit", "few.toml", "-o", "run")
    assert (ended.code, ended.out) == (143, "")
    assert ended.err == "bayesfric: interrupted, nothing was written\n"
    assert not (here.folder / HIDDEN).exists()


def test_the_second_ctrl_c_does_not_wait(here, whole, monkeypatch):
    """The first comes within a step, the second within the saving that it makes."""
    from bayesfric.inference.target import Target

    original, calls = Target.__call__, itertools.count()
    stopped(here.folder, blocks(whole)[4])
    before = steps(here.folder)

    def impatient(self, u):
        if next(calls) == 10:
            os.kill(os.getpid(), signal.SIGINT)
        return original(self, u)

    def begin(self, *arguments):
        original_begin(self, *arguments)
        self._due = np.inf  # saving waits for the signal
        monkeypatch.setattr(Target, "__call__", impatient)
        monkeypatch.setattr(checkpoint, "_checksum", lambda _: os.kill(os.getpid(), signal.SIGINT))

    original_begin = checkpoint.Checkpoint.begin
    monkeypatch.setattr(checkpoint.Checkpoint, "begin", begin)
    ended = here.run("fit", "few.toml", "-o", "run", "--resume")
    assert ended.code == 130, ended
    has(ended.err, "interrupted, 60 steps are kept")
    assert steps(here.folder) == before
    monkeypatch.undo()
    monkeypatch.chdir(here.folder)
    resumed(here.folder)
    same(here.folder, whole)


# -- disks


@pytest.fixture
def small_disk(tmp_path):
    """A disk of half a megabyte."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", str(place)]
    if (
        not shutil.which("mount")
        or subprocess.run(mount, capture_output=True, check=False).returncode
    ):
        pytest.skip("only root can mount a small disk")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


@pytest.mark.parametrize(
    "free", [30, *(pytest.param(n, marks=pytest.mark.slow) for n in range(4, 252, 8))]
)
def test_a_full_disk(here, small_disk, whole, free):
    """It fills up while sampling, or while results are written; both go on when there is room."""
    with (small_disk / "ballast").open("wb") as ballast:
        ballast.write(bytes(512 * 1024 - free * 1024))
    output = small_disk / "run"
    ended = here.run("fit", "few.toml", "-o", output)
    assert (ended.code, ended.out) == (2, ""), ended
    assert re.fullmatch(r"bayesfric: [^\n]+: [^\n]+; [^\n]+\n", ended.err), ended.err
    has(ended.err, "No space left on device", "mend that")
    names = {path.name for path in small_disk.iterdir()}
    assert names <= {"ballast", HIDDEN}
    (small_disk / "ballast").unlink()
    kept = steps(small_disk) > 0
    assert ("--resume" in ended.err) == kept
    subprocess.run(["mount", "-o", "remount,size=8m", str(small_disk)], check=True)
    assert here.run("fit", "few.toml", "-o", output, *(["--resume"] if kept else [])).code == 3
    same(small_disk, whole)


def test_the_folder_vanishes_midway(here):
    (here.folder / "out").mkdir()

    def progress(p):
        if p.steps == 24:
            shutil.rmtree(here.folder / "out", ignore_errors=True)

    with pytest.raises(BadInput) as caught:
        fit(read_config(here.folder / "few.toml"), here.folder / "out" / "run", progress=progress)
    has(str(caught.value), "cannot be written (No such file or directory); mend that")
    assert not (here.folder / "out").exists()


def test_errors_of_the_disk_are_told(here, whole, monkeypatch):
    stopped(here.folder, blocks(whole)[4])
    before = steps(here.folder)

    def broken(*_):
        raise OSError(errno.EIO, "Input/output error", "posterior.steps")

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint.Checkpoint, "save", broken)
        message = here.run("fit", "few.toml", "-o", "run", "--resume").err
    has(message, "posterior.steps: cannot be written (Input/output error)", "go on with --resume")
    assert steps(here.folder) == before
    with monkeypatch.context() as patch:
        patch.setattr(run_directory, "archived", broken)
        message = here.run("fit", "few.toml", "-o", "run", "--resume").err
    has(message, "run: cannot be written", "nothing is sampled again")
    assert here.run("fit", "few.toml", "-o", "run", "--resume").code == 3
    same(here.folder, whole)
