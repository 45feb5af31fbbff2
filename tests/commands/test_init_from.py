"""``bayesfric init --from``: the columns of a log, recognised, with every guess marked."""

import json
import re

import numpy as np
import pandas as pd
import pytest

from bayesfric.config import read_config
from bayesfric.mechanism.presets import PRESETS
from bayesfric.recordings.recognition.log import recognise
from bayesfric.recordings.recognition.names import named
from bayesfric.recordings.tables import Table, read_table
from bayesfric.recordings.tables.reader import TableOptions
from tests.hostile import random_files
from tests.recordings import logs

from .bench import cases, has

T = 0.005 * np.arange(2000)
Q = 0.8 * np.sin(2 * np.pi * 0.5 * T) + 0.3 * np.sin(2 * np.pi * 1.3 * T)
V = np.gradient(Q, T)
TAU = 0.4 * np.gradient(V, T) + 0.2 * np.tanh(V / 0.05) + 0.9 * np.sin(Q)


def table(**columns):
    return Table("log", list(columns), [np.asarray(c, float) for c in columns.values()].__getitem__)


def found(**columns):
    log = recognise(table(**columns))
    return {one.channel: one for one in log.chosen}


def settled(text):
    """Take the configuration for right, as a user who has looked at every guess does."""
    return text.replace('?"', '"')


def written(bench, log, *arguments):
    """Write a configuration; its text and what is told of it."""
    ended = bench.run("init", *arguments, "--from", log, "-o", bench.folder / "made.toml")
    assert (ended.code, ended.err) == (0, ""), ended
    return (bench.folder / "made.toml").read_text(), ended.out


def passes(bench, text):
    (bench.folder / "settled.toml").write_text(settled(text))
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
    assert one["position"].others == ("target_position",)


@pytest.mark.parametrize(
    ("angle", "speed", "factors"),
    [
        ("rad", "rad/s", (1.0, 1.0)),
        ("deg", "rad/s", (180 / np.pi, 1.0)),
        ("rad", "deg/s", (1.0, 180 / np.pi)),
        ("rad", "rpm", (1.0, 30 / np.pi)),
        ("deg", "deg/s", (180 / np.pi, 180 / np.pi)),
        ("turn", "rpm", (0.5 / np.pi, 30 / np.pi)),
        ("deg", "rpm", (180 / np.pi, 30 / np.pi)),
    ],
)
def test_units_of_position_and_velocity_are_settled_together(angle, speed, factors):
    one = found(time=T, position=factors[0] * Q, velocity=factors[1] * V, torque=TAU)
    assert (one["position"].unit, one["velocity"].unit) == (f"{angle}?", f"{speed}?")


def test_one_unit_in_a_name_settles_the_other():
    one = found(time=T, position_deg=np.degrees(Q), velocity=V, torque=TAU)
    assert (one["position"].unit, one["velocity"].unit) == ("deg", "rad/s?")
    has(one["velocity"].why, "0.01745", "differentiated")


def test_a_velocity_that_is_none_is_said():
    noise = np.random.default_rng(1).normal(size=T.size)
    has(found(time=T, position=Q, velocity=noise, torque=TAU)["velocity"].why, "not", "derivative")
    has(found(time=T, position=Q, velocity=3 * V, torque=TAU)["velocity"].why, "no unit explains")
    assert found(time=T, position=Q, velocity=-V, torque=TAU)["velocity"].sign == -1


@pytest.mark.parametrize(("factor", "unit"), [(1, "s"), (1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_time_by_its_period(factor, unit):
    assert found(t=factor * T, q=Q, tau=TAU)["time"].unit == f"{unit}?"


def test_counts():
    counts = np.round(Q / (2 * np.pi) * 4096)
    one = found(time=T, position=counts, current=np.round(500 * TAU))
    assert one["position"].unit == "turn/4096?"
    has(one["position"].why, "counts")
    has(one["current"].why, "whole numbers")
    load = np.round(300 * TAU) % 65536
    assert found(time=T, position=Q, load=load)["torque"].twos_complement == 16


def test_without_names_the_speed_of_a_column_tells():
    rng = np.random.default_rng(2)
    still = rng.normal(scale=1e-4, size=T.size)
    measured = TAU / 10 + rng.normal(scale=0.02, size=T.size)
    columns = [T + 100, still, Q, -still, V, rng.normal(size=T.size), measured]
    log = recognise(Table("log", [""] * 7, columns.__getitem__))
    chosen = {one.channel: (one.column, one.unit) for one in log.chosen}
    assert chosen["time"] == (1, "s?")
    assert chosen["position"] == (3, "rad?")
    assert chosen["velocity"] == (5, "rad/s?")
    assert chosen["torque"] == (7, "N m?")
    has(" ".join(log.unknown), "no names")


# -- the unit of an angle

# Of 28 rad and of 28 degrees alike nothing but the joint itself tells which they are: SIMULATED, a
# pendulum that spins and one that swings, in one unit and in the other.
SPIN = -14.0 + 14.0 * np.cos(2 * np.pi * 0.1 * T) + 0.5 * np.sin(2 * np.pi * 0.7 * T)
SWING = np.radians(SPIN)


def gravity_and_more(q, weight=1.0):
    v = np.gradient(q, T)
    noise = 0.02 * np.random.default_rng(5).standard_normal(T.size)
    return 0.02 * np.gradient(v, T) + 0.1 * np.tanh(v / 0.05) + weight * np.sin(q) + noise


@pytest.mark.parametrize(("unit", "times"), [("rad", 1.0), ("deg", 180.0 / np.pi)])
@pytest.mark.parametrize("motion", [SPIN, SWING], ids=["spins", "swings"])
def test_gravity_tells_the_unit_of_an_angle(motion, unit, times):
    v = np.gradient(motion, T)
    one = found(
        time=T, position=times * motion, velocity=times * v, torque=gravity_and_more(motion)
    )
    if motion is SWING and unit == "rad":
        # half a radian: the sine is the angle, and the range alone tells
        has(one["position"].why, "by its range alone")
    else:
        has(one["position"].why, f"in {unit} inertia, friction and gravity explain")
    assert (one["position"].unit, one["velocity"].unit) == (f"{unit}?", f"{unit}/s?")


def test_without_gravity_a_guess_says_what_each_unit_would_mean():
    one = found(time=T, position=SPIN, torque=gravity_and_more(SPIN, weight=0.0))
    turns, degrees = np.ptp(SPIN) / (2 * np.pi), np.ptp(SPIN)
    has(one["position"].why, "by its range alone", f"{turns:.3g} turns if it were rad",
        f"{degrees:.4g} degrees if it were deg")  # fmt: skip


@pytest.mark.parametrize(("unit", "turn"), [("rad", 2 * np.pi), ("deg", 360.0), ("turn", 1.0)])
@pytest.mark.parametrize("decimals", [5, 15])
def test_a_step_that_is_a_turn_over_a_power_of_two_tells_the_unit(unit, turn, decimals):
    q = np.round(4096 * np.sin(T)) / 4096 * turn
    one = found(time=T, position=np.round(q, decimals), torque=np.cos(3 * T))
    assert one["position"].unit == f"{unit}?"
    has(one["position"].why, f"a turn over 4096 in {unit}")


def test_steps_of_decimals_tell_no_unit():
    one = found(time=T, position=np.round(30 * np.sin(T), 2), torque=np.cos(3 * T))
    has(one["position"].why, "by its range alone")


@pytest.mark.parametrize(("unit", "turn"), [("rad", 2 * np.pi), ("deg", 360.0)])
def test_rests_at_half_turns_tell_the_unit(unit, turn):
    """Hung, then balanced after one and a half and after two and a half turns; no torque tells."""
    places = np.interp(T, [0, 2, 3, 5, 6, 10], [0, 0, -1.5, -1.5, -2.5, -2.5])
    shaken = 0.003 * np.sin(40 * T)
    one = found(time=T, position=turn * (places + shaken), torque=np.cos(3 * T))
    assert one["position"].unit == f"{unit}?"
    has(one["position"].why, f"in {unit} it rests at", "-2.5, -1.5 turns")


@pytest.mark.parametrize("file", ["sac", "es500", "es1kg", "ilqr", "ddp", "dircol"])
@pytest.mark.parametrize(("unit", "times"), [("rad", 1.0), ("deg", 180.0 / np.pi)])
def test_the_unit_of_a_measured_pendulum_is_found_without_its_encoders_step(
    real_data, file, unit, times
):
    """A millionth of a turn of noise hides the step, which tells the unit of the log as it is."""
    log = pd.read_csv(real_data / f"dfki-pendulum/{file}.csv")
    whole = found(**log)
    assert (whole["position"].unit, whole["velocity"].unit) == ("rad?", "rad/s?")
    has(whole["position"].why, "±95.5 rad")
    noise = 1e-6 * np.random.default_rng(3).standard_normal(len(log))
    log["position"] = times * (log["position"] + noise)
    log["velocity"] *= times
    assert found(**log)["position"].unit == f"{unit}?"


# -- the command


def test_guesses_are_refused_until_they_were_looked_at(bench):
    pd.DataFrame({"t": T, "pos_deg": np.degrees(Q), "i_q": TAU}).to_csv(
        bench.folder / "log.csv", index=False
    )
    text, out = written(bench, bench.folder / "log.csv")
    has(text, 'file = "log.csv"', 'unit = "deg" }', 'unit = "A?"', 'torque_constant = "0.1 N m/A?"')
    has(out, "motor-axis is taken", "current.unit", "up to", "current.torque_constant")
    assert out.count("data sheet") == 1
    guesses = re.findall(r'(\w+) = "([^"]*\?)"', "\n".join(
        line for line in text.splitlines() if not line.startswith("#")))  # fmt: skip
    assert len(guesses) == 3
    messages = []
    for _ in range(3):
        before, mark, after = (bench.folder / "made.toml").read_text().partition('?"')
        assert mark
        message = bench.refused("check", bench.folder / "made.toml")
        has(message, "made.toml: recordings.1.", "is a guess", "without the '?'")
        messages.append(message)
        (bench.folder / "made.toml").write_text(before + '"' + after)
    for message, others in zip(messages, ("'ms' or 'us'", "'mA'", ""), strict=True):
        assert ("such as" in message) == bool(others)
        assert others in message
    # one look at all of them is enough
    rest = ("recordings.1.current.unit", "recordings.1.current.torque_constant")
    has(messages[0], *rest)
    has(messages[1], rest[1])
    assert " are;" not in messages[2]
    assert bench.run("check", bench.folder / "made.toml").code == 0


@pytest.mark.parametrize("name", ["CSV", "ROS 2, sqlite3", "LeRobot", "HDF5", "JSON lines"])
def test_logs_of_every_format(bench, name):
    file, keys = logs.all_logs(bench.folder)[name]
    joint = {"CSV": (), "LeRobot": ("--joint", "1"), "ROS 2, sqlite3": ("--joint", "knee")}
    text, out = written(bench, bench.folder / file, *joint.get(name, ("--joint", "1")))
    has(text, f'column = "{keys["position"]["column"]}"')
    if name == "LeRobot":
        has(text, 'where = { "episode_index" = 0 }', 'column = "?"')
        has(out, "no column can be torque")
    else:
        for key in ("velocity", "torque"):
            has(text, f'column = "{keys[key]["column"]}"')
        passes(bench, text)
    if name.startswith("ROS"):
        assert '?"' not in text  # the message's definition settles every unit
        has(out, "Joint knee", "one of: hip")


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
    assert '?"' not in text
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
        ("nothing moves with another", ["init", "--from", "NOISE"], ["noise.csv", "no column"]),
    ),
)
def test_what_cannot_be_recognised_is_one_line(bench, arguments, parts):
    pd.DataFrame({"t": T, "q": Q, "tau": TAU}).to_csv(bench.folder / "log.csv", index=False)
    (bench.folder / "text.csv").write_text("a,b\nx,y\nz,w\n")
    noise = np.random.default_rng(3).normal(size=(100, 4))
    np.savetxt(bench.folder / "noise.csv", noise, delimiter=",")
    places = {"LOG": "log.csv", "TEXT": "text.csv", "NOISE": "noise.csv"}
    words = [str(bench.folder / places[w]) if w in places else w for w in arguments]
    has(bench.refused(*words), *parts)


def test_json_holds_every_guess(bench):
    pd.DataFrame({"t": T, "q": Q, "tau": TAU}).to_csv(bench.folder / "log.csv", index=False)
    told = json.loads(bench.run("init", "--from", bench.folder / "log.csv", "--json").out)
    assert {one["key"] for one in told["guesses"]} == {"time.unit", "position.unit", "torque.unit"}
    assert all(one["why"] for one in told["guesses"])
    units = {one["key"]: one["or"] for one in told["guesses"]}
    assert units["time.unit"] == ["ms", "us"]
    assert all(0 < len(others) <= 3 for others in units.values())


def test_what_a_guess_could_be_instead_is_told(bench):
    """A preset was taken, units and a column chosen: what else there is stands beside."""
    pd.DataFrame({"t": T, "q": Q, "q_target": Q + 0.01, "tau": TAU}).to_csv(
        bench.folder / "log.csv", index=False
    )
    text, out = written(bench, bench.folder / "log.csv")
    others = [name for name in PRESETS if name != "motor-axis"]
    assert len(others) >= 2
    for name in others:
        has(out, f'preset = "{name}" is for {PRESETS[name].when}')
        assert f'"{name}"' in text
    has(out, 'time.unit = "s?"', 'or "ms", "us"', 'position.column = "q"', 'or "q_target"')
    # as in the file: commas between them
    assert '; or "q_target"' in text
    (bench.folder / "made.toml").unlink()
    named, said = written(bench, bench.folder / "log.csv", "servo-pendulum")
    has(named, 'preset = "servo-pendulum"')
    assert "motor-axis" not in said  # it was asked for


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
    ("file", "columns", "wrong"),
    cases(
        ("emps", "emps/DATA_EMPS.mat", ["t", "qm", "vir"], {}),
        ("ur10e", "ur10e-joint2/joint_2.csv", [1, 3, 9, 15], {}),
        (
            "xl330",
            "xl330-pendulum/2026-01-15_10h28m10.json",
            ["timestamp", "position", "speed", "load"],
            {'unit = "N m"': 'unit = "0.001 N m"'},
        ),
        ("dfki", "dfki-pendulum/ddp.csv", ["time", "position", "velocity", "torque"], {}),
    ),
)
def test_real_logs(bench, real_data, file, columns, wrong):
    text, out = written(bench, real_data / file)
    for column in columns:
        has(text, f"{{ column = {json.dumps(column)}, ")
    assert bench.run("check", bench.folder / "made.toml").code == 2
    for old, new in wrong.items():
        assert old in settled(text)
        text = settled(text).replace(old, new)
    passes(bench, text)
    if file.startswith("ur10e"):
        has(out, "the columns have no names")


def test_a_reader_tells_units_that_messages_define(tmp_path):
    logs.write_ros2(tmp_path / "bag", logs.joint_states(*logs.numbers()))
    read = read_table(tmp_path / "bag", TableOptions())
    told = dict(zip(read.names, read.units, strict=True))
    assert told["header.stamp"] == told["received"] == "s"
    assert told["effort[knee]"] == "N m"


@pytest.mark.parametrize("seed", range(6))
def test_odd_logs_are_one_line_or_a_configuration(bench, seed):
    """Whatever the columns hold: what is damaged in tests/hostile, looked at by init."""
    rng = np.random.default_rng(seed)
    for form in ("csv", "json", "npz", "mat", "parquet"):
        (bench.folder / f"odd.{form}").write_bytes(random_files.ODD[form](rng))
        ended = bench.run("init", "--from", bench.folder / f"odd.{form}")
        assert ended.code in (0, 2), ended
        if ended.code == 2:
            assert re.fullmatch(r"bayesfric: [^\n]+: [^\n]+; [^\n]+\n", ended.err), ended.err
        else:
            assert "[[recordings]]" in ended.out


def test_an_axis_that_slides_is_offered(bench):
    """Metres cannot be told from radians by a short travel: both are said, with what they take."""
    rows = {"t": T, "qm": 0.12 * Q / np.ptp(Q), "vir": 0.3 * TAU}
    pd.DataFrame(rows).to_csv(bench.folder / "axis.csv", index=False)
    text, told = written(bench, "axis.csv")
    assert re.search(
        r'position.unit = "rad\?".*120 mm if it slides.*"turn"; "m" or "mm" if it slides', told
    )
    assert re.search(r'torque.unit = "N m\?".*; "N" or "kN" if it slides', told)
    assert '# motion = "linear"' in text
    assert '# if it slides, with motion = "linear" in [mechanism]: unit = "m" or "mm"' in text
    # and what is said is right
    text = text.replace('# motion = "linear"', 'motion = "linear"')
    text = text.replace('"rad?"', '"m"').replace('"N m?"', '"V", constant = "35 N/V"')
    assert "motor.inertia" in passes(bench, text)
    (bench.folder / "made.toml").unlink()
    text, told = written(bench, "axis.csv", "servo-pendulum")
    assert 'motion = "linear"' not in text + told
