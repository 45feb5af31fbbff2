"""A late position on the command line: simulated, checked, asked of with a parameter of its own."""

import pytest

import bayesfric as bf

from .bench import recorded

JOINT = '[mechanism]\npreset = "servo-pendulum"\n{delay}\n'
SIMULATION = """
[simulation]
rate = 500
excitation = "multisine"
amplitude = 1.0
torque_noise = 0.01
encoder_side = "joint"

[simulation.parameters]
"drive.delay" = 0.004
"""


@pytest.fixture
def late(bench):
    """Simulate a recording that is two samples late; write configurations that read it."""
    bench.simulated(JOINT.format(delay="delay = true") + SIMULATION)

    def config(delay="", more=""):
        bench.config(JOINT.format(delay=delay) + recorded() + more)
        return bench

    return config


def test_check_finds_it_and_warns(late):
    late()
    checked = bf.check("c.toml")  # which is what the command prints
    found = checked.as_json()
    # the servo's only inertia stands before its load loss
    assert [doubt["kind"] for doubt in found["doubts"]] == ["missing", "unseen-inertia"]
    assert [one["kind"] for one in found["findings"]] == ["delay"]
    assert "delay = true in [mechanism]" in checked.text()


def test_a_joint_that_has_it_is_not_warned_of(late):
    found = late("delay = true").told("check", "c.toml")
    assert "delay" not in [one["kind"] for one in found["findings"]]
    assert found["priors"]["drive.delay"]["default"]
    row = found["least_squares"]["parameters"]["drive.delay"]
    assert row["value"] == pytest.approx(0.004, rel=0.1)


def test_a_number_fixes_it(late):
    bench = late("delay = true", '\n[priors]\n"drive.delay" = 0.004\n')
    found = bench.told("check", "c.toml")
    assert found["recordings"][0]["settings"]["delay"] == 0.004
    assert found["priors"]["drive.delay"]["prior"].startswith("fixed")


@pytest.mark.parametrize(
    ("delay", "more", "says"),
    [
        ('delay = "2 ms"', "", "mechanism.delay"),
        ("", '\n[priors]\n"drive.delay" = 0.004\n', "priors.drive.delay"),
        ("delay = true", '\n[priors]\n"drive.delay" = 4.0\n', "correct the time stamps"),
    ],
)
def test_what_cannot_be_is_refused(late, delay, more, says):
    ended = late(delay, more).run("check", "c.toml")
    assert ended.code == 2
    assert says in ended.err
    assert ended.err.count("\n") == 1
