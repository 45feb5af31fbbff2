"""A run can be repeated from itself: its ``config.toml`` finds its recordings from anywhere."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from bayesfric.commands.fit import fit
from bayesfric.diagnostics import explanation
from bayesfric.problem.config import read_config

from .bench import SAMPLED, has, simulated, without_figures
from .test_fit import draws

pytestmark = pytest.mark.usefixtures("nothing_explained")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a project and a finished run of it."""
    folder = tmp_path_factory.mktemp("again")
    (folder / "project").mkdir()
    simulated(folder / "project" / "c.toml", SAMPLED)
    with pytest.MonkeyPatch.context() as patch:
        without_figures(patch)
        patch.setattr(explanation, "LEAST_OUTPUTS", 10**9)
        # names as a user gives them: relative to where one is
        patch.chdir(folder / "project")
        fit(read_config(Path("c.toml")), Path("../run"))
    return folder


@pytest.fixture
def there(bench, folder, monkeypatch):
    without_figures(monkeypatch)
    monkeypatch.chdir(folder)
    return bench


def test_the_configuration_of_a_run_repeats_it(there, folder):
    assert (folder / "run" / "config.toml").read_text() == SAMPLED
    # and so does that of its repetition
    for first, second in (("run", "again"), ("again", "thrice")):
        ended = there.run("fit", f"{first}/config.toml", "-o", second)
        assert ended.code == 0, ended
        found = draws(folder / second)
        for name, values in draws(folder / "run").items():
            np.testing.assert_array_equal(found[name], values, err_msg=name)


def test_a_recording_that_moved_may_lie_beside(there, folder):
    file = folder / "project" / "small.csv"
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    (source,) = json.loads((folder / "run/summary.json").read_text())["source"][
        "recordings"
    ].values()
    assert source == {"file": str(file), "sha256": digest}
    moved = file.rename(file.with_name("elsewhere.csv"))
    for command in ("check", "fit"):
        has(there.refused(command, "run/config.toml"), "run/small.csv")
    # where the message says
    moved.rename(folder / "run" / "small.csv")
    assert there.run("check", "run/config.toml").code == 0
    (folder / "run" / "small.csv").rename(file)


def test_a_recording_that_changed_since_is_warned_of(there, folder):
    assert "SHA-256" not in there.run("check", "run/config.toml").out
    file = folder / "project" / "small.csv"
    whole = file.read_text()
    file.write_text(whole[: whole.rstrip().rindex("\n") + 1])
    has(there.run("check", "run/config.toml").out, "changed since the run was made")
    file.write_text(whole)


@pytest.mark.parametrize("text", ["", "[]", '{"bayesfric": "0.1.0"}'])
def test_what_no_run_wrote_beside_changes_nothing(bench, text):
    place = bench.folder / "config.toml"
    (bench.folder / "c.toml").rename(place)
    place.with_name("summary.json").write_text(text)
    assert read_config(place).folder == bench.folder
