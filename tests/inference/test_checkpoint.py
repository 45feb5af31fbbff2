"""Interrupted sampling goes on to the same bytes, and refuses what is no longer the same."""

import errno
import itertools
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.base.progress import Progress
from bayesfric.inference.sampling import checkpoint as module
from bayesfric.inference.sampling import sampling
from bayesfric.inference.sampling.checkpoint import Checkpoint, Manifest, StepFile, Steps
from tests.conftest import REPOSITORY
from tests.inference.two_valleys import FACTS, SETTINGS, TwoValleys, run


class Stop(Exception):
    pass


@pytest.fixture(scope="module")
def whole():
    """A run never interrupted, without a checkpoint."""
    posterior, _ = run(None)
    return posterior


@pytest.fixture(autouse=True)
def save_always(monkeypatch):
    """Leave nothing to how long a step takes here."""
    monkeypatch.setattr(module, "_SHARE", 1e9)


def same(found, expected):
    for name in ("draws", "log_density"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    for name in ("rhat", "tau", "ess", "acceptance"):
        np.testing.assert_array_equal(
            getattr(found.diagnostics, name), getattr(expected.diagnostics, name)
        )
    said = ("status", "problems", "warmup", "steps", "thin", "not_finite", "not_finite_share")
    for name in (*said, "warnings"):
        assert getattr(found.diagnostics, name) == getattr(expected.diagnostics, name), name


def stopping_after(blocks):
    """Raise from the progress callback after so many blocks."""
    left = itertools.count(1)

    def progress(_: Progress):
        if next(left) == blocks:
            raise Stop

    return progress


def n_blocks():
    seen = []
    run(None, progress=seen.append)
    return len(seen)


def test_the_density_has_what_may_go_wrong(whole, monkeypatch):
    """Walkers are brought back, and some proposals have no number: otherwise nothing is tested."""
    brought = []
    original = sampling._Ensembles.bring_back_lost

    def counted(self, rng):
        before = self.positions()
        original(self, rng)
        brought.append(not np.array_equal(before, self.positions()))

    monkeypatch.setattr(sampling._Ensembles, "bring_back_lost", counted)
    again, _ = run(None)
    assert any(brought)
    assert whole.diagnostics.not_finite > 0
    same(again, whole)


def test_a_checkpoint_changes_nothing(whole, tmp_path):
    found, _ = run(tmp_path)
    same(found, whole)


@pytest.mark.parametrize("block", range(1, n_blocks() + 1))
def test_interrupted_after_every_block(whole, tmp_path, block):
    with pytest.raises(Stop):
        run(tmp_path, progress=stopping_after(block))
    found, kept = run(tmp_path)
    same(found, whole)
    # once more from the end: all is there
    assert (
        run(tmp_path)[1].saved == kept.saved == found.diagnostics.warmup + found.diagnostics.steps
    )


def test_interrupted_after_each_block_one_after_the_other(whole, tmp_path):
    for block in range(1, n_blocks() + 1):
        with pytest.raises(Stop):
            run(tmp_path, progress=stopping_after(block))
    same(run(tmp_path)[0], whole)


@pytest.mark.parametrize("apart", [pytest.param(1, marks=pytest.mark.slow), 17, 41])
def test_asked_to_stop_in_the_middle_of_blocks(whole, tmp_path, apart):
    """However often the request comes."""
    stops = [0]
    while True:
        asks = itertools.count(1)
        try:
            found, _ = run(tmp_path, asked_to_stop=lambda asks=asks: next(asks) == apart)
        except KeyboardInterrupt:
            stops.append(manifest(tmp_path)["steps"])
            # it is asked after each step, and when a block ends
            assert 0.8 * apart <= stops[-1] - stops[-2] <= apart
        else:
            break
    same(found, whole)
    assert len(stops) > 110 // apart


def manifest(folder):
    return json.loads((folder / "steps.json").read_text(encoding="utf-8"))


@pytest.fixture
def stopped(tmp_path):
    with pytest.raises(Stop):
        run(tmp_path, progress=stopping_after(6))
    return tmp_path


def test_the_manifest_says_what_it_is(stopped):
    found = manifest(stopped)
    assert found["facts"] == FACTS
    assert found["phase"] == "sampling"
    assert found["coordinates"] == "as they are"
    assert (found["walkers"], found["dimension"]) == (24, 3)
    n = found["steps"]
    assert (stopped / "steps.steps").stat().st_size == n * 24 * 33
    last = StepFile(stopped / "steps.steps", 24, 3).read(n - 1, n)
    np.testing.assert_array_equal(last.log_density[0], found["log_density"])


def test_no_pickle_anywhere(stopped):
    for path in stopped.iterdir():
        raw = path.read_bytes()
        assert not raw.startswith(b"\x80"), path


def test_what_was_there_stays_and_what_nobody_counts_goes(tmp_path):
    rng = np.random.default_rng(0)
    file = StepFile(tmp_path / "a.steps", 4, 2)

    def some(n):
        return Steps(rng.normal(size=(n, 4, 2)), rng.normal(size=(n, 4)), rng.random((n, 4)) < 0.5)

    first, last = some(3), some(7)
    raw = file.append(first, 0)
    file.append(some(50), 3)
    raw += file.append(last, 3)
    assert file.path.read_bytes() == raw
    for found, expected in ((file.read(0, 3), first), (file.read(3, 10), last)):
        for name in ("coordinates", "log_density", "accepted"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    with pytest.raises(ValueError, match="fewer than"):
        file.read(0, 11)


def test_a_file_is_looked_at_in_pieces(tmp_path, monkeypatch, whole):
    monkeypatch.setattr(module, "_PIECE", 3000)
    with pytest.raises(Stop):
        run(tmp_path, progress=stopping_after(9))
    same(run(tmp_path)[0], whole)
    assert {path.name for path in tmp_path.iterdir()} == {"steps.json", "steps.steps"}


# -- what is refused


def refused(folder, *parts, **options):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(BadInput) as caught:
        run(folder, **options)
    for part in (*parts, "--force"):
        assert part in str(caught.value)
    assert before == {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize(
    ("facts", "part"),
    [
        ({"configuration": {"priors": {"x": [0.0, 2.0]}}}, "priors.x.2 was 1.0 and is 2.0 now"),
        ({"configuration": {"priors": {}}}, "priors.x was [0.0, 1.0] and is not there now"),
        ({"version": {"bayesfric": "9"}}, "version.bayesfric was 0 and is 9 now"),
    ],
)
def test_other_facts_are_named(stopped, facts, part):
    refused(stopped, part, facts={**FACTS, **facts})


def test_another_density_or_shape_is_refused(stopped):
    refused(stopped, "log-probability (walker", "the code", target=TwoValleys(scale=1.0 + 1e-6))
    more = SETTINGS.model_copy(update={"walkers": 14})
    refused(stopped, "walkers was 24 and is 28 now", settings=more)


def of_more_steps(more):
    """Write a manifest of so many steps more, with its own checksum."""

    def change(folder):
        content = {k: v for k, v in manifest(folder).items() if k not in ("format", "own_checksum")}
        steps = content["steps"] + more
        (folder / "steps.json").write_text(Manifest(**content | {"steps": steps}).text())

    return change


def edited(edit):
    return lambda folder: (folder / "steps.json").write_text(json.dumps(edit(manifest(folder))))


def cut(name, share):
    def change(folder):
        raw = (folder / name).read_bytes()
        (folder / name).write_bytes(raw[: int(share * len(raw))])

    return change


def flipped(folder):
    raw = bytearray((folder / "steps.steps").read_bytes())
    raw[1234] ^= 4
    (folder / "steps.steps").write_bytes(raw)


@pytest.mark.parametrize(
    ("damage", "part"),
    [
        *((cut(name, share), f"{name}: cannot be resumed (")
          for name in ("steps.json", "steps.steps") for share in (0.0, 0.01, 0.3, 0.9)),
        (edited(lambda m: m | {"format": 1}), "checkpoint format was 1 and is 3 now"),
        (edited(lambda m: m | {"format": None}), "checkpoint format was null"),
        (edited(lambda m: m | {"steps": 5}), "it is not what was written"),
        (edited(lambda m: {k: v for k, v in m.items() if k != "seconds"}), "not what was written"),
        (edited(lambda m: [m]), "steps.json: cannot be resumed"),
        (of_more_steps(5), "holds fewer than"),
        (of_more_steps(-1), "not those that"),
        (flipped, "its steps are not those"),
        (lambda folder: (folder / "steps.steps").unlink(), "cannot be resumed (No such file"),
    ],
)  # fmt: skip
def test_damaged_files_are_refused(stopped, damage, part):
    damage(stopped)
    refused(stopped, part)


# -- when the disk fails


def test_a_save_that_fails_leaves_the_last_checkpoint(stopped, whole, monkeypatch):
    before = manifest(stopped)

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    def nearly_full(self, steps, first):
        append(self, steps, first)
        full()

    append = StepFile.append
    for place, name, broken in ((StepFile, "append", nearly_full), (module, "_replace", full)):
        with monkeypatch.context() as patch:
            patch.setattr(place, name, broken)
            with pytest.raises(OSError, match="No space"):
                run(stopped)
        assert manifest(stopped) == before
    same(run(stopped)[0], whole)


# -- killed in a process of its own


def killed(folder, kills, moments):
    """Start sampling anew after every kill; how many steps were on disk at each."""
    saved = []
    for _ in range(kills):
        process = subprocess.Popen(
            [sys.executable, "-m", "tests.inference.two_valleys", str(folder)], cwd=REPOSITORY
        )
        begun = saved[-1] if saved else 0
        for _ in range(6000):
            found = manifest(folder)["steps"] if (folder / "steps.json").exists() else 0
            if found > begun or process.poll() is not None:
                break
            time.sleep(0.01)
        time.sleep(moments.uniform(0.0, 0.1))
        process.send_signal(signal.SIGKILL)
        process.wait()
        # whatever is there can be read
        Checkpoint(folder, "steps", FACTS)
        saved.append(manifest(folder)["steps"])
    return saved


@pytest.mark.parametrize("kills", [2, pytest.param(50, marks=pytest.mark.slow)], ids=["2", "50"])
def test_killed_at_random_moments(whole, tmp_path, kills):
    moments = random.Random(6)
    for _ in range(-(-kills // 3)):
        folder = tmp_path / "checkpoint"
        folder.mkdir()
        saved = killed(folder, min(3, kills), moments)
        assert saved[0] > 0
        same(run(folder)[0], whole)
        shutil.rmtree(folder)


def test_saving_is_rationed(monkeypatch, tmp_path):
    """Its share of the time stays below what it may have, on a disk however slow."""
    monkeypatch.setattr(module, "_SHARE", 0.02)
    saves = []
    original = Checkpoint.save

    def slow(self):
        began = time.perf_counter()
        original(self)
        time.sleep(0.02)
        self._spent += 0.02
        saves.append(time.perf_counter() - began)

    monkeypatch.setattr(Checkpoint, "save", slow)
    run(tmp_path)
    # 16 blocks of a few milliseconds each: the first is saved, none of the others
    assert len(saves) == 1


def test_a_killed_writer_leaves_no_partial_that_counts(stopped, whole):
    """Files that a killed process was just writing are in nobody's way."""
    (stopped / ".steps.json.partial").write_text("{")
    (stopped / f".steps.steps.{os.getpid()}.partial").write_bytes(b"1")
    same(run(stopped)[0], whole)
