"""Broken bags, HDF5, JSON lines and lists: one line that names the place and the mend."""

import json
import sqlite3
import sys
from contextlib import closing

import h5py
import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from bayesfric.base.errors import BadInput
from bayesfric.recordings.readers import TableOptions, read_table
from tests.recordings import file_formats, logs
from tests.recordings.samples import has

from .samples import read, refused, source

SOURCE = {
    "time": {"column": "header.stamp", "unit": "s"},
    "position": {"column": "position[knee]", "unit": "rad"},
    "torque": {"column": "effort[knee]", "unit": "N m"},
}


def used(file, **changes):
    keys = {**SOURCE, **changes}
    return source(file, **{k: v for k, v in keys.items() if v is not None})


def bag(folder, plugin=logs.StoragePlugin.MCAP, change=None, **more):
    """A bag of numbers, of which ``change`` may alter one message after the other."""
    messages = logs.joint_states(*logs.numbers())
    if change is not None:
        messages = ((s, change(k, m)) for k, (s, m) in enumerate(messages))
    return logs.write_ros2(folder / "bag", messages, plugin, **more)


def opened(path, **options):
    return read_table(path, TableOptions(**options))


def refusal(act):
    with pytest.raises(BadInput) as caught:
        act()
    assert "\n" not in str(caught.value)
    return str(caught.value)


# -- ROS


def topic(name, kind, value):
    return name, [(logs.BEGIN, logs.ROS2.types[f"std_msgs/msg/{kind}"](value))]


@pytest.mark.parametrize(
    ("more", "table", "parts"),
    [
        (("/other", logs.joint_states(*logs.numbers())), None, ["'/joint_states', '/other'"]),
        (topic("/talk", "String", "hello"), "/jo", ["'/jo'", "'/joint_states'"]),
        (topic("/joint_states", "Float64", 1.0), None, ["bag"]),
    ],
)
def test_topics_that_are_not_one(tmp_path, more, table, parts):
    bag(tmp_path, more=[more])
    has(refused(tmp_path, used("bag", table=table)), *parts)
    if more[0] == "/talk":  # of text, and so the other is the only one of numbers
        assert read(tmp_path, used("bag"))


def test_a_type_without_definition(tmp_path):
    (path,) = bag(tmp_path, logs.StoragePlugin.SQLITE3).glob("*.db3")

    def typed(kind):
        # the connection's own context commits and does not close
        with closing(sqlite3.connect(path)) as database, database:
            database.execute("UPDATE topics SET type = ?", (kind,))
            database.execute("DELETE FROM message_definitions")
        (tmp_path / "one.db3").write_bytes(path.read_bytes())
        return used("one.db3")

    has(refused(tmp_path, typed("my_msgs/msg/Servo")), "my_msgs/msg/Servo", "MCAP")
    # bags of ROS 2 before Iron hold no definitions, nor are they needed of known types
    assert read(tmp_path, typed("sensor_msgs/msg/JointState"))


@pytest.mark.parametrize(
    ("column", "parts"),
    [
        ("position[elbow]", ["'position[elbow]'", "'position[knee]'"]),
        ("position", ["'position'", "'position[0]'"]),
        ("header.frame_id", ["'header.frame_id'", "row 1"]),
    ],
)
def test_columns_of_messages(tmp_path, column, parts):
    bag(tmp_path)
    has(refused(tmp_path, used("bag", position={"column": column, "unit": "rad"})), *parts)


def set_field(rows, field, value):
    """Change a field in some messages."""

    def change(k, message):
        if rows(k):
            setattr(message, field, value)
        return message

    return change


OTHERS = ["finger", "thumb"]


@pytest.mark.parametrize(
    ("lost", "field", "value"),
    [
        (lambda k: k < 3, "effort", np.empty(0)),  # of a driver that starts
        (lambda k: k == 16, "effort", np.full(2, np.nan)),
        (lambda k: k % 2 == 0, "name", OTHERS),  # two publishers on one topic
    ],
)
def test_messages_without_a_joint_s_signal_are_left_out_and_counted(tmp_path, lost, field, value):
    bag(tmp_path, change=set_field(lost, field, value))
    (recording,) = read(tmp_path, used("bag"))
    rows = [k for k in range(256) if not lost(k)]
    expected = logs.numbers()[1][rows, 1]
    assert set(recording.position) >= set(expected[:10])
    assert set(recording.position[-10:]) <= {*expected} or field == "effort"
    has(recording.steps[1], f"holes: {256 - len(rows)} of 256 rows left out", "'effort[knee]'")


def test_stamps_that_go_back(tmp_path):
    stamp = logs.ROS2.types["builtin_interfaces/msg/Time"](1, 0)
    header = logs.ROS2.types["std_msgs/msg/Header"](stamp, "")
    bag(tmp_path, change=set_field(lambda k: k == 16, "header", header))
    has(refused(tmp_path, used("bag")), "'header.stamp', row 17")


def test_rosbags_is_not_installed(tmp_path, monkeypatch):
    bag(tmp_path)
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    has(refused(tmp_path, used("bag")), "pip install 'bayesfric[ros]'")


def test_pyarrow_is_not_installed(tmp_path, monkeypatch):
    logs.write_lerobot(tmp_path / "run.parquet", *logs.numbers())
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    has(refusal(lambda: opened(tmp_path / "run.parquet")), "pip install 'bayesfric[parquet]'")


# -- HDF5 and JSON lines


def test_hdf5_groups(tmp_path):
    logs.write_hdf5(tmp_path / "run.h5", *logs.numbers())
    names = opened(tmp_path / "run.h5", table="observations").names
    assert set(names) == {"qpos", "qvel", "effort"}
    has(refusal(lambda: opened(tmp_path / "run.h5", table="obs")), "'obs'", "'observations'")
    with h5py.File(tmp_path / "one.h5", "w") as file:
        file["log/run1/t"] = np.arange(4.0)
    assert opened(tmp_path / "one.h5").column("t").tolist() == [0.0, 1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("text", "table", "parts"),
    [
        ('{"a": {"t": 1}}', "b", ["line 1", "'b'", "'a'"]),
        ('{"t": 1}\n\n{"t": 2}\n{"t": ', None, ["line 4"]),
        ('{"t": 1}\n\n{"q": 2}\n', None, ["'t'", "row 2 (line 3)"]),
        ('{"t": 1}\n[2]\n', None, ["row 2 (line 2)"]),
        ('{"t": 1}\n\n{"t": "x"}\n', None, ["'t'", "row 2 (line 3)"]),
    ],
)
def test_json_lines(tmp_path, text, table, parts):
    path = tmp_path / "run.jsonl"
    path.write_text(text)
    has(refusal(lambda: opened(path, table=table).column("t")), *parts)
    path.write_text('{"a": {"t": 1}}\n\n{"a": {"t": 2}}\n')
    assert opened(path, table="a").column("t").tolist() == [1.0, 2.0]


# -- JSON and structs


def with_row(change):
    rows = pd.DataFrame(file_formats.columns()).to_dict("records")
    change(rows[16])
    return json.dumps(rows)


@pytest.mark.parametrize(
    ("text", "table", "parts"),
    [
        *((text, None, []) for text in (
            "3", '"x"', "null", "{}", '{"a": 1}', "[1, 2]", "[]")),
        ('{"log": {"rows": []}}', "log.entries", ["'entries'", "'rows'"]),
        ('{"log": {"rows": []}}', "log.rows", []),
        ('{"a": [{"t": 1}], "b": [{"t": 1}]}', None, ["'a'", "'b'"]),
        *((with_row(lambda row, x=x: row.update(q=x)), None, ["'q'", "row 17"]) for x in (
            [1.0], {"x": 1}, "high")),
    ],
)  # fmt: skip
def test_unfit_json(tmp_path, text, table, parts):
    (tmp_path / "run.json").write_text(text)
    used = source("run.json", **({"table": table} if table else {}))
    has(refused(tmp_path, used), "run.json", *parts)


def test_struct_that_is_not_there(tmp_path):
    savemat(tmp_path / "run.mat", {"log": file_formats.columns(), "x": 1.0})
    has(refused(tmp_path, source("run.mat", table="logg")), "'logg'", "'log'")
    has(refused(tmp_path, source("run.mat", table="x")), "'x'")
