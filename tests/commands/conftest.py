import pytest

from .bench import Bench, without_figures


@pytest.fixture
def bench(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    return Bench(tmp_path, monkeypatch, capfd)


@pytest.fixture
def no_figures(monkeypatch):
    """For runs whose figures nobody looks at: they take longer than the sampling."""
    without_figures(monkeypatch)
