"""Broken bags, HDF5, JSON lines and lists: one line that names the place and the mend."""

import json
import sqlite3
import sys
from contextlib import closing
from importlib import resources
from pathlib import Path

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


def test_text_is_no_topic_of_numbers(tmp_path):
    bag(tmp_path, more=[topic("/talk", "String", "hello")])
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


def without_knee(message):
    message.name = ["hip", "ankle"]


def shorter(message):
    message.effort = message.effort[:1]


def not_finite(message):
    message.effort[1] = np.nan


def goes_back(message):
    message.header.stamp.sec -= 3


@pytest.mark.parametrize(
    ("change", "column"),
    [
        (without_knee, "position[knee]"),
        (shorter, "effort[knee]"),
        (not_finite, "effort[knee]"),
        (goes_back, "header.stamp"),
    ],
)
def test_messages_that_differ(tmp_path, change, column):
    def changed(k, message):
        if k == 16:
            change(message)
        return message

    bag(tmp_path, change=changed)
    has(refused(tmp_path, used("bag")), f"'{column}', row 17")


def test_joints_of_two_publishers(tmp_path):
    """An arm and a gripper on one topic: every second message is of the other."""

    def turns(k, message):
        message.name = message.name if k % 2 else ["finger", "thumb"]
        return message

    bag(tmp_path, change=turns)
    has(refused(tmp_path, used("bag")), "'position[knee]', row 1")
    (recording,) = read(tmp_path, used("bag", where={"name[0]": "hip"}))
    np.testing.assert_array_equal(recording.position, logs.numbers()[1][1::2, 1])


def test_rosbags_is_not_installed(tmp_path, monkeypatch):
    bag(tmp_path)
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    has(refused(tmp_path, used("bag")), "pip install 'bayesfric[ros]'")


# -- HDF5, JSON lines, MATLAB's objects


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


def test_matlab_objects_are_no_columns():
    """SciPy's own test data hold what MATLAB wrote: functions and an inline object."""
    folder = Path(str(resources.files("scipy.io.matlab") / "tests" / "data"))
    if not (folder / "some_functions.mat").exists():
        pytest.skip("this SciPy comes without its test data")
    has(refusal(lambda: opened(folder / "some_functions.mat").column("parabola")), "'parabola'")


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
        (with_row(lambda row: row.pop("q")), None, ["'q'", "row 17"]),
        *((with_row(lambda row, x=x: row.update(q=x)), None, ["'q'", "row 17"]) for x in (
            None, [1.0], {"x": 1}, "high")),
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
