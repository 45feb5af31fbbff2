"""``bayesfric estimate`` on mechanisms and recordings that are legal and odd."""

import numpy as np
import pytest

from bayesfric.mechanism.presets import PRESETS

from .bench import SMALL, cases, has

pytestmark = pytest.mark.usefixtures("nothing_explained")

PENDULUM = f"""{SMALL.replace("motor-axis", "servo-pendulum")}
[simulation]
duration = 6.0
rate = 200
excitation = "multisine"
amplitude = 0.4
torque_noise = 0.005
"""


@pytest.fixture
def pendulum(bench):
    bench.simulated(PENDULUM)
    return bench


def estimates(bench, *arguments):
    return bench.told("estimate", "c.toml", *arguments)["estimates"]


def test_a_stribeck_rise_that_may_vanish(pendulum):
    pendulum.config(
        PENDULUM.replace(
            'preset = "servo-pendulum"',
            'preset = "servo-pendulum"\n[mechanism.elements.motor]\nstribeck = true',
        )
    )
    found = estimates(pendulum, "--method", "input-error")["input-error"]["parameters"]
    assert found["motor.stribeck_velocity"]["value"] >= 0.0
    inertia, true = found["motor.inertia"], PRESETS["servo-pendulum"].values["motor.inertia"]
    assert abs(inertia["value"] - true) < 5.0 * inertia["sd_robust"]


def test_one_element_with_two_losses(pendulum):
    text = """\
[mechanism]
[mechanism.load]
inertia = true
[mechanism.elements.g]
coulomb = "symmetric"
viscous = true
load_loss = "two"
inertia = true
"""
    pendulum.config(text + PENDULUM[PENDULUM.index("[[recordings]]") :])
    assert set(estimates(pendulum, "--method", "input-error")) == {"input-error"}


@pytest.mark.parametrize(
    ("segment", "words"),
    cases(("short", "0.05", ["segment", "20 samples"]), ("tiny", "1e-9", ["segment"])),
)
def test_segments_too_short_to_simulate(pendulum, segment, words):
    pendulum.config(PENDULUM + f"\n[estimation]\nsegment = {segment}\n")
    has(pendulum.refused("estimate", "c.toml"), *words)


def test_rest_leaves_no_certainty_of_its_own(pendulum):
    """Most of the time at rest: the robust scale of the residuals is zero there."""

    def rested(table):
        rest = np.tile(table[-1], (2 * len(table), 1))
        rest[:, 0] += 0.005 * np.arange(1, len(rest) + 1)
        rest[:, 2] = 0.0
        return np.concatenate([table, rest])

    pendulum.altered(rested)
    pendulum.config(PENDULUM + "\n[estimation]\nsegment = 1.0\n")
    found = estimates(pendulum, "--method", "output-error")["output-error"]
    sds = [row["sd"] for row in found["parameters"].values() if row["sd"] is not None]
    assert sds
    assert min(sds) > 0.0


def test_torque_of_no_joint(pendulum):
    pendulum.altered(lambda table: table * [1.0, 1.0, 1e-200])
    has(pendulum.refused("estimate", "c.toml"), "small.csv", "torque", "unit")
