"""``bayesfric simulate``, the packaged recordings, and what all commands have in common."""

import json
from importlib.resources import files

import numpy as np
import pytest
import typer

from bayesfric.commands import cli
from bayesfric.commands.simulate import simulate
from bayesfric.fit.conclusion import may_be_simulated
from bayesfric.problem.config import parse_config, read_config

from .bench import CONFIG

EXAMPLES = files("bayesfric") / "examples"
# Table 3 of the 2005 IFAC paper; mu_1 = 1/alpha_1 - 1 and mu_2 = 1 - 1/alpha_2, eq. (6)
TABLE_3 = {
    "motor.inertia": (3.56e-4, "kg m²"),
    "motor.viscous": (4.0e-3, "N m s"),
    "motor.coulomb_positive": (0.087, "N m"),
    "motor.coulomb_negative": (0.091, "N m"),
    "gearbox.load_drive": (1 / 0.7432 - 1, ""),
    "gearbox.load_back": (1 - 1 / 1.408, ""),
    "joint.viscous": (3.12, "N m s"),
    "joint.coulomb_positive": (5.03, "N m"),
    "joint.coulomb_negative": (5.15, "N m"),
    "load.inertia": (0.206, "kg m²"),
    "load.first_moment": (0.42, "kg m"),
}
SIMULATION = CONFIG + "\n[simulation]\nduration = 1.0\nrate = 500\nseed = 4\n"


@pytest.mark.slow
def test_a_recording_follows_from_its_seed_with_its_truth(bench):
    bench.config(SIMULATION)
    truth = bench.record("simulate", "c.toml", "-o", "a.csv")
    bench.record("simulate", "c.toml", "-o", "b.csv")
    bench.record("simulate", "c.toml", "-o", "other.csv", "--seed", "5")
    a, b, other = ((bench.folder / f"{name}.csv").read_bytes() for name in ("a", "b", "other"))
    assert a == b != other
    assert json.loads((bench.folder / "a.truth.json").read_text()) == truth
    assert truth["simulated"] is True
    assert truth["simulation"]["seed"] == 4
    assert truth["parameters"] == {
        "motor.inertia": {"value": 0.01, "unit": "kg m²"},
        "motor.viscous": {"value": 0.05, "unit": "N m s"},
        "motor.coulomb": {"value": 0.2, "unit": "N m"},
        "offset": {"value": 0.02, "unit": "N m"},
    }
    header, *rows = a.decode().splitlines()
    assert header == "time,position,torque"
    time = np.loadtxt(rows, delimiter=",")[:, 0]
    np.testing.assert_allclose(time, np.arange(500) / 500, atol=1e-9)


@pytest.mark.parametrize(("stem", "mass", "radius"), [("knee", 0, 0), ("knee-loaded", 2, 0.35)])
def test_packaged_recordings_are_simulated_from_table_3(stem, mass, radius, tmp_path):
    simulate(read_config(EXAMPLES / f"{stem}.toml"), tmp_path / "again.csv")
    again = np.loadtxt(tmp_path / "again.csv", delimiter=",", skiprows=1)
    packaged = np.loadtxt(str(EXAMPLES / f"{stem}.csv"), delimiter=",", skiprows=1)
    assert packaged.shape == (10_000, 3)
    # the last printed digit may round the other way
    np.testing.assert_allclose(packaged, again, rtol=1e-9, atol=1e-12)
    truth = json.loads((EXAMPLES / f"{stem}.truth.json").read_text(encoding="utf-8"))
    assert truth["simulated"] is True
    assert set(truth["parameters"]) == set(TABLE_3)
    for name, (value, unit) in TABLE_3.items():
        row = truth["parameters"][name]
        assert row == {"value": pytest.approx(value, rel=1e-12), "unit": unit}, name
    simulation = truth["simulation"]
    assert (simulation["added_mass"], simulation["radius"]) == (mass, radius)
    assert (simulation["duration"], simulation["rate"]) == (10, 1000)


def test_a_configuration_with_a_simulation_may_be_simulated(tmp_path):
    for text, expected in ((CONFIG, False), (SIMULATION, True)):
        config = parse_config(text, tmp_path / "c.toml")
        assert may_be_simulated(config, ()) == expected


@pytest.mark.parametrize("command", sorted(typer.main.get_command(cli.app).commands))
def test_every_command_has_json(bench, command):
    ended = bench.run(command, "--help")
    assert ended.code == 0
    assert "--json" in ended.out
