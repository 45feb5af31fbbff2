"""A run can be repeated from itself: its ``config.toml`` finds its recordings from anywhere."""

import hashlib
import json

import numpy as np
import pytest

from bayesfric.problem.config import read_config

from .bench import SAMPLED, has, simulated, without_figures
from .test_fit import draws

pytestmark = pytest.mark.usefixtures("nothing_explained")


@pytest.fixture
def run(bench, monkeypatch):
    """A finished run in a folder of its own, while one works in another."""
    without_figures(monkeypatch)
    place = bench.folder / "project"
    place.mkdir()
    simulated(place / "c.toml", SAMPLED)
    with monkeypatch.context() as patch:
        # names as a user gives them: relative to where one is
        patch.chdir(place)
        ended = bench.run("fit", "c.toml", "-o", "../run")
    assert ended.code == 0, ended
    return bench.folder / "run"


def test_the_configuration_of_a_run_repeats_it(bench, run):
    config = run / "config.toml"
    assert config.read_text() == SAMPLED
    for command in ("check", "identify", "estimate"):
        ended = bench.run(command, config)
        assert ended.code == 0, ended
    for first, second in (("run", "again"), ("again", "thrice")):
        ended = bench.run("fit", f"{first}/config.toml", "-o", second)
        assert ended.code == 0, ended
        found = draws(bench.folder / second)
        for name, values in draws(run).items():
            np.testing.assert_array_equal(found[name], values, err_msg=name)


def test_a_recording_that_moved_may_lie_beside(bench, run):
    file = bench.folder / "project" / "small.csv"
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    (source,) = json.loads((run / "summary.json").read_text())["source"]["recordings"].values()
    assert source == {"file": str(file), "sha256": digest}
    moved = file.rename(file.with_name("elsewhere.csv"))
    has(bench.refused("check", "run/config.toml"), "run/small.csv")
    moved.rename(run / "small.csv")
    assert bench.run("check", "run/config.toml").code == 0


@pytest.mark.usefixtures("run")
def test_a_recording_that_changed_since_is_warned_of(bench):
    assert "SHA-256" not in bench.run("check", "run/config.toml").out
    file = bench.folder / "project" / "small.csv"
    rows = file.read_text().splitlines()
    file.write_text("\n".join(rows[:-1]) + "\n")
    ended = bench.run("fit", "run/config.toml", "-o", "again")
    assert ended.code == 0, ended
    (line,) = [text for text in ended.out.splitlines() if "SHA-256" in text]
    has(line, "! small: changed since the run was made")


@pytest.mark.parametrize("text", ["", "{", "[]", '{"source": 3}', '{"bayesfric": "0.1.0"}'])
def test_what_no_run_wrote_beside_changes_nothing(bench, text):
    place = bench.folder / "config.toml"
    (bench.folder / "c.toml").rename(place)
    place.with_name("summary.json").write_text(text)
    assert read_config(place).folder == bench.folder
    assert bench.run("check", "config.toml").code == 0
