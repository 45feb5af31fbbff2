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


def test_the_same_numbers_to_the_last_bit(tmp_path):
    t, q, v, tau = logs.numbers()
    signals = {"time": t, "position": q[:, 1], "velocity": v[:, 1], "torque": tau[:, 1]}
    for file, keys in logs.all_logs(tmp_path):
        source = Source.model_validate({"file": file, **keys})
        recording = measured(Recording(source, tmp_path))
        for name, values in signals.items():
            np.testing.assert_array_equal(getattr(recording, name), values, err_msg=file)
        assert (recording.segments, recording.period) == (((0, t.size),), logs.PERIOD)
    # of a folder the SHA-256 is that of its files' names and hashes
    hashes = (f"{f.name}\0{sha256(f)}\n" for f in sorted((tmp_path / "db3").iterdir()))
    assert sha256(tmp_path / "db3") == hashlib.sha256("".join(hashes).encode()).hexdigest()


@pytest.mark.parametrize("period", [0.001, 0.0333, 1e-4])
def test_stamps_of_nanoseconds_are_the_decimal_numbers(tmp_path, period):
    """Since the first message, from whole nanoseconds divided once: 0.001 s is 0.001 s."""
    t = np.round(np.arange(300) * period, 9)
    _, q, v, tau = logs.numbers(300)
    logs.write_ros2(tmp_path / "bag", logs.joint_states(t, q, v, tau))
    table = read_table(tmp_path / "bag", TableOptions())
    for column in ("header.stamp", "received"):
        assert table.column(column).tolist() == [float(f"{x:.9f}") for x in t.tolist()]


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
