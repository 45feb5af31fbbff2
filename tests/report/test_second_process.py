"""What two processes write is what one writes, whatever becomes of the second."""

import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from bayesfric.report.figures.style import ALL_KINDS, COLUMN, paper_style, save
from bayesfric.report.second_process import second_process, shared_work


@pytest.fixture(autouse=True)
def two_cores(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1}, raising=False)
    # the second process looks up what this file defines
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))


@pytest.fixture
def helpers(monkeypatch):
    """Every second process that was started."""
    started = []

    class Watched(subprocess.Popen):
        def __init__(self, *args, **options):
            super().__init__(*args, **options)
            started.append(self)

    monkeypatch.setattr(subprocess, "Popen", Watched)
    return started


def figure(k):
    from matplotlib.figure import Figure

    with paper_style():
        drawn = Figure(figsize=(COLUMN, 2.0))
        ax = drawn.subplots()
        x = np.linspace(0.0, 6.0, 50)
        ax.plot(x, np.sin(x + k))
        ax.set_xlabel(rf"$\alpha_{k}$ (rad)")
    return drawn


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def saving(folder, drawing, k):
    return partial(save, drawing, folder, f"figure{k}", ALL_KINDS)


def saved(folder, drawn, between=lambda: None):
    folder.mkdir()
    with shared_work() as share:
        for k, one in enumerate(drawn):
            share(f"figure {k}", saving(folder, one, k))
            between()
    return contents(folder)


def alone(folder, drawn):
    folder.mkdir()
    for k, one in enumerate(drawn):
        save(one, folder, f"figure{k}")
    return contents(folder)


def told(folder, k):
    (folder / f"by{k}").write_text(str(os.getpid()), encoding="utf-8")


def test_the_bytes_are_those_of_one_process(tmp_path, helpers):
    # drawn here and sent, or sent to be drawn
    two = saved(tmp_path / "two", [figure(0), partial(figure, 1), partial(figure, 2)])
    assert two == alone(tmp_path / "one", [figure(k) for k in range(3)])
    assert len(two) == 9
    assert [h.returncode for h in helpers] == [-signal.SIGKILL]


def test_both_work_and_each_work_is_done_once(tmp_path, helpers):
    begun = []
    with shared_work(lambda progress: begun.append(progress.phase)) as share:
        for k in range(4):
            share(f"work {k}", partial(told, tmp_path, k))
    assert sorted(begun) == [f"work {k}" for k in range(4)]
    by = {int((tmp_path / f"by{k}").read_text(encoding="utf-8")) for k in range(4)}
    # the first was sent before the others were there to take
    assert (tmp_path / "by0").read_text(encoding="utf-8") == str(helpers[0].pid)
    assert by == {helpers[0].pid, os.getpid()}


def test_a_second_process_that_dies_loses_nothing(tmp_path, helpers):
    def kill():
        helpers[0].kill()
        helpers[0].wait()

    two = saved(tmp_path / "two", [figure(k) for k in range(3)], between=kill)
    assert two == alone(tmp_path / "one", [figure(k) for k in range(3)])


def test_a_figure_that_cannot_be_sent_is_saved_here(tmp_path):
    odd = figure(0)
    odd.note = lambda: None
    assert saved(tmp_path / "two", [odd]) == alone(tmp_path / "one", [figure(0)])


def test_none_can_be_started(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "executable", str(tmp_path / "no-python"))
    assert saved(tmp_path / "two", [figure(0)]) == alone(tmp_path / "one", [figure(0)])


def test_one_that_was_started_before_is_used(tmp_path, helpers):
    with second_process():
        assert saved(tmp_path / "two", [figure(0)]) == alone(tmp_path / "one", [figure(0)])
        assert len(helpers) == 1
    with second_process():
        pass
    assert [h.returncode for h in helpers] == [-signal.SIGKILL] * 2


def test_one_core_needs_no_second_process(tmp_path, monkeypatch, helpers):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    assert len(saved(tmp_path / "one", [figure(0)])) == 3
    assert helpers == []


def test_a_folder_that_vanished_is_told_here(tmp_path, helpers):
    folder = tmp_path / "run"
    folder.mkdir()

    def draw():
        with shared_work() as share:
            folder.rmdir()
            share("figure", saving(folder, figure(0), 0))

    with pytest.raises(FileNotFoundError):
        draw()
    assert helpers[0].returncode is not None


def test_an_error_while_drawing_ends_the_second_process(tmp_path, helpers):
    def draw():
        with shared_work() as share:
            share("figure", saving(tmp_path, figure(0), 0))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        draw()
    assert helpers[0].returncode == -signal.SIGKILL
