"""``bayesfric init``: presets, columns of a log by their names, every key, schemas for editors."""

import json
import re
import tomllib
from importlib.resources import files
from pathlib import Path

import jsonschema
import numpy as np
import pandas as pd
import pytest

from bayesfric.arm.arm_options import ArmOptions
from bayesfric.fleet.plan import FleetTables, read_plan
from bayesfric.mechanism.joint import PRESETS
from bayesfric.problem.config import Tables, parse_config, read_config
from bayesfric.recordings.recognition import named, recognise
from bayesfric.recordings.tables import Table
from tests.conftest import REPOSITORY
from tests.recordings import logs

from .bench import cases, has

pytestmark = pytest.mark.usefixtures("nothing_explained")

SI = {"time": "s", "position": "rad", "velocity": "rad/s", "torque": "N m", "current": "A"}
T = 0.005 * np.arange(2000)
Q = 0.8 * np.sin(2 * np.pi * 0.5 * T) + 0.3 * np.sin(2 * np.pi * 1.3 * T)
V = np.gradient(Q, T)
TAU = 0.4 * np.gradient(V, T) + 0.2 * np.tanh(V / 0.05) + 0.9 * np.sin(Q)


# -- presets


@pytest.mark.parametrize("preset", PRESETS)
def test_a_preset_can_be_simulated_and_checked(bench, validators, preset):
    ended = bench.run("init", preset)
    assert (ended.code, ended.err) == (0, "")
    tables = tomllib.loads(ended.out)
    geared = {e.name: {} for e in PRESETS[preset].chain().elements if e.ratio != 1.0}
    elements = {"elements": geared} if geared else {}
    assert tables["mechanism"] == {"preset": preset, "terms": "auto"} | elements
    assert len(ended.out.splitlines()) <= 26
    validators["configuration"].validate(tables)
    bench.config(ended.out.replace("recording.csv", "simulated.csv"))
    assert bench.run("simulate", "c.toml", "-o", "simulated.csv").code == 0
    priors = bench.record("check", "c.toml")["priors"]
    assert set(priors) == {*PRESETS[preset].values, "noise.sigma"}
    assert not read_config(bench.folder / "c.toml").tables.simulation


def test_a_file_is_replaced_only_by_force(bench):
    printed = bench.run("init", "motor-axis").out
    record = bench.record("init", "motor-axis", "-o", "new.toml")
    assert record["written"] == "new.toml"
    path = bench.folder / "new.toml"
    assert path.read_text(encoding="utf-8") == record["text"] == printed.removesuffix("\n")
    assert bench.run("init", "motor-axis", "-o", "-").out == printed
    has(bench.refused("init", "servo-pendulum", "-o", "new.toml"), "exists already", "--force")
    assert bench.run("init", "servo-pendulum", "-o", "new.toml", "--force").code == 0
    assert path.read_text(encoding="utf-8") != record["text"]


@pytest.mark.parametrize(
    ("arguments", "parts"),
    cases(
        ("nothing", [], ["PRESET", "--from"]),
        ("a table of nothing", ["motor-axis", "--table", "x"], ["--table", "--from LOG"]),
        ("lines of nothing", ["motor-axis", "--skip-rows", "2"], ["--skip-rows", "--from LOG"]),
        ("no such format", ["--from", "run.csv", "--format", "xls"], ["--format", "xlsx"]),
        ("a column", ["--from", "column.txt"], ["column.txt", "one column"]),
        ("another format", ["--from", "run.csv", "--format", "json"], ["run.csv"]),
        ("no such log", ["--from", "none.csv"], ["none.csv", "does not exist"]),
        ("no such preset", ["knee", "--from", "run.csv"], ["knee", "no such preset"]),
        ("a log of text", ["--from", "c.toml"], ["c.toml"]),
        ("keys of a preset", ["rabbit-knee", "--all-keys"], ["rabbit-knee", "--all-keys"]),
        ("schema of a log", ["--schema", "--from", "run.csv"], ["--schema", "--from"]),
        ("schema and keys", ["--schema", "--all-keys"], ["--schema", "--all-keys"]),
        ("arm without URDF", ["arm", "--from", "run.csv"], ["--urdf"]),
    ),
)
def test_bad_arguments(bench, arguments, parts):
    (bench.folder / "column.txt").write_text("0\n0.5\n1\n")
    has(bench.refused("init", *arguments), *parts)


# -- logs


@pytest.mark.parametrize(
    ("name", "channel", "joint", "unit"),
    [
        ("position", "position", "", ""),
        ("pos_deg", "position", "", "deg"),
        ("velocity [rpm]", "velocity", "", "rpm"),
        ("vel (deg/s)", "velocity", "", "deg/s"),
        ("speed_rad_s", "velocity", "", "rad/s"),
        ("time_ms", "time", "", "ms"),
        ("motor_current_mA", "current", "", "mA"),
        ("tau_Nm", "torque", "", "N m"),
        ("actual_qd_3", "velocity", "3", ""),
        ("observation.state[2]", "position", "2", ""),
        ("position[knee]", "position", "knee", ""),
        ("axis0.motor.current_control.Iq_measured", "current", "0", ""),
        ("i_q", "current", "", ""),
        ("knee_pos_deg", "position", "knee", "deg"),
        ("kneePosition", "position", "knee", ""),
        ("status", "", "", ""),
        ("t_ms", "time", "", "ms"),
        ("millis", "time", "", "ms"),
        ("timestamps", "time", "", ""),
        ("torque_uNm", "torque", "", "uN m"),
        ("torque_kNm", "torque", "", "kN m"),
        ("current_uA", "current", "", "uA"),
        ("velocity_m_s", "velocity", "", "m/s"),
        # no unit: a prefix in words, a link, a foot, an index of an object
        ("torque_milli_Nm", "torque", "milli nm", ""),
        ("link_position", "position", "link", ""),
        ("foot_angle", "position", "foot", ""),
        ("velocity_actual_606C", "velocity", "", ""),
    ],
)
def test_names_of_columns(name, channel, joint, unit):
    meaning = named(name)
    assert (meaning.channel, meaning.joint, meaning.unit) == (channel, joint, unit)


def recognised(**columns):
    arrays = [np.asarray(values, float) for values in columns.values()]
    return recognise(Table("log", list(columns), arrays.__getitem__))


def chosen(**columns):
    return {key: column for key, (column, _) in recognised(**columns).chosen.items()}


def test_targets_and_frozen_clocks_are_not_measurements():
    columns = chosen(time=T, target_position=Q, position=Q, velocity=V, torque=TAU)
    assert columns["position"] == "position"
    assert "time" not in chosen(timestamp=0 * T, position=Q, torque=TAU)
    assert chosen(stamp=0 * T, t=T, position=Q, torque=TAU)["time"] == "t"


def test_the_joint_that_moves_is_chosen():
    """Of four drives, three of which stand still; a register that is constant is no torque."""
    rng = np.random.default_rng(1)
    drives = {
        f"drive{k} {name}": values * (k == 2) + 1e-4 * rng.normal(size=T.size)
        for k in range(4)
        for name, values in (("position", Q), ("current", TAU))
    }
    log = recognised(t=T, **drives)
    assert (log.joint, len(log.joints)) == ("drive 2", 4)
    assert log.chosen["current"][0] == "drive2 current"
    log = recognised(t=T, position_left=Q, position_right=Q, angle=Q, voltage_left=TAU)
    assert (log.joint, log.joints) == ("left", ("left", "right"))
    assert "torque" not in chosen(t=T, position=Q, load=0 * T)


def test_holes_hide_no_column():
    assert "position" in chosen(t=T, position=np.where(T < 0.01, np.nan, Q), torque=TAU)


def drafted(bench, log, *arguments):
    """Write ``draft.toml`` for a log; return its text and what is printed."""
    ended = bench.run("init", *arguments, "--from", log, "-o", bench.folder / "draft.toml")
    assert (ended.code, ended.err) == (0, ""), ended
    return (bench.folder / "draft.toml").read_text(), ended.out


def check_completed(bench, text, **units):
    """Fill what was left open, in SI where no unit of a channel is given, and check it."""
    lines = []
    for line in text.splitlines():
        channel = line.partition(" = ")[0]
        line = line.replace('unit = "?"', f'unit = "{units.get(channel, SI.get(channel, "?"))}"')
        lines.append(line.replace('"? ', '"1 '))
    (bench.folder / "completed.toml").write_text("\n".join(lines))
    ended = bench.run("check", bench.folder / "completed.toml")
    assert (ended.code, ended.err) == (0, ""), ended


def test_open_keys_are_refused_until_they_are_filled(bench):
    table = pd.DataFrame({"t": T, "pos_deg": np.degrees(Q), "i_q": TAU})
    table.to_csv(bench.folder / "log.csv", index=False)
    text, printed = drafted(bench, "log.csv")
    has(text, 'file = "log.csv"', 'unit = "deg" }', 'unit = "?"', 'torque_constant = "? N m/A"')
    path = bench.folder / "draft.toml"
    values = {"time.unit": "s", "current.unit": "A", "current.torque_constant": "0.1 N m/A"}
    for key, value in values.items():
        has(printed, key)
        has(bench.refused("check", "draft.toml"), f"draft.toml: recordings.1.{key}:")
        before, _, after = path.read_text().partition("\n[[recordings]]")
        after = re.sub(r'"\?( N m/A)?"', f'"{value}"', after, count=1)
        path.write_text(f"{before}\n[[recordings]]{after}")
    assert bench.run("check", "draft.toml").code == 0


def test_speed_alone_is_a_log(bench):
    speed = np.gradient(Q, T)
    table = pd.DataFrame({"time_s": T, "velocity_rad_s": speed, "torque_Nm": TAU})
    table.to_csv(bench.folder / "log.csv", index=False)
    text, printed = drafted(bench, "log.csv")
    has(printed, "position")
    check_completed(bench, text)
    table.drop(columns="time_s").iloc[::5].to_csv(bench.folder / "points.csv", index=False)
    (bench.folder / "draft.toml").unlink()
    text, _ = drafted(bench, "points.csv")
    check_completed(bench, text.replace('rate = "? kHz"', "steady = true"))


def test_a_known_number_suits_the_schema(validators):
    columns = {"time": {"column": 1, "unit": "s"}, "position": {"column": 2, "unit": "rad"}}
    recording = {"file": "a.csv", "torque": 0, **columns}
    validators["configuration"].validate({"mechanism": {}, "recordings": [recording]})


def test_the_first_of_several_joints(bench):
    logs.write_json_lines(bench.folder / "log.jsonl", *logs.numbers())
    text, printed = drafted(bench, "log.jsonl", "rabbit-knee")
    has(text, "# joint 0; others: 1", 'column = "q[0]"', 'side = "motor"')
    has(printed, "Joint 0; with --joint one of: 1")
    has(bench.refused("init", "--from", "log.jsonl", "--joint", "7"), "--joint 7", "0, 1")


def test_efforts_of_ros_have_no_unit(bench):
    """Drivers write N m or A: the key is open, and a current can take its place."""
    logs.write_ros2(bench.folder / "bag", logs.joint_states(*logs.numbers()))
    text, _ = drafted(bench, "bag")
    recording = tomllib.loads(text)["recordings"][0]
    assert recording["torque"]["unit"] == "?"
    assert recording["position"]["unit"] == "rad"
    has(text, 'unit = "A"', recording["torque"]["column"])
    check_completed(bench, text)


def test_every_column_is_described(bench):
    """Its range and holes, what it is taken as, or why it is not: in JSON and on the terminal."""
    table = pd.DataFrame({"t_s": T, "q_rad": Q, "target_q": Q, "tau_Nm": TAU, "flag": "on"})
    table["effort"], table["i_q"], table.loc[:2, "q_rad"] = 0.0, TAU, np.nan
    table.to_csv(bench.folder / "log.csv", index=False)
    record = bench.record("init", "--from", "log.csv")
    columns = {row["column"]: row for row in record["columns"]}
    assert list(columns) == list(table)
    taken = {name: row["taken"] for name, row in columns.items() if "taken" in row}
    assert taken == {"t_s": "time", "q_rad": "position", "tau_Nm": "torque"}
    assert all(("why" in row) != ("taken" in row) for row in columns.values())
    assert (columns["q_rad"]["holes"], columns["q_rad"]["unit"]) == (3, "rad")
    assert (columns["tau_Nm"]["low"], columns["tau_Nm"]["high"]) == (TAU.min(), TAU.max())
    assert not columns["effort"]["moves"]
    text, printed = drafted(bench, "log.csv")
    has(printed, *columns, columns["flag"]["why"], "3 of 2000")
    plain = bench.run("init", "--from", "log.csv").out
    assert tomllib.loads(plain) == tomllib.loads(text)  # the table is a comment


@pytest.mark.parametrize("arguments", [[], ["--decimal", ","], ["--format", "csv"]])
def test_the_layout_that_was_detected_or_given_is_written(bench, arguments):
    table = pd.DataFrame({"t_s": T, "q_rad": Q, "tau_Nm": TAU})
    path = bench.folder / "log.asc"
    table.to_csv(path, index=False, sep=";", decimal=",")
    text, _ = drafted(bench, "log.asc", *arguments)
    has(text, 'decimal = ","')
    assert ("format" in text) == ("--format" in arguments)
    path.write_text(f"12,5;7,5\n1,5;8,5\n{path.read_text()}")
    text, _ = drafted(bench, "log.asc", *arguments, "--skip-rows", "2", "--force")
    has(text, "skip_rows = 2")
    check_completed(bench, text)


def test_units_from_a_row_below_the_header(bench):
    rows = [f"{a:.6f},{b:.6f},{c:.6f}" for a, b, c in zip(1e3 * T, np.degrees(Q), TAU, strict=True)]
    (bench.folder / "log.csv").write_text("\n".join(["time,angle,torque", "ms,deg,Nm", *rows]))
    text, _ = drafted(bench, "log.csv")
    has(text, 'unit = "ms"', 'unit = "deg"', 'unit = "N m"')
    check_completed(bench, text)


def test_columns_without_names_are_counted(bench):
    np.savetxt(bench.folder / "log.csv", np.column_stack([T, Q, TAU]), delimiter=",")
    text, _ = drafted(bench, "log.csv")
    has(text, "# columns: 1, 2, 3", 'position = { column = "?"', 'torque = { column = "?"')
    has(bench.refused("check", "draft.toml"), "recordings.1.time.unit")


@pytest.mark.parametrize("preset", PRESETS)
def test_load_dependent_friction_sees_the_inertia(bench, preset):
    """Before load-dependent friction it would see gravity only; without, it stays the motor's."""
    table = pd.DataFrame({"t": T, "q": Q, "qd": V, "torque": TAU})
    table.to_csv(bench.folder / "log.csv", index=False)
    text, _ = drafted(bench, "log.csv", preset)
    check_completed(bench, text)
    joint = read_config(bench.folder / "completed.toml").tables.mechanism.joint()
    chain = PRESETS[preset].chain()
    assert joint.unseen_inertia == ()
    assert ("motor.inertia" in joint.names) == (chain.unseen_inertia == ())
    added = {"load.inertia"} if chain.unseen_inertia else set()
    assert set(joint.names) - set(chain.names) == added


@pytest.mark.parametrize(
    ("file", "columns", "units"),
    [
        ("emps/DATA_EMPS.mat", ["t", "qm", "?"], None),
        ("ur10e-joint2/joint_2.csv", ["?", "?"], None),
        (
            "xl330-pendulum/2026-01-15_10h28m10.json",
            ["timestamp", "position", "speed", "load"],
            {"torque": "0.001 N m"},
        ),
        ("dfki-pendulum/ddp.csv", ["time", "position", "velocity", "torque"], {}),
    ],
)
def test_real_logs(bench, real_data, file, columns, units):
    text, _ = drafted(bench, real_data / file)
    for column in columns:
        has(text, f'{{ column = "{column}", ')
    assert bench.run("check", "draft.toml").code == 2
    if units is not None:
        assert ("twos_complement = 16" in text) == ("load" in columns)
        check_completed(bench, text, **units)


# -- every key, and the schema


CONFIGURATIONS = sorted(
    [
        *(Path(str(files("bayesfric"))) / "examples").glob("*.toml"),
        *(REPOSITORY / "studies").rglob("*.toml"),
    ]
)


@pytest.fixture(scope="module")
def validators():
    models = {"configuration": Tables, "fleet": FleetTables, "arm": ArmOptions}
    return {
        kind: jsonschema.Draft202012Validator(model.model_json_schema())
        for kind, model in models.items()
    }


@pytest.mark.parametrize("kind", ["configuration", "fleet"])
def test_every_key_is_printed_with_its_meaning(bench, validators, kind):
    printed = bench.run("init", *["fleet"] * (kind == "fleet"), "--all-keys").out
    text = " ".join(printed.split())
    schema = validators[kind].schema
    validators[kind].check_schema(schema)
    models = (schema, *schema["$defs"].values())
    for table in (part for model in models for part in model.get("anyOf", [model])):
        for name, key in table.get("properties", {}).items():
            assert re.search(rf"^{name}: ", printed, re.M), name
            assert " ".join(key["description"].split()) in text
    if kind == "configuration":
        assert "\n[mechanism.elements.NAME]\nratio: number, default 1.0\n" in printed
        assert "\ncolumn: text or integer, required\n" in printed


@pytest.mark.parametrize("path", CONFIGURATIONS, ids=lambda path: path.stem)
def test_configurations_of_the_repository_suit_the_schema(path, validators):
    kind = "arm" if path.stem == "arm" else "configuration"
    validators[kind].validate(tomllib.loads(path.read_text(encoding="utf-8")))


def test_the_schema_is_written(bench, validators):
    assert bench.run("init", "--schema", "-o", "schema.json").code == 0
    written = json.loads((bench.folder / "schema.json").read_text())
    assert written == validators["configuration"].schema
    assert json.loads(bench.run("init", "fleet", "--schema").out) == validators["fleet"].schema


def test_the_plan_of_a_fleet_works_as_it_is(bench, validators):
    assert bench.run("init", "fleet", "-o", "fleet.toml").code == 0
    text = (bench.folder / "fleet.toml").read_text(encoding="utf-8")
    assert not validators["fleet"].is_valid(tomllib.loads(text.replace("glob", "globe")))
    (bench.folder / "recordings").mkdir()
    for name in ("left", "right"):
        (bench.folder / "recordings" / f"{name}.csv").write_text("time,position,torque\n0,0,0\n")
    plan = read_plan(bench.folder / "fleet.toml")
    assert [unit.name for unit in plan.units] == ["left", "right"]
    (source,) = parse_config(plan.configuration(plan.units[1]), plan.path).tables.recordings
    assert source.files == ["recordings/right.csv"]
    # every example can be uncommented, but for what the glob excludes
    full = tomllib.loads(re.sub(r"^# (\w+ = .*)$", r"\1", text.replace("# table", "#"), flags=re.M))
    validators["fleet"].validate(full)


@pytest.mark.parametrize(
    ("name", "joint", "unit"),
    [
        ("q2_rad", "2", "rad"),
        ("joint_2_position_rad", "2", "rad"),
        ("vel2_rpm", "2", "rpm"),
        ("q_0.1deg", None, ""),
        ("current_10mA", None, ""),
        ("t_100us", None, ""),
    ],
)
def test_a_number_in_a_name_is_no_factor_of_its_unit(name, joint, unit):
    column = named(name)
    assert column.unit == unit
    assert joint is None or column.joint == joint
