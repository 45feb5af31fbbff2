from contextlib import nullcontext

import pytest

from bayesfric.report import run_directory

from .bench import Bench


@pytest.fixture
def bench(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    return Bench(tmp_path, monkeypatch, capfd)


@pytest.fixture
def no_figures(monkeypatch):
    """For runs whose figures nobody looks at: they take longer than the sampling."""
    without_figures(monkeypatch)


def without_figures(patch):
    patch.setattr(run_directory, "FIGURES", {})
    patch.setattr(run_directory, "forest_figure", lambda _: None)
    patch.setattr(run_directory, "two_at_once", lambda _: nullcontext(lambda *_: None))
