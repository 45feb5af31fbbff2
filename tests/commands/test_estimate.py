"""``bayesfric estimate``: the three methods as a user sees them, and references."""

import numpy as np
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.fit.model import Model
from bayesfric.problem.config import read_config

from .bench import SMALL, cases, has, simulation

CONFIG = f"""{SMALL}
[references]
"motor.inertia" = {{ value = 0.0101, sd = 2e-4, source = "data sheet" }}
motor.viscous = 0.05
{simulation(duration=4.0, rate=500, encoder_counts=2**20, torque_noise=0.01)}"""


@pytest.fixture
def small(bench):
    bench.simulated(CONFIG)
    return bench


@pytest.mark.parametrize(
    ("old", "new", "words"),
    cases(
        (
            "unknown",
            "motor.viscous = 0.05",
            "motor.viscos = 0.05",
            ["references.motor.viscos", "no result", "'motor.viscous'"],
        ),
        ("text", "motor.viscous = 0.05", 'motor.viscous = "0.05"', ["references.motor.viscous"]),
        ("sd", "sd = 2e-4", "sd = -2e-4", ["references.motor.inertia.sd", "greater than 0"]),
        ("key", 'source = "data', 'sauce = "data', ["references.motor.inertia.sauce"]),
    ),
)
def test_bad_references(bench, old, new, words):
    assert old in CONFIG
    bench.simulated(CONFIG)
    bench.config(CONFIG.replace(old, new))
    has(bench.refused("estimate", "c.toml"), *words)


def test_the_output_error_likelihood_needs_a_point(small):
    text = CONFIG + '\n[likelihood]\nmethod = "output-error"\n'
    small.config(text)
    problem = Model.from_config(read_config(small.folder / "c.toml"))
    with pytest.raises(ValueError, match="point"):
        problem.target()
    assert {"noise.torque", "noise.position"} <= set(problem.priors)


def test_noise_that_is_to_be_chosen_is_not_silently_white(small):
    problem = Model.from_config(small.folder / "c.toml")
    with pytest.raises(ValueError, match="white_target"):
        problem.target()
    small.config(CONFIG + '\n[noise]\nmodel = "white"\n')
    told = Model.from_config(small.folder / "c.toml")
    assert told.target().names == problem.white_target().names


def test_a_noise_prior_of_the_other_likelihood_is_refused(small):
    small.config(CONFIG + '\n[priors]\n"noise.torque" = [0, 1]\n')
    with pytest.raises(BadInput, match=r"noise\.torque"):
        Model.from_config(read_config(small.folder / "c.toml"))


# -- mechanisms and recordings that are legal and odd


pytestmark = pytest.mark.usefixtures("nothing_explained")

PENDULUM = SMALL.replace("motor-axis", "servo-pendulum")
PENDULUM += simulation(duration=6.0, amplitude=0.4, torque_noise=0.005)


@pytest.fixture
def pendulum(bench):
    bench.simulated(PENDULUM)
    return bench


def estimates(bench, *arguments):
    return bench.told("estimate", "c.toml", *arguments)["estimates"]


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
    assert {row["sd"] for row in found["parameters"].values()} == {None}


def test_torque_of_no_joint(pendulum):
    pendulum.altered(lambda table: table * [1.0, 1.0, 1e-200])
    has(pendulum.refused("estimate", "c.toml"), "small.csv", "torque", "unit")
