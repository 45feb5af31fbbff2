"""`explain` on the command line and in Python, on a SIMULATED recording that lacks a term."""

from dataclasses import replace

import pytest

import bayesfric as bf
from bayesfric.fit.model import Model
from bayesfric.problem.config import parse_config, read_config, with_settings

from .bench import JOINT, has, recorded

BY_DIRECTION = '[mechanism.elements.motor]\nviscous = "by-direction"\n'
SIMULATION = """
[simulation]
duration = 12
rate = 500
excitation = "multisine"
amplitude = 1.5
torque_noise = 0.02
encoder_side = "joint"

[simulation.parameters]
"motor.inertia" = 0.05
"motor.viscous_positive" = 0.2
"motor.viscous_negative" = 0.3
"motor.coulomb" = 0.2
"offset" = 0.05
"""


@pytest.fixture
def swing(bench):
    bench.simulated(JOINT + BY_DIRECTION + SIMULATION)
    bench.config(JOINT + recorded())
    return bench


LINE = 'mechanism.elements.motor.viscous = "by-direction"'


def test_what_is_missing_is_named_with_what_to_write(swing):
    found = printed = swing.told("explain", "c.toml")
    (one,) = found["findings"]
    assert (one["kind"], one["hint"]) == ("viscous_by_direction", LINE)
    assert not set(found["kinds"]) & set(found["untold"])
    # nothing tells an inertia before the shaft from one behind it
    assert "inertia" in found["untold"]
    # and Python returns what the command prints
    found = bf.Model.from_config("c.toml").explain()
    same = ("findings", "kinds", "untold", "twins", "reason")
    assert {k: found.as_json()[k] for k in same} == {k: printed[k] for k in same}
    assert list(found.frame["kind"]) == ["viscous_by_direction"]


def test_too_few_outputs_are_said_to_be(swing):
    more = '[processing]\ndecimate = 100\nband = "2 Hz"\n'
    swing.config(JOINT + recorded() + more)
    has(swing.run("explain", "c.toml").out, "was not tested", "too few outputs")


# -- terms = "auto", and a better configuration


COMMENTED = f"""# the bench in the cellar
{JOINT.strip()}  # one axis

# recorded on Monday
{recorded()}
"""


def test_what_is_missing_is_put_in_comments_stay_and_the_file_fits(swing):
    path = swing.folder / "better.toml"
    swing.config(COMMENTED)
    printed = swing.told("explain", "c.toml", "-o", "better.toml")
    assert [one["kind"] for one in printed["taken"]] == ["viscous_by_direction"]
    assert printed["findings"] == []
    better = Model.from_config(path)
    comments = [line.partition("#")[1:] for line in COMMENTED.splitlines() if "#" in line]
    assert [line.partition("#")[1:] for line in better.config.text.splitlines() if "#" in line] == (
        comments
    )
    swing.config(JOINT + BY_DIRECTION + recorded())
    assert better.chain == Model.from_config(swing.folder / "c.toml").chain


AUTO = JOINT + 'terms = "auto"\n' + recorded()


@pytest.mark.usefixtures("no_figures")
def test_auto_fits_with_what_was_missing_and_its_run_is_as_written(swing):
    swing.config(AUTO)
    found = swing.told("check", "c.toml")
    assert [one["kind"] for one in found["taken"]] == ["viscous_by_direction"]
    assert found["findings"] == []
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


def test_a_name_that_it_would_take_away_keeps_a_term_out(swing):
    swing.config(AUTO + '[priors]\n"motor.viscous" = [0.0, 1.0]\n')
    model, taken, left = Model.from_config(swing.folder / "c.toml").completed()
    assert taken == ()
    assert [one.kind for one in left.findings] == ["viscous_by_direction"]
    assert "motor.viscous" in model.chain.names


def test_it_is_written_beside_the_configuration_and_over_nothing(swing):
    (swing.folder / "there.toml").write_text("mine")
    for name, what in (
        ("there.toml", "exists"),
        ("/tmp/better.toml", "is not in the configuration"),
        ("better.pdf", "is not named .toml"),
    ):
        ended = swing.run("explain", "c.toml", "-o", name)
        assert ended.code == 2
        assert what in ended.err
    assert (swing.folder / "there.toml").read_text() == "mine"


@pytest.mark.parametrize(
    "text",
    [
        '[mechanism]\npreset = "servo-pendulum"\n# left\n',
        'mechanism.preset = "servo-pendulum"  # left\n',
        'mechanism = { preset = "servo-pendulum" } # left\n',
        '[mechanism]  # left\npreset = "servo-pendulum"\nelements.motor.viscous = true\n',
        "[mechanism.load]  # left\ninertia = true\n[priors]\n[mechanism]\n"
        'preset = "servo-pendulum"\n',
    ],
)
@pytest.mark.parametrize("table", ["motor", "gearbox"])
def test_settings_are_put_into_toml_of_any_style(tmp_path, text, table):
    config = parse_config(text + recorded(), tmp_path / "c.toml")
    lines = ["mechanism.delay = true", f'mechanism.elements.{table}.viscous = "by-direction"']
    made = with_settings(config, lines)
    assert "# left" in made.text
    expected = config.tables.mechanism.joint()
    elements = [
        replace(element, viscous="by-direction") if element.name == table else element
        for element in expected.elements
    ]
    assert made.tables.mechanism.joint() == replace(expected, elements=tuple(elements), delay=True)


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
