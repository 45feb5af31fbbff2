"""The reference's recipes, to the letter, on logs as the tools write them."""

import csv
import re
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.recordings.source import Recording, Source
from tests.conftest import REPOSITORY
from tests.recordings.samples import measured

TURN = 2 * np.pi


def recipes():
    """Recordings of the reference's section on logs, by their files."""
    text = (REPOSITORY / "studies/reference/recordings.md").read_text(encoding="utf-8")
    section = text.partition("## Log formats\n")[2].partition("\n## ")[0]
    found = [tomllib.loads(one) for one in re.findall(r"```toml\n(.*?)```", section, re.DOTALL)]
    return {one["recordings"][0]["file"]: one["recordings"][0] for one in found}


@pytest.fixture(scope="module")
def simulated():
    joint = bf.Joint.preset("motor-axis")
    frame = bf.simulate(joint, duration=4, seed=1)
    q = frame["position"].to_numpy()
    t = frame["time"].to_numpy()
    torque = frame["torque"].to_numpy()
    return SimpleNamespace(time=t, position=q, velocity=np.gradient(q, t), torque=torque)


def ur(path, s):
    """As rtde's CSVWriter: blanks between, vectors of six as name_0 to name_5."""
    names = ["actual_q", "actual_qd", "actual_current"]
    header = ["timestamp", *(f"{name}_{k}" for name in names for k in range(6))]
    signals = (s.position, s.velocity, s.torque / 0.1)
    with path.open("w", newline="") as file:
        writer = csv.writer(file, delimiter=" ")
        writer.writerow(header)
        for row in zip(s.time, *signals, strict=True):
            rest = (x for value in row[1:] for x in (0.0, value, 0.5, -0.5, 0.0, 0.0))
            writer.writerow([float(row[0]) + 1000.0, *map(float, rest)])


def moteus(path, s):
    """As CsvController of its examples: registers by name, in the order of the query."""
    lines = ["time,MODE,POSITION,VELOCITY,TORQUE,VOLTAGE,TEMPERATURE,FAULT"]
    turned = zip(s.time, s.position / TURN, s.velocity / TURN, s.torque, strict=True)
    lines += [
        ",".join(map(str, [float(t), 10, float(q), float(v), float(tau), 24.5, 31.0, 0]))
        for t, q, v, tau in turned
    ]
    path.write_text("\n".join(lines) + "\n")


def odrive(path, s):
    """As numpy.savetxt of BulkCapture.data: time, then what was asked for."""
    columns = (s.time, s.position / TURN, s.velocity / TURN, s.torque / 0.055)
    np.savetxt(path, np.stack(columns, axis=1), delimiter=",")


LOGS = {"robot_data.csv": ur, "output.csv": moteus, "odrive.csv": odrive}


def test_every_recipe_is_tried():
    assert set(recipes()) == set(LOGS)


@pytest.mark.parametrize("file", LOGS)
def test_a_recipe_gives_back_what_was_simulated(tmp_path, simulated, file):
    LOGS[file](tmp_path / file, simulated)
    source = Source.model_validate(recipes()[file])
    found = measured(Recording(source, tmp_path))
    # stamps of a controller that is up for a while lose digits
    np.testing.assert_allclose(found.time, simulated.time, atol=1e-9)
    for name in ("position", "velocity", "torque"):
        one, two = getattr(found, name), getattr(simulated, name)
        np.testing.assert_allclose(one, two, rtol=1e-9, atol=1e-9 * np.abs(two).max())
