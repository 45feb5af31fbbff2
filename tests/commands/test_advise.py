"""``bayesfric identify --advise`` as a user sees it."""

import numpy as np
import pytest

from bayesfric.recordings.read import read_recordings
from bayesfric.recordings.source import Processing, Recording, Source

from .bench import cases, has
from .test_identify import AXIS

SHORT = "\n[advice]\nduration = 1.0\n"


@pytest.fixture
def axis(bench):
    bench.simulated(AXIS + SHORT)
    return bench


def advised(bench, name, *more):
    return bench.told("identify", "c.toml", "--advise", name, *more)


def test_the_winning_excitation_is_a_file_that_can_be_played(axis):
    found = advised(axis, "motor.viscous", "-o", "play.csv")
    path = axis.folder / "play.csv"
    assert found["written"] == path.name
    lines = path.read_text().splitlines()
    assert lines[:2] == ["time,torque", "s,N m"]
    time, torque = np.loadtxt(path, delimiter=",", skiprows=2, unpack=True)
    best = found["candidates"][0]
    np.testing.assert_allclose(np.diff(time), 0.002, rtol=1e-6)
    assert time.size * 0.002 == pytest.approx(best["duration"])
    assert np.abs(torque).max() <= best["peak_torque"] * (1 + 1e-5)
    assert np.abs(torque).max() <= found["limits"]["torque"] * (1 + 1e-5)
    assert not list(axis.folder.glob(".*partial"))

    # the package reads it as it reads any recording: names in line 1, units in line 2
    source = Source(
        file=path.name,
        rate=500.0,
        position={"column": "time", "unit": "rad"},  # any column that moves
        torque={"column": "torque", "unit": "N m"},
    )
    (read,) = read_recordings(
        Recording(source, axis.folder),
        ratio=1.0,
        motion="rotary",
        motor_motion="rotary",
        processing=Processing(),
    )
    np.testing.assert_array_equal(read.torque, torque)


def test_a_file_that_is_there_is_not_lost(axis):
    path = axis.folder / "kept.csv"
    path.write_text("mine\n")
    asked = ["identify", "c.toml", "--advise", "motor.inertia", "-o", path]
    has(axis.refused(*asked), "kept.csv", "exists already", "--force")
    assert path.read_text() == "mine\n"
    axis.run(*asked, "--force")
    assert path.read_text().startswith("time,torque\n")


@pytest.mark.parametrize(
    ("arguments", "parts"),
    cases(
        ("misspelt", ["--advise", "motor.inertai"], ["--advise", "did you mean 'motor.inertia'"]),
        ("nothing like it", ["--advise", "x"], ["--advise x", "use one of"]),
        ("no CSV", ["--advise", "motor.inertia", "-o", "a.txt"], ["a.txt", "not named .csv"]),
        ("output alone", ["-o", "a.csv"], ["--output", "add --advise"]),
        ("force alone", ["--force"], ["--force", "add --advise"]),
    ),
)
def test_bad_arguments(axis, arguments, parts):
    has(axis.refused("identify", "c.toml", *arguments), *parts)


@pytest.mark.parametrize(
    ("text", "parts"),
    cases(
        ("unknown key", "torque = 3", ["advice.torque", "torque_limit"]),
        ("turned angles", "angle_limits = [1, -1]", ["advice.angle_limits", "smaller one first"]),
        ("not a mass", 'masses = [{ mass = "2 m", radius = 1 }]', ["advice.masses.1.mass"]),
        ("no mass", "masses = [{ mass = 0, radius = 1 }]", ["advice.masses.1.mass"]),
    ),
)
def test_bad_limits(bench, text, parts):
    bench.config(AXIS + f"\n[advice]\n{text}\n")
    has(bench.refused("identify", "c.toml", "--advise", "motor.inertia"), *parts)


def test_masses_with_units_are_those_on_hand(axis):
    axis.config(AXIS + SHORT + 'masses = [{ mass = "500 g", radius = "20 cm" }]\n')
    found = advised(axis, "motor.inertia")
    assert found["limits"]["masses"] == [[0.5, pytest.approx(0.2)]]
