"""``bayesfric init --from``: columns by their names; what a log does not tell is left open."""

import re

import numpy as np
import pandas as pd
import pytest

from bayesfric.mechanism.joint import PRESETS
from bayesfric.problem.config import read_config
from bayesfric.recordings.recognition import named, recognise
from bayesfric.recordings.tables import Table
from tests.recordings import logs

from .bench import cases, has

pytestmark = pytest.mark.usefixtures("nothing_explained")

SI = {"time": "s", "position": "rad", "velocity": "rad/s", "torque": "N m", "current": "A"}
T = 0.005 * np.arange(2000)
Q = 0.8 * np.sin(2 * np.pi * 0.5 * T) + 0.3 * np.sin(2 * np.pi * 1.3 * T)
V = np.gradient(Q, T)
TAU = 0.4 * np.gradient(V, T) + 0.2 * np.tanh(V / 0.05) + 0.9 * np.sin(Q)


def table(**columns):
    return Table("log", list(columns), [np.asarray(c, float) for c in columns.values()].__getitem__)


def found(**columns):
    return recognise(table(**columns)).chosen


def settled(text, **units):
    """Write what was left open, in SI where no unit of a channel is given."""
    lines = []
    for line in text.splitlines():
        channel = line.partition(" = ")[0]
        line = line.replace('unit = "?"', f'unit = "{units.get(channel, SI.get(channel, "?"))}"')
        lines.append(line.replace('"? ', '"1 '))
    return "\n".join(lines)


def written(bench, log, *arguments):
    """Write a configuration; its text and what is told of it."""
    ended = bench.run("init", *arguments, "--from", log, "-o", bench.folder / "made.toml")
    assert (ended.code, ended.err) == (0, ""), ended
    return (bench.folder / "made.toml").read_text(), ended.out


def passes(bench, text, **units):
    (bench.folder / "settled.toml").write_text(settled(text, **units))
    ended = bench.run("check", bench.folder / "settled.toml")
    assert (ended.code, ended.err) == (0, ""), ended
    return ended.out


@pytest.mark.parametrize(
    ("name", "channel", "joint", "unit"),
    cases(
        ("plain", "position", "position", "", ""),
        ("unit", "pos_deg", "position", "", "deg"),
        ("in brackets", "velocity [rpm]", "velocity", "", "rpm"),
        ("in parentheses", "vel (deg/s)", "velocity", "", "deg/s"),
        ("of two words", "speed_rad_s", "velocity", "", "rad/s"),
        ("milliseconds", "time_ms", "time", "", "ms"),
        ("milliamperes", "motor_current_mA", "current", "", "mA"),
        ("newton metres", "tau_Nm", "torque", "", "N m"),
        ("UR", "actual_q_0", "position", "0", ""),
        ("UR speed", "actual_qd_3", "velocity", "3", ""),
        ("list", "observation.state[2]", "position", "2", ""),
        ("ROS", "position[knee]", "position", "knee", ""),
        ("ODrive", "axis0.motor.current_control.Iq_measured", "current", "0", ""),
        ("i_q", "i_q", "current", "", ""),
        ("joint first", "knee_pos_deg", "position", "knee", "deg"),
        ("camel case", "kneePosition", "position", "knee", ""),
        ("nothing", "status", "", "", ""),
    ),
)
def test_names(name, channel, joint, unit):
    said = named(name)
    assert (said.channel, said.joint, said.unit) == (channel, joint, unit)


def test_what_is_wanted_is_not_what_is_measured():
    one = found(time=T, target_position=Q, position=Q, velocity=V, torque=TAU)
    assert one["position"].column == "position"


def test_a_column_that_is_no_clock_is_not_the_time():
    assert "time" not in found(timestamp=0 * T, position=Q, torque=TAU)
    assert found(stamp=0 * T, t=T, position=Q, torque=TAU)["time"].column == "t"


# -- the command


def test_what_is_left_open_is_refused_until_it_was_written(bench):
    pd.DataFrame({"t": T, "pos_deg": np.degrees(Q), "i_q": TAU}).to_csv(
        bench.folder / "log.csv", index=False
    )
    text, out = written(bench, bench.folder / "log.csv")
    has(text, 'file = "log.csv"', 'unit = "deg" }', 'unit = "?"', 'torque_constant = "? N m/A"')
    has(out, "motor-axis is used", "time.unit", "current.unit", "current.torque_constant")
    path = bench.folder / "made.toml"
    keys = [
        f"recordings.1.{key}" for key in ("time.unit", "current.unit", "current.torque_constant")
    ]
    for k, value in enumerate(("s", "A", "0.1 N m/A")):
        has(bench.refused("check", path), f"made.toml: {keys[k]}:", "left open")
        before, _, after = path.read_text().partition("\n[[recordings]]")
        after = re.sub(r'"\?( N m/A)?"', f'"{value}"', after, count=1)
        path.write_text(f"{before}\n[[recordings]]{after}")
    assert bench.run("check", path).code == 0


def test_the_first_of_several_joints(bench):
    logs.write_json_lines(bench.folder / "log.jsonl", *logs.numbers())
    text, out = written(bench, bench.folder / "log.jsonl", "rabbit-knee")
    has(text, "# joint 0; others: 1", 'column = "q[0]"', 'side = "motor"')
    has(out, "Joint 0; with --joint one of: 1", "motor or of the joint")
    message = bench.refused("init", "--from", bench.folder / "log.jsonl", "--joint", "7")
    has(message, "--joint 7", "no such joint", "0, 1")


def test_units_from_a_row_below_the_header(bench):
    rows = [f"{a:.6f},{b:.6f},{c:.6f}" for a, b, c in zip(1e3 * T, np.degrees(Q), TAU, strict=True)]
    (bench.folder / "log.csv").write_text("\n".join(["time,angle,torque", "ms,deg,Nm", *rows]))
    text, _ = written(bench, bench.folder / "log.csv")
    assert '"?' not in text
    has(text, 'unit = "ms"', 'unit = "deg"', 'unit = "N m"')
    passes(bench, text)


@pytest.mark.parametrize(
    ("arguments", "parts"),
    cases(
        ("neither", ["init"], ["PRESET", "is missing", "--from"]),
        ("a table of nothing", ["init", "motor-axis", "--table", "x"], ["--table", "--from LOG"]),
        ("no such log", ["init", "--from", "none.csv"], ["none.csv", "does not exist"]),
        ("no such preset", ["init", "knee", "--from", "LOG"], ["knee", "no such preset"]),
        ("a log of text", ["init", "--from", "TEXT"], ["text.csv"]),
    ),
)
def test_what_cannot_be_read_is_one_line(bench, arguments, parts):
    pd.DataFrame({"t": T, "q": Q, "tau": TAU}).to_csv(bench.folder / "log.csv", index=False)
    (bench.folder / "text.csv").write_text("a,b\nx,y\nz,w\n")
    places = {"LOG": "log.csv", "TEXT": "text.csv"}
    words = [str(bench.folder / places[w]) if w in places else w for w in arguments]
    has(bench.refused(*words), *parts)


def test_columns_without_names_are_counted(bench):
    np.savetxt(bench.folder / "log.csv", np.column_stack([T, Q, TAU]), delimiter=",")
    text, out = written(bench, bench.folder / "log.csv")
    has(text, "# columns: 1, 2, 3", 'position = { column = "?"', 'torque = { column = "?"')
    has(out, "position.column", "torque.column", "rate")
    has(bench.refused("check", bench.folder / "made.toml"), "recordings.1.rate", "left open")


@pytest.mark.parametrize("preset", PRESETS)
def test_a_load_loss_sees_the_inertia_that_init_writes(bench, preset):
    """Before a load loss it would see gravity only; without one it stays the motor's."""
    pd.DataFrame({"t": T, "q": Q, "qd": V, "torque": TAU}).to_csv(
        bench.folder / "log.csv", index=False
    )
    text, _ = written(bench, bench.folder / "log.csv", preset)
    passes(bench, text)
    joint = read_config(bench.folder / "settled.toml").tables.mechanism.joint()
    assert joint.unseen_inertia == ()
    chain = PRESETS[preset].chain()
    assert ("motor.inertia" in joint.names) == (chain.unseen_inertia == ())
    added = {"load.inertia"} if chain.unseen_inertia else set()
    assert set(joint.names) - set(chain.names) == added
    # a second header of a table that a user takes the '#' off would be refused
    assert text.count("[mechanism.elements.motor]") <= 1


# -- real logs


@pytest.mark.parametrize(
    ("file", "columns", "units"),
    cases(
        ("emps", "emps/DATA_EMPS.mat", ["t", "qm", "?"], None),
        ("ur10e", "ur10e-joint2/joint_2.csv", ["?", "?"], None),
        (
            "xl330",
            "xl330-pendulum/2026-01-15_10h28m10.json",
            ["timestamp", "position", "speed", "load"],
            {"torque": "0.001 N m"},
        ),
        ("dfki", "dfki-pendulum/ddp.csv", ["time", "position", "velocity", "torque"], {}),
    ),
)
def test_real_logs(bench, real_data, file, columns, units):
    text, _ = written(bench, real_data / file)
    for column in columns:
        has(text, f'{{ column = "{column}", ')
    assert bench.run("check", bench.folder / "made.toml").code == 2
    if units is not None:
        passes(bench, text, **units)
