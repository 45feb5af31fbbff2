"""A fit that a user or the system interrupts leaves nothing half-written, and no lock."""

import os
import signal

import pytest

from bayesfric.commands.fit import run_lock
from bayesfric.inference import sampling
from bayesfric.inference.target import Target
from bayesfric.report import run_directory

from .bench import has, simulated
from .test_fit import FEW

pytestmark = pytest.mark.usefixtures("nothing_explained", "no_figures")

COMMAND = ("fit", "few.toml", "-o", "run")
SIGNALS = (signal.SIGINT, signal.SIGTERM)


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


def in_the_likelihood(monkeypatch, stop):
    def warm_up(warm, *_):
        monkeypatch.setattr(Target, "__call__", stop)
        warm.run(10)

    monkeypatch.setattr(sampling, "_warm_up", warm_up)


def in_the_writing(monkeypatch, stop):
    monkeypatch.setattr(run_directory, "posterior_tree", stop)


@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize("moment", [in_the_likelihood, in_the_writing])
def test_an_interrupted_fit_leaves_nothing(here, monkeypatch, moment, number):
    before = here.held()
    moment(monkeypatch, lambda *_: os.kill(os.getpid(), number))
    ended = here.run(*COMMAND, "--json")
    assert (ended.code, ended.out) == (130, "")
    assert here.held() == before


def test_a_run_that_another_process_makes_is_refused(here):
    with run_lock(here.folder / "run"):
        has(here.refused(*COMMAND), "run: another process")
