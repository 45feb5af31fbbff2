"""Columns of an arm's log: by names with numbers and units, by order, and as a list has them."""

import numpy as np
import pandas as pd
import pytest

from bayesfric.arm.arm_columns import layout_of, recognised_layout
from bayesfric.arm.arm_options import ArmOptions
from bayesfric.arm.inertial_prior import UrdfJoint
from bayesfric.base.errors import BadInput
from bayesfric.commands.init import draft_configuration
from bayesfric.recordings.units import OPEN

from . import bench
from .bench import ELBOW, SHOULDER

TIME = 0.005 * np.arange(400)
# position, velocity, acceleration and effort of two joints
SIGNALS = {
    "p": [np.sin((2.0 + k) * TIME) for k in range(2)],
    "v": [(2.0 + k) * np.cos((2.0 + k) * TIME) for k in range(2)],
    "a": [-((2.0 + k) ** 2) * np.sin((2.0 + k) * TIME) for k in range(2)],
    "e": [np.cos(3.0 * TIME + k) for k in range(2)],
}


def joints(*names):
    return {name: UrdfJoint(name, "rotary") for name in names}


def log(path, kinds, names=None, clock=1.0):
    """Write a log whose columns are a time and signals, ``"p1v1"`` of the first joint."""
    pairs = [kinds[k : k + 2] for k in range(0, len(kinds), 2)]
    columns = [clock * TIME, *(SIGNALS[kind][int(joint) - 1] for kind, joint in pairs)]
    frame = pd.DataFrame(np.stack(columns, axis=1), columns=names)
    frame.to_csv(path, index=False, header=names is not None)
    return path


@pytest.mark.parametrize(
    ("pattern", "urdf"),
    [
        ("t_s joint_1_position_rad joint_2_position_rad joint_1_effort_Nm joint_2_effort_Nm", 1),
        ("time_s q_0 q_1 tau_0 tau_1", 1),
        ("t q[0] q[1] tau[0] tau[1]", 1),
        ("time panda_joint1_position panda_joint2_position p1_effort p2_effort", 0),
        ("t_ms J1_pos_deg J2_pos_deg J1_torque_Nm J2_torque_Nm", 1),
        (f"time position[{SHOULDER}] position[{ELBOW}] effort[{SHOULDER}] effort[{ELBOW}]", 2),
    ],
)
def test_joints_of_a_log_are_matched_by_name_or_number(tmp_path, pattern, urdf):
    """Units are those of the names, else assumed to be SI, which is said."""
    names = pattern.replace("p1_", "panda_joint1_").replace("p2_", "panda_joint2_").split()
    in_urdf = [(SHOULDER, ELBOW, "tip"), ("joint_1", "joint_2", "tip"), (SHOULDER, ELBOW)][urdf]
    path = log(tmp_path / "log.csv", "p1p2e1e2", names, 1e3 if "ms" in pattern else 1.0)
    known = {key: joint for key, joint in joints(*in_urdf).items() if urdf or key != "tip"}
    layout, assumed = recognised_layout(path, known, {})
    order = [name for name in known if name != "tip"]
    assert [*layout] == order
    for k, name in enumerate(order):
        assert layout[name]["position"]["column"] == names[1 + k]
        assert layout[name]["torque"]["column"] == names[3 + k]
        assert layout[name]["position"]["unit"] == {"ad": "rad", "eg": "deg"}.get(
            names[1][-2:], "?"
        )
    assert layout[order[0]]["time"]["unit"] == ("ms" if "ms" in pattern else "s")
    options = ArmOptions(joints={"tip": {"held": 0.0}} if "tip" in known else {})
    layout, assumed = layout_of(path, known, options)
    assert ("SI" in assumed) == ("Nm" not in pattern)
    assert layout[order[1]]["torque"]["unit"] == ("N m" if "Nm" in pattern else "SI")


@pytest.mark.parametrize("clock", [1.0, 1e3, 1e6])
@pytest.mark.parametrize(
    ("kinds", "velocity", "effort"),
    [("p1p2e1e2", None, 4), ("p1p2v1v2e1e2", 4, 6), ("p1p2v1v2a1a2e1e2", 4, 8)],
)
def test_a_log_without_names_is_read_by_its_derivatives(tmp_path, kinds, velocity, effort, clock):
    path = log(tmp_path / "log.csv", kinds, clock=clock)
    layout, assumed = layout_of(path, joints("a", "b"), ArmOptions())
    unit = {1.0: "s", 1e3: "ms", 1e6: "us"}[clock]
    for k, document in enumerate(layout.values()):
        expected = {"position": 2, "velocity": velocity, "torque": effort}
        columns = {key: v + k for key, v in expected.items() if v is not None}
        assert {key: document[key]["column"] for key in columns} == columns
        assert ("velocity" in document) == (velocity is not None)
        assert document["time"] == {"column": 1, "unit": unit}
    assert f"torque {effort} to {effort + 1}" in assumed


def test_a_log_without_names_of_two_efforts_or_of_other_joints_is_refused(tmp_path):
    path = log(tmp_path / "log.csv", "p1p2v1v2e1e2e2e1")
    with pytest.raises(BadInput, match="torque"):
        layout_of(path, joints("a", "b"), ArmOptions())
    with pytest.raises(BadInput, match="9 columns have no names"):
        layout_of(path, joints("a", "b", "c"), ArmOptions())


def test_lists_have_an_entry_for_each_joint_that_is_not_held(tmp_path):
    path = log(tmp_path / "log.csv", "p1e1p2e2")
    position = {"column": [2, 4], "unit": ["rad", "mm"]}
    current = {"column": [3, 5], "unit": "A", "torque_constant": "{torque_constant}"}
    gains = {"a": {"torque_constant": "3 N m/A"}, "c": {"torque_constant": "5 N/A"}}
    clock = {"time": {"column": 1, "unit": "s"}}
    options = {"joints": {**gains, "b": {"held": 0.1}}}
    recording = {**clock, "position": position, "current": current}
    layout, _ = layout_of(path, joints("a", "b", "c"), ArmOptions(recording=recording, **options))
    assert layout["c"]["position"] == {"column": 4, "unit": "mm"}
    assert layout["c"]["current"] == {"column": 5, "unit": "A", "torque_constant": "5 N/A"}
    with pytest.raises(BadInput, match=r"recording\.position\.column"):
        layout_of(path, joints("a", "c"), ArmOptions(recording={"position": {"column": [2]}}))


def test_init_writes_each_joints_columns_and_never_sends_to_itself(tmp_path):
    """Other names in the URDF's order; where numbers differ all is left open."""
    (tmp_path / "arm.urdf").write_text(bench.urdf(slides=True).replace(SHOULDER, "hip"))
    names = ["time_s", "a_position_rad", "b_position_rad", "c_position_m"]
    names += ["a_effort_Nm", "b_effort_Nm", "c_effort_N"]
    path = log(tmp_path / "log.csv", "p1p2p1e1e2e1", names)
    text = draft_configuration("arm", path, None, urdf=tmp_path / "arm.urdf")["text"]
    assert 'unit = ["rad", "rad", "m"]' in text
    assert 'column = ["a_effort_Nm", "b_effort_Nm", "c_effort_N"]' in text
    path = log(tmp_path / "log.csv", "p1p2e1e2", ["t", "a_pos", "b_pos", "a_effort", "b_effort"])
    draft = draft_configuration("arm", path, None, urdf=tmp_path / "arm.urdf")
    assert {"recording.position", "recording.torque"} <= draft["open"].keys()


@pytest.mark.parametrize(
    "pattern",
    [
        "time,observation.state[{}],action[{}]",
        "time,{}_position_rad,{}_goal_position_rad",
        "time,dof_pos[{}],des_dof_pos[{}]",
        "time_s,position[{}],target[{}]",
    ],
)
def test_targets_stand_for_efforts_that_a_log_lacks(tmp_path, pattern):
    """What remains open are the gains, without which nothing is fitted."""
    known, (time, *columns) = joints("joint_1", "joint_2"), pattern.split(",")
    labels = range(2) if "dof" in pattern else known
    names = [time, *(column.format(label) for column in columns for label in labels)]
    path = log(tmp_path / "log.csv", "p1p2e1e2", names)
    layout, _ = recognised_layout(path, known, {})
    for k, name in enumerate(known):
        assert layout[name]["position"]["column"] == names[1 + k]
        target = layout[name]["target"]
        assert (target["column"], target["kp"], target["kd"]) == (names[3 + k], OPEN, OPEN)
    with pytest.raises(BadInput):
        layout_of(path, known, ArmOptions())
    (tmp_path / "arm.urdf").write_text(bench.urdf())
    draft = draft_configuration("arm", path, None, urdf=tmp_path / "arm.urdf")
    assert "recording.target" in draft["open"]
    assert "torque = " not in draft["text"].partition("[urdf]")[0].partition("# or")[0]
