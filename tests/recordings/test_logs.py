"""Logs that people have: the same numbers come out of each, to the last bit."""

import hashlib

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.recordings.readers import TableOptions, read_table, sha256
from bayesfric.recordings.source import Recording, Source
from tests.recordings import logs
from tests.recordings.samples import has, measured

pytestmark = pytest.mark.usefixtures("nothing_explained")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    return folder, logs.all_logs(folder)


def knee(folder, file, keys):
    return measured(Recording(Source.model_validate({"file": file, **keys}), folder))


FORMATS = (
    "CSV", "ROS 2, sqlite3", "ROS 2, MCAP", "MCAP", "ROS 1", "LeRobot", "HDF5", "JSON lines",
    "MATLAB 7.3",
)  # fmt: skip


@pytest.mark.parametrize("form", FORMATS)
def test_the_same_numbers_to_the_last_bit(written, form):
    folder, sources = written
    recording = knee(folder, *sources[form])
    t, q, v, tau = logs.numbers()
    np.testing.assert_array_equal(recording.time, t)
    np.testing.assert_array_equal(recording.position, q[:, 1])
    np.testing.assert_array_equal(recording.velocity, v[:, 1])
    np.testing.assert_array_equal(recording.torque, tau[:, 1])
    assert (recording.segments, recording.period) == (((0, t.size),), logs.PERIOD)


@pytest.mark.parametrize("period", [0.001, 0.0333, 1e-4])
def test_stamps_of_nanoseconds_are_the_decimal_numbers(tmp_path, period):
    """Since the first message, from whole nanoseconds divided once: 0.001 s is 0.001 s."""
    t = np.round(np.arange(300) * period, 9)
    _, q, v, tau = logs.numbers(300)
    logs.write_ros2(tmp_path / "bag", logs.joint_states(t, q, v, tau))
    table = read_table(tmp_path / "bag", TableOptions())
    for column in ("header.stamp", "received"):
        assert table.column(column).tolist() == [float(f"{x:.9f}") for x in t.tolist()]


def test_the_hash_of_a_bag_is_of_its_files(written):
    folder, _ = written
    files = sorted((folder / "db3").iterdir())
    lines = (f"{f.name}\0{hashlib.sha256(f.read_bytes()).hexdigest()}\n" for f in files)
    assert sha256(folder / "db3") == hashlib.sha256("".join(lines).encode()).hexdigest()


def test_fields_by_path(tmp_path):
    types = logs.ROS2.types
    vector = types["geometry_msgs/msg/Vector3"]
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 5), "")
    dimension = types["std_msgs/msg/MultiArrayLayout"]([], 0)
    wrench, stamped = (types[f"geometry_msgs/msg/Wrench{end}"] for end in ("", "Stamped"))
    array = types["std_msgs/msg/Float64MultiArray"]
    wrenches, arrays = [], []
    for k in range(5):
        stamp, pull = logs.BEGIN + k * 10**6, vector(3.0, 4.0, k + 0.5)
        wrenches.append((stamp, stamped(header, wrench(vector(0.0, 1.0, 2.0), pull))))
        arrays.append((stamp, array(dimension, np.arange(3) + 0.25 * k)))
    logs.write_ros2(tmp_path / "bag", wrenches, topic="/ft", more=[("/data", arrays)])
    torque = read_table(tmp_path / "bag", TableOptions(table="/ft")).column("wrench.torque.z")
    assert torque.tolist() == [0.5, 1.5, 2.5, 3.5, 4.5]
    data = read_table(tmp_path / "bag", TableOptions(table="/data")).column("data[2]")
    assert data.tolist() == [2.0, 2.25, 2.5, 2.75, 3.0]
    with pytest.raises(bf.BadInput) as caught:
        read_table(tmp_path / "bag", TableOptions())
    has(str(caught.value), "'/ft'", "'/data'", "table")
