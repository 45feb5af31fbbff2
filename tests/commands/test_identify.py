"""``bayesfric identify`` as a user sees it: what cannot be told first, then why and what to do."""

from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from bayesfric.commands.analyse import identify
from bayesfric.fit.model import Model
from bayesfric.problem.config import read_config

from ..conftest import DATA, REPOSITORY
from .bench import JOINT, SMALL, recorded, simulated, simulation

FOLDER = Path(str(files("bayesfric") / "examples"))
UR10E = REPOSITORY / "studies" / "ur10e" / "ur10e-joint2.toml"
XL330 = REPOSITORY / "studies" / "xl330" / "xl330.toml"
SCALED = {
    "gearbox.alpha_drive",
    "gearbox.alpha_back",
    "joint.viscous",
    "joint.coulomb_positive",
    "joint.coulomb_negative",
    "load.inertia",
    "load.first_moment",
}
AXIS = SMALL + simulation(duration=2.0, rate=500, encoder_counts=2**20, torque_noise=0.01)


def null(found):
    return [one for one in found["directions"] if one["kind"] == "null"]


@pytest.fixture(scope="module")
def knee():
    return identify(Model.from_config(read_config(FOLDER / "knee.toml")))


def test_the_packaged_knee_alone_leaves_the_scale_open(knee):
    found, _ = knee
    (one,) = null(found)
    # no scaling moves what the estimate has at zero, and its sds are said to mean little there
    on_bound = {name for name, row in found["parameters"].items() if row["on_bound"]}
    assert len(on_bound) <= 1
    assert set(one["exponents"]) == SCALED - on_bound
    np.testing.assert_allclose(list(one["exponents"].values()), 1.0, atol=1e-6)
    assert one["log_sd"] is None
    # nothing that is not determined has a finite sd
    for name in set(found["parameters"]) - on_bound:
        row = found["parameters"][name]
        behind = name.replace("load_drive", "alpha_drive").replace("load_back", "alpha_back")
        assert (row["data_sd"] is None) == (behind in SCALED)
        assert row["expected_sd"] > 0


def test_the_known_mass_determines_everything(bench):
    """0.8 N m alone and 1.12 N m with 2 kg at 0.35 m, 10 s each, torque noise 0.02 N m."""
    found = bench.told("identify", FOLDER / "knee-loaded.toml")
    assert null(found) == []

    def relative(row):
        return row["expected_sd"] / abs(row["value"])

    assert relative(found["combinations"]["gearbox.alpha_drive"]) < 0.01
    assert relative(found["combinations"]["gearbox.alpha_back"]) < 0.025
    assert relative(found["parameters"]["load.first_moment"]) < 0.025
    assert {row["status"] for row in found["parameters"].values()} == {"identified"}


def test_the_likelihood_of_the_position(bench):
    bench.simulated(AXIS + '\n[likelihood]\nmethod = "output-error"\n')
    found = bench.told("identify", "c.toml")
    assert found["method"] == "output-error"
    assert null(found) == []
    truth = {"motor.inertia": 0.01, "motor.viscous": 0.05, "motor.coulomb": 0.2}
    for name, value in truth.items():
        row = found["parameters"][name]
        assert abs(row["value"] - value) < 5 * row["data_sd"]


def test_ur10e_with_two_load_losses_and_a_free_gravity_moment(bench, real_data):
    if not (real_data / "ur10e-joint2").is_dir():
        pytest.skip("the UR10e recording is not here")
    text = UR10E.read_text().replace("../../../shared/data", str(DATA))
    bench.config(
        text.replace(
            "[[recordings]]", '[mechanism.elements.gearbox]\nload_loss = "two"\n\n[[recordings]]'
        )
    )
    found = bench.told("identify", "c.toml")
    (one,) = null(found)
    assert set(one["exponents"]) == {
        "gearbox.alpha_drive",
        "gearbox.alpha_back",
        "load.first_moment",
    }
    np.testing.assert_allclose(list(one["exponents"].values()), 1.0, atol=1e-6)
    assert {r["kind"] for r in one["remedies"]} >= {"known value", "known mass"}
    for name in ("gearbox.load_drive", "gearbox.load_back", "load.first_moment"):
        assert found["parameters"][name]["data_sd"] is None
    assert found["parameters"]["motor.viscous"]["status"] == "identified"


def test_xl330_confounds_back_emf(bench, real_data):
    if not (real_data / "xl330-pendulum").is_dir():
        pytest.skip("the XL330 recordings are not here")
    found = bench.told("identify", XL330)
    assert null(found) == []
    assert found["voltage"]["same_as_back_emf"] == ["motor.viscous"]


PENDULUM = JOINT.replace("motor-axis", "servo-pendulum") + recorded("swing")
PENDULUM += simulation(duration=6.0, amplitude=0.35, encoder_counts=2**20)


@pytest.mark.parametrize("advise", [(), ("--advise", "motor.viscous")])
def test_a_pendulum_without_its_gravity_is_doubted_before_its_parameters(bench, advise):
    """What a wrong mechanism leaves open is nothing to plan an experiment by."""
    simulated(bench.folder / "c.toml", PENDULUM, name="swing")
    short = "[advice]\nduration = 1.0\nmasses = []\n"
    for preset, doubted in (("servo-pendulum", False), ("motor-axis", True)):
        text = PENDULUM.replace("servo-pendulum", preset).partition("[simulation]")[0] + short
        (bench.folder / "c.toml").write_text(text)
        more = (*advise, "-o", f"{preset}.csv", "--force") if advise else ()
        ended = bench.run("identify", "c.toml", *more)
        assert ended.code == 0, ended.err
        assert ended.out.startswith("WARNING") == doubted
        told = bench.told("identify", "c.toml", *more)
        assert [one["kind"] for one in told["doubts"]] == ["unexplained"] * doubted
