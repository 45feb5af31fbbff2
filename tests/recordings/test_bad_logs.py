"""Broken bags, HDF5, JSON lines and lists: one line that names the place and the mend."""

import json
import sqlite3
import sys
from contextlib import closing
from importlib import resources
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.recordings.readers import TableOptions, read_table
from bayesfric.recordings.tables import Table
from tests.recordings import logs
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


# -- lists of signals

LISTS = ("parquet", "json", "jsonl", "h5", "7.3")


def listed(folder, form, n=200, turned=False):
    """Write three signals in one column, a row a sample or ``turned``; the file's name and keys."""
    t = np.arange(n) * 0.01
    state = np.stack([np.sin(t + i) for i in range(3)], axis=1)
    columns = {"t": t, "q": state.T if turned else state, "tau": np.cos(t)}
    lists = {name: values.tolist() for name, values in columns.items()}
    path = folder / f"run.{form}"
    match form:
        case "parquet":
            pq.write_table(pa.table(lists), path)
        case "json":
            path.write_text(json.dumps(lists))
        case "jsonl":
            rows = zip(*lists.values(), strict=True)
            path.write_text("\n".join(json.dumps(dict(zip(lists, r, strict=True))) for r in rows))
        case "h5":
            with h5py.File(path, "w") as file:
                file.update(columns)
        case "7.3":
            path = logs.write_matlab_73(folder / "run.mat", t, columns["q"], state, state)
            return path.name, {"table": "log"}, state
    return path.name, {}, state


@pytest.mark.parametrize("form", LISTS)
def test_one_of_several_signals(tmp_path, form):
    file, keys, state = listed(tmp_path, form)
    table = opened(tmp_path / file, **keys)
    for k in range(3):
        assert table.column(f"q[{k}]").tolist() == state[:, k].tolist()
    has(refusal(lambda: table.column("q[3]")), "'q[3]'", "from 0 to 2")
    has(refusal(lambda: table.column("q")), "'q'", "'q[0]'")
    has(refusal(lambda: table.column("t[0]")), "'t[0]'")
    has(refusal(lambda: table.column("p[0]")), "'p[0]'")


@pytest.mark.parametrize("form", ["h5", "json", "7.3"])
def test_a_row_for_each_joint(tmp_path, form):
    file, keys, state = listed(tmp_path, form, turned=True)
    assert opened(tmp_path / file, **keys).column("q[2]").tolist() == state[:, 2].tolist()


def test_the_longer_axis_is_time_unless_a_row_has_a_list(tmp_path):
    wide = np.arange(12.0).reshape(3, 4)
    table = Table("run", ["q"], [wide].__getitem__)
    assert table.column("q[1]").tolist() == wide[1].tolist()
    pq.write_table(pa.table({"q": wide.tolist()}), tmp_path / "run.parquet")
    assert opened(tmp_path / "run.parquet").column("q[1]").tolist() == wide[:, 1].tolist()


@pytest.mark.parametrize("form", ["parquet", "jsonl"])
def test_lists_that_are_ragged(tmp_path, form):
    rows = [[0.0, 1.0]] * 5 + [[0.0]] + [[0.0, 1.0]] * 5
    if form == "parquet":
        pq.write_table(pa.table({"q": rows}), tmp_path / "run.parquet")
    else:
        (tmp_path / "run.jsonl").write_text("\n".join(json.dumps({"q": row}) for row in rows))
    table = opened(tmp_path / f"run.{form}")
    assert table.column("q[0]").tolist() == [0.0] * 11
    has(refusal(lambda: table.column("q[1]")), "'q[1]'", "row 6")


# -- rows by a column's value


def test_conditions_are_all_to_hold():
    arrays = [np.arange(6.0), np.array([1, 1, 2, 2, 3, 3.0]), np.array([1, 0, 1, 0, 1, 0.0])]
    table = Table("run", ["t", "episode", "on"], arrays.__getitem__)
    assert table.only({"episode": 2, "on": True}).column("t").tolist() == [2.0]
    assert table.only({"on": 0}).column("t").tolist() == [1.0, 3.0, 5.0]
    assert table.only({}).column("t").tolist() == arrays[0].tolist()
    has(refusal(lambda: table.only({"episode": 2, "t": 0})), "'t', where", "2, 3")
    has(refusal(lambda: table.only({"run": 2})), "'run'")


def test_text_and_numbered_columns_in_a_csv(tmp_path):
    (tmp_path / "run.csv").write_text("task,t,q\nlift,0,1\nswing,1,2\nswing,2,x\nlift,3,4\n")
    assert opened(tmp_path / "run.csv", where={"task": "lift"}).column("q").tolist() == [1.0, 4.0]
    assert opened(tmp_path / "run.csv", where={"2": 1}).column("q").tolist() == [2.0]
    message = refusal(lambda: opened(tmp_path / "run.csv", where={"task": "drop"}))
    has(message, "'drop'", "'lift', 'swing'")
    swings = opened(tmp_path / "run.csv", where={"task": "swing"})
    # a bad cell is named by its row in the file, not among those used
    has(refusal(lambda: swings.column("q")), "'q'", "row 3 (line 4)")


def test_a_column_of_another_length_cannot_be_chosen_from(tmp_path):
    np.savez(tmp_path / "run.npz", t=np.arange(5.0), q=np.arange(4.0))
    table = opened(tmp_path / "run.npz", where={"t": 1})
    has(refusal(lambda: table.column("q")), "'q'", "4", "5")


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
