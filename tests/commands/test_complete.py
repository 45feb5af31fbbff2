"""``terms = "auto"`` and ``explain -o BETTER.toml`` put in what else explains the torque."""

import pytest

from bayesfric.model import Model
from bayesfric.problem.config import read_config
from bayesfric.problem.config_text import with_settings

from .bench import JOINT, recorded
from .test_explain import BY_DIRECTION, swing  # noqa: F401  (a fixture)


def test_what_is_missing_is_put_in_and_the_file_fits(swing):  # noqa: F811
    path = swing.folder / "better.toml"
    printed = swing.told("explain", "c.toml", "-o", "better.toml")
    assert [one["kind"] for one in printed["taken"]] == ["viscous_by_direction"]
    assert printed["findings"] == []
    better = Model.from_config(path)
    swing.config(JOINT + BY_DIRECTION + recorded())
    assert better.chain == Model.from_config(swing.folder / "c.toml").chain


AUTO = JOINT + 'terms = "auto"\n' + recorded()


@pytest.mark.usefixtures("no_figures")
def test_auto_fits_with_what_was_missing_and_its_run_is_as_written(swing):  # noqa: F811
    swing.config(AUTO)
    assert swing.run("fit", "c.toml", "-o", "run").code == 0
    run = swing.folder / "run"
    summary = swing.summary()
    assert [one["kind"] for one in summary["taken"]] == ["viscous_by_direction"]
    assert summary["findings"] == []
    for name, true in (("motor.viscous_positive", 0.2), ("motor.viscous_negative", 0.3)):
        row = summary["parameters"][name]
        assert row["verdict"] == "data"
        assert abs(row["mean"] - true) < 4.0 * row["sd"]
    again = read_config(run / "config.toml").tables.mechanism
    assert again.terms == "as written"
    assert swing.run("rollout", "run", "c.toml").code == 0  # whose mechanism is the run's
    swing.config(JOINT + BY_DIRECTION + recorded())
    assert again.joint() == read_config(swing.folder / "c.toml").tables.mechanism.joint()


def test_a_check_says_what_auto_will_put_in(swing):  # noqa: F811
    swing.config(AUTO)
    found = swing.told("check", "c.toml")
    assert [one["kind"] for one in found["taken"]] == ["viscous_by_direction"]
    assert found["findings"] == []


def test_a_name_that_it_would_take_away_keeps_a_term_out(swing):  # noqa: F811
    swing.config(AUTO + '[priors]\n"motor.viscous" = [0.0, 1.0]\n')
    model, taken, left = Model.from_config(swing.folder / "c.toml").completed()
    assert taken == ()
    assert [one.kind for one in left.findings] == ["viscous_by_direction"]
    assert "motor.viscous" in model.chain.names


def test_it_is_written_beside_the_configuration_and_over_nothing(swing):  # noqa: F811
    (swing.folder / "there.toml").write_text("mine")
    for name, what in (
        ("there.toml", "is there already"),
        ("/tmp/better.toml", "is not beside"),
        ("better.pdf", "is not named .toml"),
    ):
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
