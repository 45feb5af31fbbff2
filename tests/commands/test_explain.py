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


def test_the_missing_term_is_found_with_its_setting(swing):
    printed = swing.record("explain", "c.toml")
    (finding,) = printed["findings"]
    assert (finding["kind"], finding["hint"]) == ("viscous_by_direction", LINE)
    assert not set(printed["kinds"]) & set(printed["untold"])
    # an inertia before the shaft is the same as one behind it
    assert "inertia" in printed["untold"]
    # Python returns what the command prints
    returned = bf.Model.from_config("c.toml").explain()
    same = ("findings", "kinds", "untold", "twins", "reason")
    assert {k: returned.as_json()[k] for k in same} == {k: printed[k] for k in same}
    assert list(returned.frame["kind"]) == ["viscous_by_direction"]


# -- terms = "auto", and a better configuration


COMMENTED = f"""# the bench in the cellar
{JOINT.strip()}  # one axis

# recorded on Monday
{recorded()}
"""


def test_a_better_configuration_keeps_comments(swing):
    swing.config(COMMENTED)
    printed = swing.record("explain", "c.toml", "-o", "better.toml")
    assert [finding["kind"] for finding in printed["taken"]] == ["viscous_by_direction"]
    assert printed["findings"] == []
    better = Model.from_config(swing.folder / "better.toml")

    def comments(text):
        return [line.partition("#")[1:] for line in text.splitlines() if "#" in line]

    assert comments(better.config.text) == comments(COMMENTED)
    swing.config(JOINT + BY_DIRECTION + recorded())
    assert better.chain == Model.from_config(swing.folder / "c.toml").chain


AUTO = JOINT + 'terms = "auto"\n' + recorded()


@pytest.mark.usefixtures("no_figures")
def test_auto_adds_the_missing_term_and_its_run_is_as_written(swing):
    swing.config(AUTO)
    checked = swing.record("check", "c.toml")
    assert swing.run("fit", "c.toml", "-o", "run").code == 0
    run = swing.folder / "run"
    summary = swing.summary()
    for record in (checked, summary):
        assert [finding["kind"] for finding in record["taken"]] == ["viscous_by_direction"]
        assert record["findings"] == []
    for name, true in (("motor.viscous_positive", 0.2), ("motor.viscous_negative", 0.3)):
        row = summary["parameters"][name]
        assert row["verdict"] == "data"
        assert abs(row["mean"] - true) < 4.0 * row["sd"]
    again = read_config(run / "config.toml").tables.mechanism
    assert again.terms == "as written"
    assert swing.run("rollout", "run", "c.toml").code == 0  # whose mechanism is the run's
    swing.config(JOINT + BY_DIRECTION + recorded())
    assert again.joint() == read_config(swing.folder / "c.toml").tables.mechanism.joint()


def test_a_parameter_with_a_prior_is_not_replaced(swing):
    swing.config(AUTO + '[priors]\n"motor.viscous" = [0.0, 1.0]\n')
    model, included, explained = Model.from_config(swing.folder / "c.toml").completed()
    assert included == ()
    assert [finding.kind for finding in explained.findings] == ["viscous_by_direction"]
    assert "motor.viscous" in model.chain.names


@pytest.mark.parametrize("name", ["existing.toml", "/tmp/better.toml", "better.pdf"])
def test_bad_names_of_a_better_configuration(swing, name):
    (swing.folder / "existing.toml").write_text("not to be lost")
    has(swing.refused("explain", "c.toml", "-o", name), name)


@pytest.mark.parametrize(
    "text",
    [
        '[mechanism]\npreset = "servo-pendulum"\n# left\n',
        'mechanism.preset = "servo-pendulum"  # left\n',
        'mechanism = { preset = "servo-pendulum" } # left\n',
        "[mechanism.load]  # left\ninertia = true\n[priors]\n[mechanism]\n"
        'preset = "servo-pendulum"\n',
    ],
)
def test_settings_are_added_to_toml_of_any_style(tmp_path, text):
    config = parse_config(text + recorded(), tmp_path / "c.toml")
    lines = ["mechanism.delay = true", LINE]
    changed = with_settings(config, lines)
    assert "# left" in changed.text
    expected = config.tables.mechanism.joint()
    elements = [
        replace(element, viscous="by-direction") if element.name == "motor" else element
        for element in expected.elements
    ]
    assert changed.tables.mechanism.joint() == replace(
        expected, elements=tuple(elements), delay=True
    )


def test_settings_are_added_to_those_of_an_element(tmp_path):
    text = JOINT + "[mechanism.elements.motor]\ncogging = [4]\n" + recorded()
    element = "mechanism.elements.motor"
    lines = [f"{element}.cogging = [12]", f"{element}.quadratic = true"]
    config = with_settings(parse_config(text, tmp_path / "c.toml"), lines)
    choices = config.tables.mechanism.joint().elements[0].choices
    assert (choices["cogging"], choices["quadratic"]) == ((4, 12), True)
