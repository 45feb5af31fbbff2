"""``bayesfric estimate``: the paper's methods on legal and odd recordings, and references."""

import numpy as np
import pytest

from bayesfric.fit.model import Model

from .bench import SMALL, cases, has, simulation

pytestmark = pytest.mark.usefixtures("nothing_explained")

CONFIG = f"""{SMALL}
[references]
"motor.inertia" = {{ value = 0.0101, sd = 2e-4, source = "data sheet" }}
motor.viscous = 0.05
{simulation(duration=4.0, rate=500, encoder_counts=2**20, torque_noise=0.01)}"""
PENDULUM = SMALL.replace("motor-axis", "servo-pendulum")
PENDULUM += simulation(duration=6.0, amplitude=0.4, torque_noise=0.005)


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    cases(
        ("name", "motor.viscous =", "motor.viscos =", ["references.motor.viscos", "viscous'"]),
        ("text", "viscous = 0.05", 'viscous = "0.05"', ["references.motor.viscous"]),
        ("sd", "sd = 2e-4", "sd = -2e-4", ["references.motor.inertia.sd"]),
    ),
)
def test_bad_references(bench, old, new, parts):
    bench.simulated(CONFIG)
    bench.config(CONFIG.replace(old, new))
    has(bench.refused("estimate", "c.toml"), *parts)


@pytest.mark.parametrize(
    ("text", "match"),
    [("", "white_target"), ('\n[likelihood]\nmethod = "output-error"\n', "point")],
)
def test_a_target_needs_its_noise_model_or_point(bench, text, match):
    bench.simulated(CONFIG)
    bench.config(CONFIG + text)
    with pytest.raises(ValueError, match=match):
        Model.from_config(bench.folder / "c.toml").target()


@pytest.fixture
def pendulum(bench):
    bench.simulated(PENDULUM)
    return bench


@pytest.mark.parametrize("segment", ["0.05", "1e-9"])
def test_segments_too_short_to_simulate(pendulum, segment):
    pendulum.config(PENDULUM + f"\n[estimation]\nsegment = {segment}\n")
    has(pendulum.refused("estimate", "c.toml"), "segment")


def test_standstill_gives_no_standard_deviation(pendulum):
    """Most of the time at standstill: the robust scale of the residuals is zero."""

    def with_standstill(table):
        still = np.tile(table[-1], (2 * len(table), 1))
        still[:, 0] += 0.005 * np.arange(1, len(still) + 1)
        still[:, 2] = 0.0
        return np.concatenate([table, still])

    pendulum.altered(with_standstill)
    pendulum.config(PENDULUM + "\n[estimation]\nsegment = 1.0\n")
    record = pendulum.record("estimate", "c.toml", "--method", "output-error")
    parameters = record["estimates"]["output-error"]["parameters"]
    assert {row["sd"] for row in parameters.values()} == {None}
