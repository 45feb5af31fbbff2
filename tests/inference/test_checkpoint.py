"""Interrupted sampling goes on to the same bytes, and refuses what is no longer the same."""

import errno
import itertools
import json
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
from bayesfric.inference.sampling.checkpoint import Checkpoint
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


def test_interrupted_where_the_proposal_has_learned_again(tmp_path, monkeypatch):
    """After every block of a run whose steps are warm-up twice."""
    monkeypatch.setattr(sampling, "_RELEARNED", 1)
    fitted, original = [], sampling._fitted
    monkeypatch.setattr(
        sampling, "_fitted", lambda *a, last: (fitted.append(last), original(*a, last=last))[1]
    )
    seen = []
    whole, _ = run(None, progress=seen.append)
    assert sum(fitted) > 1
    assert whole.diagnostics.warmup + whole.diagnostics.steps == SETTINGS.max_steps
    for block in range(1, len(seen) + 1):
        folder = tmp_path / f"{block}"
        folder.mkdir()
        with pytest.raises(Stop):
            run(folder, progress=stopping_after(block))
        same(run(folder)[0], whole)


@pytest.mark.parametrize("apart", [pytest.param(1, marks=pytest.mark.slow), 17, 41])
def test_asked_to_stop_in_the_middle_of_blocks(whole, tmp_path, apart):
    """However often the request comes."""
    stops = [0]
    while True:
        asks = itertools.count(1)
        try:
            found, _ = run(tmp_path, asked_to_stop=lambda asks=asks: next(asks) == apart)
        except KeyboardInterrupt:
            stops.append(saved(tmp_path))
            # it is asked after each step, and when a block ends
            assert 0.8 * apart <= stops[-1] - stops[-2] <= apart
        else:
            break
    same(found, whole)
    assert len(stops) > 110 // apart


def saved(folder):
    return Checkpoint(folder, "steps", FACTS).saved


@pytest.fixture
def stopped(tmp_path):
    with pytest.raises(Stop):
        run(tmp_path, progress=stopping_after(6))
    return tmp_path


def head(folder):
    return json.loads((folder / "steps.steps").read_bytes().partition(b"\n")[0])


def test_the_file_says_what_it_is(stopped):
    found = head(stopped)
    assert FACTS.items() <= found.items()
    assert (found["walkers"], found["parameters"]) == (24, 3)


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


@pytest.mark.parametrize(
    ("first", "part"),
    [
        (b'{"checkpoint format": 3}\n', "checkpoint format was 3 and is 4 now"),
        (b"{}\n", "checkpoint format was not there"),
        (b"[]\n", "steps.steps: cannot be resumed ("),
        (b"\x80\x04\x95\n", "steps.steps: cannot be resumed ("),
        *(
            (
                json.dumps({"checkpoint format": 4, **FACTS, "parameters": 3} | more).encode()
                + b"\n",
                "steps.steps: cannot be resumed (",
            )
            for more in ({}, {"walkers": -1}, {"walkers": 10**12}, {"walkers": "3"})
        ),
    ],
)
def test_what_is_no_checkpoint_is_refused(stopped, first, part):
    path = stopped / "steps.steps"
    path.write_bytes(first + path.read_bytes().partition(b"\n")[2])
    refused(stopped, part)


# -- what is damaged is sampled again


def cut(share):
    return lambda raw: raw[: int(share * len(raw))]


def flipped(raw):
    place = len(raw) // 2
    return raw[:place] + bytes([raw[place] ^ 4]) + raw[place + 1 :]


@pytest.mark.parametrize(
    "damage",
    [
        *(cut(share) for share in (0.0, 0.0002, 0.01, 0.3, 0.9)),
        flipped,
        lambda raw: raw + bytes(100_000),  # as a machine that lost its power may leave it
        lambda raw: raw + raw[-5000:],
    ],
)
def test_damaged_files_are_gone_on_with_from_what_is_whole(stopped, whole, damage):
    path = stopped / "steps.steps"
    path.write_bytes(damage(path.read_bytes()))
    same(run(stopped)[0], whole)


# -- when the disk fails


def test_a_save_that_fails_leaves_the_last_checkpoint(stopped, whole, monkeypatch):
    before = saved(stopped)

    def half_full(*arguments):
        file = open_(*arguments)
        write = file.write

        def written(raw):
            write(raw[: len(raw) // 2])
            raise OSError(errno.ENOSPC, "No space left on device")

        file.write = written
        return file

    open_ = module.Path.open
    with monkeypatch.context() as patch:
        patch.setattr(module.Path, "open", half_full)
        with pytest.raises(OSError, match="No space"):
            run(stopped)
    assert saved(stopped) == before
    same(run(stopped)[0], whole)


# -- killed in a process of its own


def killed(folder, kills, moments):
    """Start sampling anew after every kill; how many steps were on disk at each."""
    counted = []
    for _ in range(kills):
        process = subprocess.Popen(
            [sys.executable, "-m", "tests.inference.two_valleys", str(folder)], cwd=REPOSITORY
        )
        begun = counted[-1] if counted else 0
        for _ in range(6000):
            if saved(folder) > begun or process.poll() is not None:
                break
            time.sleep(0.01)
        time.sleep(moments.uniform(0.0, 0.1))
        process.send_signal(signal.SIGKILL)
        process.wait()
        counted.append(saved(folder))
    return counted


@pytest.mark.parametrize("kills", [2, pytest.param(50, marks=pytest.mark.slow)], ids=["2", "50"])
def test_killed_at_random_moments(whole, tmp_path, kills):
    moments = random.Random(6)
    for _ in range(-(-kills // 3)):
        folder = tmp_path / "checkpoint"
        folder.mkdir()
        assert killed(folder, min(3, kills), moments)[0] > 0
        same(run(folder)[0], whole)
        shutil.rmtree(folder)


def test_saving_is_rationed(monkeypatch, tmp_path):
    """Its share of the time stays below what it may have, on a disk however slow."""
    monkeypatch.setattr(module, "_SHARE", 0.02)
    saves, open_ = [], module.Path.open

    def slow(path, mode, *more):
        if mode != "rb":
            time.sleep(0.05)
            saves.append(mode)
        return open_(path, mode, *more)

    monkeypatch.setattr(module.Path, "open", slow)
    run(tmp_path)
    # 110 steps in a fraction of a second: the first is saved, none of the others
    assert saves == ["wb"]
