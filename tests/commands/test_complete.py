"""``explain -o BETTER.toml`` writes a configuration that lacks nothing that it knows to put in."""

import json

import pytest

from bayesfric.config import read_config
from bayesfric.config_text import with_settings
from bayesfric.model import Model

from .bench import JOINT, recorded
from .test_explain import BY_DIRECTION, swing  # noqa: F401  (a fixture)


def test_what_is_missing_is_put_in_and_the_file_fits(swing):  # noqa: F811
    path = swing.folder / "better.toml"
    printed = json.loads(swing.run("explain", "c.toml", "-o", "better.toml", "--json").out)
    assert [one["kind"] for one in printed["taken"]] == ["viscous_by_direction"]
    assert printed["left"] == []
    better = Model.from_config(path)
    swing.config(JOINT + BY_DIRECTION + recorded())
    assert better.chain == Model.from_config(swing.folder / "c.toml").chain
    assert not better.missing().findings


def test_it_is_written_beside_the_configuration_and_over_nothing(swing):  # noqa: F811
    (swing.folder / "there.toml").write_text("mine")
    for name, what in (("there.toml", "is there already"), ("/tmp/better.toml", "is not beside")):
        ended = swing.run("explain", "c.toml", "-o", name)
        assert ended.code == 2
        assert what in ended.err
    assert (swing.folder / "there.toml").read_text() == "mine"


@pytest.mark.parametrize(
    ("line", "key", "value"),
    [
        ("mechanism.elements.motor.cogging = [12]", "cogging", (4, 12)),
        ("mechanism.elements.motor.quadratic = true", "quadratic", True),
    ],
)
def test_settings_are_put_beside_what_is_there(tmp_path, line, key, value):
    path = tmp_path / "c.toml"
    path.write_text(JOINT + "[mechanism.elements.motor]\ncogging = [4]\n" + recorded())
    made = with_settings(read_config(path), [line]).tables.mechanism.joint()
    assert made.elements[0].choices[key] == value
    assert made.elements[0].choices["cogging"][0] == 4
