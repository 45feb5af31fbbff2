"""The reference's recipes, to the letter, on logs as the tools write them."""

import asyncio
import csv
import re
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.recordings.readers import _READERS
from bayesfric.recordings.source import Recording, Source
from tests.conftest import REPOSITORY
from tests.recordings.samples import measured
from tests.recordings.test_measurement_files import WRITERS

TURN = 2 * np.pi
PAGE = (REPOSITORY / "studies/reference/logs.md").read_text(encoding="utf-8")


def recipes():
    """Recordings of the reference's page on logs, by their files."""
    tables = [tomllib.loads(text) for text in re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)]
    return {table["recordings"][0]["file"]: table["recordings"][0] for table in tables}


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
    """As numpy.savetxt of the capture, transposed: ns from the trigger, then what was asked for."""
    columns = (1e9 * (s.time - 0.02), s.position / TURN, s.velocity / TURN, s.torque / 0.055)
    np.savetxt(path, np.stack(columns, axis=1), delimiter=",")


LOGS = {"robot_data.csv": ur, "output.csv": moteus, "odrive.csv": odrive}


def test_every_recipe_is_tried():
    assert set(recipes()) == set(LOGS)


def test_every_format_has_a_row_with_a_command():
    rows = [row.split("|") for row in PAGE.splitlines() if row.startswith("| ")]
    files = [row[2].strip(" `").split()[0] for row in rows if len(row) == 8]
    read = {file.rpartition(".")[2] for file in files}
    assert set(WRITERS) - {"serial.log"} <= set(files)
    assert {
        kind for kind, (_, suffixes, _) in _READERS.items() if not read & {x[1:] for x in suffixes}
    } <= {"ros", "npy"}


def test_odrive_gives_series_by_samples():
    capturer = pytest.importorskip("odrive.high_rate_capturer", reason="the recipe's capture")

    class Drive:
        async def read(self, _):
            return False

    class Capture(capturer.HighRateCapturer):
        def __init__(self):
            self.odrv, self.type_info = Drive(), [(name, 0, 4, None) for name in "qv"]

        async def _download_raw_buffer(self):
            return b"", 3

        def _decode(self, *_):
            return [(float(k), 2.0 * k) for k in range(10)], 3

    stamps = capturer.TimestampFmt.NANOSECONDS
    data = asyncio.run(Capture().download(np.ndarray, stamps))
    assert data.shape == (3, 10)
    assert data[0].tolist() == [125_000.0 * (k - 3) for k in range(10)]


def test_registers_of_moteus():
    moteus = pytest.importorskip("moteus", reason="the recipe's registers")
    assert {"POSITION", "VELOCITY", "TORQUE"} <= set(moteus.Register.__members__)


@pytest.mark.parametrize("file", LOGS)
def test_a_recipe_gives_back_what_was_simulated(tmp_path, simulated, file):
    LOGS[file](tmp_path / file, simulated)
    source = Source.model_validate(recipes()[file])
    recording = measured(Recording(source, tmp_path))
    # stamps of a controller that is up for a while lose digits
    np.testing.assert_allclose(recording.time, simulated.time, atol=1e-9)
    for name in ("position", "velocity", "torque"):
        read, expected = getattr(recording, name), getattr(simulated, name)
        np.testing.assert_allclose(read, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
