"""The same numbers as the logs that people have: ROS bags, LeRobot, HDF5, JSON lines, CSV."""

import json

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

JOINTS = ("hip", "knee")
# s; exact in binary and in nanoseconds, so that no format rounds it
PERIOD = 1.0 / 128.0
ROS2, ROS1 = get_typestore(Stores.LATEST), get_typestore(Stores.ROS1_NOETIC)
# the first message's stamp, as of a clock of today
BEGIN = 1_763_800_000_123_456_789


def numbers(n=256):
    """Time, and position, velocity and torque (n, 2) of two joints; each exact in 32 bits."""
    t = PERIOD * np.arange(n)
    phase = 2 * np.pi * 0.7 * t[:, None] + np.array([1.0, 0.0])
    signals = (np.sin(phase), 4.4 * np.cos(phase), 0.3 * np.cos(phase) + 0.01 * t[:, None])
    return t, *(signal.astype(np.float32).astype(np.float64) for signal in signals)


def joint_states(t, q, v, tau, store=ROS2, joints=JOINTS, shuffled=False):
    """Yield messages with their stamps in ns; ``shuffled`` turns every second one's joints."""
    types = store.types
    for k, second in enumerate(t):
        stamp = BEGIN + round(float(second) * 1e9)
        order = list(range(len(joints)))[:: -1 if shuffled and k % 2 else 1]
        header = {"stamp": types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)}
        header["frame_id"] = ""
        if store is ROS1:
            header["seq"] = k
        yield (
            stamp,
            types["sensor_msgs/msg/JointState"](
                types["std_msgs/msg/Header"](**header),
                [joints[i] for i in order],
                *(signal[k, order] for signal in (q, v, tau)),
            ),
        )


def write_ros2(
    folder, messages, plugin=StoragePlugin.MCAP, topic="/joint_states", more=(), packed=False
):
    """Write a ROS 2 bag; ``more`` are further topics' messages."""
    writer = Writer2(folder, version=9, storage_plugin=plugin)
    if packed:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        for name, each in ((topic, messages), *more):
            connection = None
            for stamp, message in each:
                kind = message.__msgtype__
                connection = connection or writer.add_connection(name, kind, typestore=ROS2)
                writer.write(connection, stamp + 5_000_000, ROS2.serialize_cdr(message, kind))
    return folder


def write_ros1(path, messages, topic="/joint_states"):
    with Writer1(path) as writer:
        connection = None
        for stamp, message in messages:
            kind = message.__msgtype__
            connection = connection or writer.add_connection(topic, kind, typestore=ROS1)
            writer.write(connection, stamp, bytes(ROS1.serialize_ros1(message, kind)))
    return path


def write_lerobot(path, t, q, v, tau, episode=3):
    """Write a file as LeRobot v3: several episodes in one, lists of 32-bit floats."""
    state = np.concatenate([q, v, tau], axis=1).astype(np.float32)
    states = np.concatenate([state if k == episode else -state for k in range(episode + 2)])
    columns = {
        "observation.state": pa.FixedSizeListArray.from_arrays(states.ravel(), state.shape[1]),
        "timestamp": np.tile(t.astype(np.float32), episode + 2),
        "frame_index": np.tile(np.arange(len(t)), episode + 2),
        "episode_index": np.repeat(np.arange(episode + 2), len(t)),
    }
    pq.write_table(pa.table(columns), path)


def write_hdf5(path, t, q, v, tau):
    with h5py.File(path, "w") as file:
        file["t"] = t
        # one by columns, one by rows, as robots write both
        file["observations/qpos"], file["observations/qvel"] = q, v.T
        file["observations/effort"] = tau
    return path


def write_json_lines(path, t, q, v, tau):
    rows = (
        {"t": float(a), "q": b.tolist(), "v": c.tolist(), "tau": d.tolist()}
        for a, b, c, d in zip(t, q, v, tau, strict=True)
    )
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    return path


def write_matlab_73(path, t, q, v, tau):
    """Write what MATLAB writes: a header of its own, arrays transposed, a struct as a group."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in {"t": t[None, :], "q": q.T, "v": v, "tau": tau.T}.items():
            file[f"log/{name}"] = np.asarray(values).T
            file[f"log/{name}"].attrs["MATLAB_class"] = np.bytes_("double")
        file["log/note"] = np.array([[104], [105]], dtype=np.uint16)
        file["log/note"].attrs["MATLAB_class"] = np.bytes_("char")
        file["#refs#/a"] = np.zeros(3)
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Sun Nov 22".ljust(124)
    with path.open("r+b") as opened:
        opened.write(header + b"\x00\x02IM")
    return path


def channels(time, position, velocity, torque, **keys):
    """Write the channels of a source as a configuration does."""
    columns = {"time": time, "position": position, "velocity": velocity, "torque": torque}
    return {key: {"column": column, "unit": "SI"} for key, column in columns.items()} | keys


def all_logs(folder):
    """Write every log; returns files and keys of the sources that read its knee."""
    signals = numbers()
    write_ros2(folder / "db3", joint_states(*signals), StoragePlugin.SQLITE3)
    write_ros2(folder / "mcap", joint_states(*signals, shuffled=True))
    (folder / "one.mcap").write_bytes(next((folder / "mcap").glob("*.mcap")).read_bytes())
    write_ros1(folder / "one.bag", joint_states(*signals, store=ROS1))
    write_lerobot(folder / "lerobot.parquet", *signals)
    write_hdf5(folder / "run.h5", *signals)
    write_json_lines(folder / "run.jsonl", *signals)
    write_matlab_73(folder / "run.mat", *signals)
    ros = channels("header.stamp", "position[knee]", "velocity[knee]", "effort[knee]")
    state = (f"observation.state[{k}]" for k in (1, 3, 5))
    hdf5 = (f"observations/{name}[1]" for name in ("qpos", "qvel", "effort"))
    lists = channels("t", "q[1]", "v[1]", "tau[1]")
    return [
        *((file, ros) for file in ("db3", "mcap", "one.mcap", "one.bag")),
        ("lerobot.parquet", channels("timestamp", *state, where={"episode_index": 3})),
        ("run.h5", channels("t", *hdf5)),
        ("run.jsonl", lists),
        ("run.mat", lists | {"table": "log"}),
    ]
