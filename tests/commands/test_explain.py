"""`explain` on the command line and in Python, on a SIMULATED recording that lacks a term."""

import pytest

import bayesfric as bf

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
    text = swing.run("explain", "c.toml").out
    has(" ".join(text.split()), 'viscous = "by-direction" in [mechanism.elements.motor]')
    assert len(text.splitlines()) < 10
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


def test_a_model_that_lacks_nothing_is_told_so(swing):
    swing.config(JOINT + BY_DIRECTION + recorded())
    assert swing.run("explain", "c.toml").out.startswith("None of")


def test_too_few_outputs_are_said_to_be(swing):
    more = '[processing]\ndecimate = 100\nband = "2 Hz"\n'
    swing.config(JOINT + recorded() + more)
    has(swing.run("explain", "c.toml").out, "was not asked", "too few outputs")


@pytest.mark.usefixtures("swing")
def test_what_a_fit_finds_is_what_would_put_it_in():
    found = bf.Model.from_config("c.toml").fit().summary.findings
    assert [one.kind for one in found] == ["viscous_by_direction"]
    assert found[0].hint == LINE
