"""Read ROS 1 bags, ROS 2 bags and MCAP files, by the optional package rosbags."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesfric.base.errors import BadInput
from bayesfric.recordings.tables.reader import Reader, TableOptions
from bayesfric.recordings.tables.table import Table

# Most parts of a list of messages that become columns.
_MAX_PARTS = 200
_MAX_DEPTH = 20
_TIME, _DURATION = "builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"
# Fields that list the joints of a message.
_JOINTS = ("name", "joint_names")
# Units by message definition, by the beginning of a column's name.
_UNITS = {
    "sensor_msgs/msg/JointState": {"position": "rad", "velocity": "rad/s", "effort": "N m"},
    "geometry_msgs/msg/WrenchStamped": {"wrench.force": "N", "wrench.torque": "N m"},
}
# Message types without measurements.
_NOT_MEASURED = {
    "rcl_interfaces/msg/Log",
    "rcl_interfaces/msg/ParameterEvent",
    "rosbag2_interfaces/msg/WriteSplitEvent",
    "rosgraph_msgs/msg/Log",
    "rosgraph_msgs/msg/Clock",
    "std_msgs/msg/String",
    "diagnostic_msgs/msg/DiagnosticArray",
    "tf2_msgs/msg/TFMessage",
}
# Attributes, and indices or names of joints in lists.
_Path = tuple[str | int, ...]


@dataclasses.dataclass(frozen=True)
class _Column:
    name: str
    path: _Path
    is_time: bool = False
    joint: str | None = None  # whose signal it is, where the message lists joints


def read_bag(path: Path, options: TableOptions) -> Table:
    """Read one topic, a row a message; ``options.table`` is the topic, if there are several.

    Columns are fields by path, as ``wrench.torque.z`` and ``data[3]``, and joints' signals by name,
    as ``effort[knee]``. ``received`` and stamps are in s since the first message.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise BadInput(
            str(path), "is a ROS bag, read by rosbags", "pip install 'bayesfric[ros]'"
        ) from error
    # bags of sqlite3 before ROS 2 Iron hold no definitions
    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
        topic, kind, connections = _topic(path, reader, options.table)
        stamps, messages = list[int](), list[Any]()
        for connection, stamp, raw in reader.messages(connections=connections):
            stamps.append(int(stamp))
            messages.append(reader.deserialize(raw, connection.msgtype))
    columns = list(_columns(messages[0]))

    def load(index: int) -> NDArray[Any]:
        if index == 0:
            return _since_first(stamps)
        return _cells([_value(message, columns[index - 1]) for message in messages])

    return Table(
        f"{path}, table '{topic}'",
        ["received", *(column.name for column in columns)],
        load,
        names_at=kind,
        notes=(f"topic {topic} ({kind}), {len(messages)} messages",),
        units=["s", *(_unit(kind, column) for column in columns)],
        by_rows=True,
    )


def _topic(path: Path, reader: Any, wanted: str | None) -> tuple[str, str, Sequence[Any]]:
    """Choose a topic: its name, its type and its connections."""
    topics = {name: topic for name, topic in reader.topics.items() if topic.msgcount}
    useful = [name for name, topic in topics.items() if topic.msgtype not in _NOT_MEASURED]
    if wanted is None and len(useful) == 1:
        wanted = useful[0]
    if wanted is None or wanted not in topics:
        known = ", ".join(f"'{name}'" for name in (useful or list(topics))[:20])
        raise BadInput(
            str(path) if wanted is None else f"{path}, table '{wanted}'",
            "there is no message on this topic" if wanted else "holds no one topic with numbers",
            f"name one of {known} with table" if known else "check what was recorded",
        )
    topic = topics[wanted]
    kind = topic.msgtype or "several types"
    if kind not in reader.typestore.fielddefs:
        raise BadInput(
            f"{path}, table '{wanted}'",
            f"holds messages of {kind}, of which there is no one definition",
            "record one type a topic, as MCAP, which holds definitions, or convert the bag with "
            "'ros2 bag convert'",
        )
    return wanted, kind, topic.connections


def _columns(message: Any) -> Iterator[_Column]:
    """Name all values of a message, and those of its joints also by joint."""
    listed: list[Any] = next((names for k in _JOINTS if (names := getattr(message, k, None))), [])
    joints = listed if all(isinstance(name, str) for name in listed) else []
    for name, path, value in _leaves(message, "", (), 0):
        yield _Column(name, path, getattr(value, "__msgtype__", None) in (_TIME, _DURATION))
        is_list = isinstance(value, np.ndarray | list)
        if is_list and len(value) == len(joints) and not any(isinstance(v, str) for v in value):
            yield from (_Column(f"{name}[{joint}]", path, joint=joint) for joint in joints)


def _leaves(value: Any, name: str, path: _Path, depth: int) -> Iterator[tuple[str, _Path, Any]]:
    """Walk down to values and times."""
    if depth > _MAX_DEPTH:
        raise ValueError(f"a message is nested deeper than {_MAX_DEPTH}")
    kind = getattr(value, "__msgtype__", None)
    if kind is not None and kind not in (_TIME, _DURATION):
        for field in dataclasses.fields(value):
            inner = f"{name}.{field.name}" if name else field.name
            part = getattr(value, field.name)
            yield from _leaves(part, inner, (*path, field.name), depth + 1)
    elif isinstance(value, list) and value and hasattr(value[0], "__msgtype__"):
        for k, part in enumerate(value[:_MAX_PARTS]):
            yield from _leaves(part, f"{name}[{k}]", (*path, k), depth + 1)
    else:
        yield name, path, value


def _unit(kind: str, column: _Column) -> str:
    units = _UNITS.get(kind, {})
    matches = (unit for begin, unit in units.items() if column.name.startswith(begin))
    return "s" if column.is_time else next(matches, "")


def _value(message: Any, column: _Column) -> Any:
    """Return a column's value in a message; ``None`` where it has none."""
    value = message
    for step in column.path:
        if isinstance(step, str):
            value = getattr(value, step)
        elif step < len(value):
            value = value[step]
        else:
            return None
    if column.joint is None:
        return value
    listed = next(names for key in _JOINTS if (names := getattr(message, key, None)) is not None)
    if column.joint not in listed or len(value) != len(listed):
        return None
    return value[listed.index(column.joint)]


def _cells(values: list[Any]) -> NDArray[Any]:
    kind = getattr(values[0], "__msgtype__", None)
    if kind in (_TIME, _DURATION):
        stamps = [int(v.sec) * 10**9 + int(v.nanosec) for v in values]
        return _since_first(stamps) if kind == _TIME else np.array([n / 10**9 for n in stamps])
    plain = [v.tolist() if isinstance(v, np.ndarray | np.generic) else v for v in values]
    with suppress(ValueError):  # lists of different lengths
        if (value := np.array(plain)).dtype.kind in "biuf":
            return value
    return np.array(plain, dtype=object)


def _since_first(stamps: list[int]) -> NDArray[np.float64]:
    """Convert stamps in ns to seconds since the first, without loss."""
    return np.array([(stamp - stamps[0]) / 10**9 for stamp in stamps])


READERS = (Reader("ros", (".bag", ".mcap", ".db3"), read_bag, mark="metadata.yaml"),)
