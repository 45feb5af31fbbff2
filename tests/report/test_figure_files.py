"""Figures saved by two processes are those that one saves, whatever becomes of the second."""

import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from bayesfric.report.figures import files as figure_files
from bayesfric.report.figures.files import two_at_once
from bayesfric.report.figures.style import COLUMN, paper_style, save


@pytest.fixture(autouse=True)
def two_cores(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1}, raising=False)


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


def saved(folder, drawn, between=lambda: None):
    folder.mkdir()
    with two_at_once(folder) as share:
        for k, one in enumerate(drawn):
            share(one, f"figure{k}")
            between()
    return contents(folder)


def alone(folder, drawn):
    folder.mkdir()
    for k, one in enumerate(drawn):
        save(one, folder, f"figure{k}")
    return contents(folder)


def test_the_bytes_are_those_of_one_process(tmp_path, monkeypatch, helpers):
    here = []
    monkeypatch.setattr(figure_files, "save", lambda *a: (here.append(a[2]), save(*a)))
    two = saved(tmp_path / "two", [figure(k) for k in range(3)])
    assert two == alone(tmp_path / "one", [figure(k) for k in range(3)])
    assert len(two) == 9
    assert "figure0" not in here  # the second process was free, and did it
    assert [h.returncode for h in helpers] == [-signal.SIGKILL]


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


def test_one_core_needs_no_second_process(tmp_path, monkeypatch, helpers):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    assert len(saved(tmp_path / "one", [figure(0)])) == 3
    assert helpers == []


def test_a_folder_that_vanished_is_told_here(tmp_path, helpers):
    folder = tmp_path / "run"
    folder.mkdir()

    def draw():
        with two_at_once(folder) as share:
            folder.rmdir()
            share(figure(0), "figure")

    with pytest.raises(FileNotFoundError):
        draw()
    assert helpers[0].returncode is not None


def test_an_error_while_drawing_ends_the_second_process(tmp_path, helpers):
    def draw():
        with two_at_once(tmp_path) as share:
            share(figure(0), "figure")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        draw()
    assert helpers[0].returncode == -signal.SIGKILL
