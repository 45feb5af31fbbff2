"""``bayesfric identify``, and ``--advise`` for what to record next."""

from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from bayesfric.recordings.read import read_recordings
from bayesfric.recordings.source import Processing, Recording, Source

from ..conftest import REPOSITORY
from .bench import JOINT, SMALL, has, recorded, simulated, simulation

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


def null_directions(record):
    return [row for row in record["directions"] if row["kind"] == "null"]


def test_the_packaged_knee_alone_leaves_the_scale_open(bench):
    record = bench.record("identify", FOLDER / "knee.toml")
    (null,) = null_directions(record)
    # no scaling moves what the estimate has at zero, where sds mean little
    on_bound = {name for name, row in record["parameters"].items() if row["on_bound"]}
    assert len(on_bound) <= 1
    assert set(null["exponents"]) == SCALED - on_bound
    np.testing.assert_allclose(list(null["exponents"].values()), 1.0, atol=1e-6)
    assert null["log_sd"] is None
    # nothing that is not determined has a finite sd
    for name in set(record["parameters"]) - on_bound:
        row = record["parameters"][name]
        behind = name.replace("load_drive", "alpha_drive").replace("load_back", "alpha_back")
        assert (row["data_sd"] is None) == (behind in SCALED)
        assert row["expected_sd"] > 0


def test_the_known_mass_determines_everything(bench):
    """0.8 N m alone and 1.12 N m with 2 kg at 0.35 m, 10 s each, torque noise 0.02 N m."""
    record = bench.record("identify", FOLDER / "knee-loaded.toml")
    assert null_directions(record) == []

    def relative(row):
        return row["expected_sd"] / abs(row["value"])

    assert relative(record["combinations"]["gearbox.alpha_drive"]) < 0.01
    assert relative(record["combinations"]["gearbox.alpha_back"]) < 0.025
    assert relative(record["parameters"]["load.first_moment"]) < 0.025
    assert {row["status"] for row in record["parameters"].values()} == {"identified"}


def test_the_likelihood_of_the_position(bench):
    bench.simulated(AXIS + '\n[likelihood]\nmethod = "output-error"\n')
    record = bench.record("identify", "c.toml")
    assert record["method"] == "output-error"
    assert null_directions(record) == []
    truth = {"motor.inertia": 0.01, "motor.viscous": 0.05, "motor.coulomb": 0.2}
    for name, value in truth.items():
        row = record["parameters"][name]
        assert abs(row["value"] - value) < 5 * row["data_sd"]


def test_ur10e_with_two_load_losses_and_a_free_gravity_moment(bench, real_data):
    text = UR10E.read_text().replace("../../../shared/data", str(real_data))
    two = '[mechanism.elements.gearbox]\nload_loss = "two"\n\n[[recordings]]'
    bench.config(text.replace("[[recordings]]", two))
    record = bench.record("identify", "c.toml")
    (null,) = null_directions(record)
    assert set(null["exponents"]) == {
        "gearbox.alpha_drive",
        "gearbox.alpha_back",
        "load.first_moment",
    }
    np.testing.assert_allclose(list(null["exponents"].values()), 1.0, atol=1e-6)
    assert {r["kind"] for r in null["remedies"]} >= {"known value", "known mass"}
    for name in ("gearbox.load_drive", "gearbox.load_back", "load.first_moment"):
        assert record["parameters"][name]["data_sd"] is None
    assert record["parameters"]["motor.viscous"]["status"] == "identified"


@pytest.mark.usefixtures("real_data")
def test_xl330_confounds_back_emf(bench):
    record = bench.record("identify", XL330)
    assert null_directions(record) == []
    assert record["voltage"]["same_as_back_emf"] == ["motor.viscous"]


PENDULUM = JOINT.replace("motor-axis", "servo-pendulum") + recorded("swing")
PENDULUM += simulation(duration=6.0, amplitude=0.35, encoder_counts=2**20)


@pytest.mark.parametrize("advise", [(), ("--advise", "motor.viscous")])
def test_a_pendulum_without_its_gravity_is_doubted_before_its_parameters(bench, advise):
    """An experiment is not planned by what a wrong mechanism leaves open."""
    simulated(bench.folder / "c.toml", PENDULUM, name="swing")
    short = "[advice]\nduration = 1.0\nmasses = []\n"
    for preset, doubted in (("servo-pendulum", False), ("motor-axis", True)):
        text = PENDULUM.replace("servo-pendulum", preset).partition("[simulation]")[0] + short
        (bench.folder / "c.toml").write_text(text)
        more = (*advise, "-o", f"{preset}.csv", "--force") if advise else ()
        ended = bench.run("identify", "c.toml", *more)
        assert ended.code == 0, ended.err
        assert ended.out.startswith("WARNING") == doubted
        doubts = bench.record("identify", "c.toml", *more)["doubts"]
        assert [doubt["kind"] for doubt in doubts] == ["unexplained"] * doubted


# -- what to record next


SHORT = "\n[advice]\nduration = 1.0\n"


@pytest.fixture
def axis(bench):
    bench.simulated(AXIS + SHORT)
    return bench


def test_the_best_excitation_is_a_file_that_can_be_played(axis):
    path = axis.folder / "play.csv"
    path.write_text("not to be lost\n")
    arguments = ("identify", "c.toml", "--advise", "motor.viscous", "-o", "play.csv")
    has(axis.refused(*arguments), "play.csv", "--force")
    record = axis.record(*arguments, "--force")
    assert record["written"] == "play.csv"
    assert path.read_text().splitlines()[:2] == ["time,torque", "s,N m"]
    time, torque = np.loadtxt(path, delimiter=",", skiprows=2, unpack=True)
    best = record["candidates"][0]
    np.testing.assert_allclose(np.diff(time), 0.002, rtol=1e-6)
    assert time.size * 0.002 == pytest.approx(best["duration"])
    max_count = min(best["peak_torque"], record["limits"]["torque"])
    assert np.abs(torque).max() <= max_count * (1 + 1e-5)
    # the package reads it as any recording: names in line 1, units in line 2
    source = Source(
        file=path.name,
        rate=500.0,
        position={"column": "time", "unit": "rad"},  # any column that moves
        torque={"column": "torque", "unit": "N m"},
    )
    kinds = {"ratio": 1.0, "motion": "rotary", "motor_motion": "rotary"}
    (read,) = read_recordings(Recording(source, axis.folder), **kinds, processing=Processing())
    np.testing.assert_array_equal(read.torque, torque)


@pytest.mark.parametrize(
    ("advice", "arguments", "part"),
    [
        ("", ["--advise", "motor.inertai"], "'motor.inertia'"),
        ("", ["--advise", "motor.inertia", "-o", "a.txt"], "a.txt"),
        ("", ["-o", "a.csv"], "--output"),
        ("", ["--force"], "--force"),
        ("torque = 3", [], "advice.torque"),
        ("angle_limits = [1, -1]", [], "advice.angle_limits"),
        ('masses = [{ mass = "2 m", radius = 1 }]', [], "advice.masses.1.mass"),
    ],
)
def test_bad_advice(bench, advice, arguments, part):
    bench.simulated(AXIS)
    bench.config(f"{AXIS}\n[advice]\n{advice}\n")
    has(bench.refused("identify", "c.toml", *arguments), part)


def test_masses_with_units(axis):
    axis.config(AXIS + SHORT + 'masses = [{ mass = "500 g", radius = "20 cm" }]\n')
    limits = axis.record("identify", "c.toml", "--advise", "motor.inertia")["limits"]
    assert limits["masses"] == [[0.5, pytest.approx(0.2)]]
