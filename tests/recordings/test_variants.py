"""Twenty variants of each kind of log that was once paired, named or decoded wrongly.

Each is drawn by its number: names, order of columns, share of holes, rates and clocks. What is read
has to be the truth, or what is wrong has to be named.
"""

import json
import re

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from bayesfric.base.errors import BadInput
from bayesfric.recordings import units
from bayesfric.recordings.measurement import implausible
from bayesfric.recordings.readers import TableOptions, read_table
from bayesfric.recordings.recognition import named, recognise, with_clocks
from bayesfric.recordings.signals import observe
from bayesfric.recordings.source import Columns, Processing, Recording
from bayesfric.recordings.tables import Table
from tests.recordings.samples import measured

VARIANTS = pytest.mark.parametrize("number", range(20))
# fmt: off
JOINTS = (
    "hip", "knee", "foot", "hand", "link", "arm", "toe", "quad", "mil", "ton",
    "bar", "rod", "chain", "point", "pole", "hood", "leg", "elbow", "ankle", "gear",
)
# fmt: on
W = 2.0 * np.pi * np.array([0.31, 0.83])


def angle(t):
    return np.sin(W[0] * t) + 0.4 * np.sin(W[1] * t)


def speed(t):
    return W[0] * np.cos(W[0] * t) + 0.4 * W[1] * np.cos(W[1] * t)


def drive(t):
    return 3.0 * np.cos(W[1] * t) + 2.0 * np.sin(W[0] * t)


# of drive and angle, whose second derivatives are below
CURVATURE = 3.0 * W[1] ** 2 + 2.0 * W[0] ** 2


def shuffled(rng, columns):
    """Return columns as a table in another order."""
    names = list(columns)
    rng.shuffle(names)
    cells = [np.asarray(columns[name]) for name in names]
    return Table("log", names, cells.__getitem__)


def chosen(table):
    log = recognise(table)
    return {channel: column for channel, (column, _) in log.chosen.items()}, log


def configured(table, clocks=None, **channels):
    keys = {
        k: {"column": c, "unit": "SI"} if isinstance(c, str) else c for k, c in channels.items()
    }
    if clocks:
        table = Table("log", table.names, table.load, clocks=clocks)
    return measured(Recording(Columns.model_validate(keys), table=table))


# -- paired in silence


@VARIANTS
def test_columns_are_paired_by_time(number):
    """Stamps of their own or the union of stamps, holes, wraps, sign bits, start and stop."""
    rng = np.random.default_rng([1, number])
    rate, slower = rng.uniform(100.0, 1000.0), rng.uniform(0.3, 1.0)
    t = np.arange(0.0, 12.0, 1.0 / rate)
    late = np.arange(rng.uniform(0.0005, 0.03), 12.0, 1.0 / rate / slower)
    counts = np.round(drive(late) * 1000.0)
    bits = rng.choice([14, 16, 20])
    tau = np.where(counts < 0.0, counts + 2.0**bits, counts) if number % 2 else counts
    wrap = number % 3 == 0
    q = (7.0 * angle(t) + np.pi) % (2.0 * np.pi) - np.pi if wrap else 7.0 * angle(t)
    q[rng.random(t.size) < rng.uniform(0.0, 0.08)] = np.nan
    tau[rng.random(late.size) < rng.uniform(0.0, 0.08)] = np.nan
    start, stop = rng.uniform(0.5, 1.5), rng.uniform(9.0, 11.0)
    keys = {"start": start, "stop": stop}
    keys["torque"] = {"column": "tau", "unit": "0.001 N m"}
    if number % 2:
        keys["torque"]["twos_complement"] = int(bits)
    if number % 4 < 2:  # groups of a file
        columns = {"a/t": 3.0 + t, "q": q, "b/t": 3.0 + late, "tau": tau}
        clocks = {"q": "a/t", "tau": "b/t"}
        recording = configured(shuffled(rng, columns), clocks, time="a/t", position="q", **keys)
    else:  # the union of all stamps
        stamps = np.unique([*t, *late])
        columns = {"t": stamps, "q": np.full(stamps.size, np.nan)}
        columns["tau"] = columns["q"].copy()
        columns["q"][np.searchsorted(stamps, t)] = q
        columns["tau"][np.searchsorted(stamps, late)] = tau
        keys = {k: v - min(t[0], late[0]) if k in ("start", "stop") else v for k, v in keys.items()}
        recording = configured(shuffled(rng, columns), time="t", position="q", **keys)
    time = recording.time
    assert time[0] >= keys["start"] - 1e-9
    assert time[-1] <= keys["stop"] + 1e-9
    # linear across a hole of up to five steps, and half a count
    longest = 5.0 / rate / slower
    error = CURVATURE * longest**2 / 8.0 + 0.00051
    np.testing.assert_allclose(recording.torque, drive(time), atol=error)
    position = recording.position - 7.0 * angle(time)
    turns = 2.0 * np.pi * np.round(np.median(position) / (2.0 * np.pi))
    np.testing.assert_allclose(position, turns, atol=7.0 * CURVATURE * (5.0 / rate) ** 2 / 8.0)


@VARIANTS
def test_a_target_that_wraps_is_paired_with_the_position(number):
    """Both wrap, at a turn of their own, on stamps of their own."""
    rng = np.random.default_rng([2, number])
    t = np.arange(0.0, 10.0, 1.0 / rng.uniform(200.0, 500.0))
    late = t + rng.uniform(0.0005, 0.02)
    goal, turn = 5.0 * angle(late) + 0.05, 2.0 * np.pi
    # each in a range of its own
    begin, other = rng.uniform(-np.pi, 0.0, 2)
    wrapped = {"q": (5.0 * angle(t) - begin) % turn + begin, "goal": (goal - other) % turn + other}
    columns = {"p/t": t, "g/t": late, **wrapped}
    target = {"column": "goal", "unit": "rad", "kp": "2 N m/rad"}
    clocks = {"q": "p/t", "goal": "g/t"}
    table = shuffled(rng, columns)
    recording = configured(table, clocks, time="p/t", position="q", target=target)
    # kp times what the two differ by
    np.testing.assert_allclose(recording.torque, 0.1, atol=10.0 * CURVATURE * (t[1] - t[0]) ** 2)


# -- a column that is not seen

CLOCKS = {
    "time": "", "t": "", "timestamp": "", "timestamps": "", "ts": "", "stamp": "", "clock": "",
    "t_s": "s", "time_ms": "ms", "t_us": "us", "elapsed_s": "s", "timestamp_ns": "ns",
    "millis": "ms", "micros": "us", "Time [s]": "s", "TIME [MS]": "", "time(ms)": "ms",
    "elapsed_seconds": "s", "Timestamp_us": "us", "t [sec]": "s",
}  # fmt: skip


@VARIANTS
def test_the_time_column_is_seen(number):
    """Numbers, counters that wrap, and dates; with holes, repeated rows, or a bad stamp."""
    rng = np.random.default_rng([3, number])
    name, unit = list(CLOCKS.items())[number]
    scale = units.scale([unit or "s"], "time")
    rate = rng.choice([50.0, 125.0, 200.0, 500.0])
    t = np.arange(1500) / rate
    stamps = (t / scale + 100.0).astype(object)
    form = number % 5
    if form == 1 and scale < 1.0:  # of 16 or 32 bits
        whole = np.round(t / scale + 5e4).astype(np.int64)
        stamps = (whole % (2**16 if scale == 1e-3 else 2**32)).astype(object)
    dated = form == 2 and not unit
    if dated:
        dates = pd.Timestamp("2026-03-02T09:59:57") + pd.to_timedelta(t, unit="s")
        texts = (dates.strftime("%Y-%m-%d %H:%M:%S.%f"), dates, dates.tz_localize("Europe/Berlin"))
        stamps = np.array(texts[number % 3].astype(object))
        unit = "s"
    lost = rng.random(t.size) < 0.02
    if form != 3:
        stamps[lost] = None
    bad = int(rng.integers(20, 1400))
    if form == 3:
        stamps[bad] = rng.choice(["x", "ERR", "12:x"])
    columns = {name: stamps, "position": angle(t), "torque": drive(t), "temperature": 20.0 + 0 * t}
    if form == 4:
        again = np.sort(np.append(np.arange(t.size), rng.integers(0, t.size, 30)))
        columns = {key: values[again] for key, values in columns.items()}
    table = shuffled(rng, columns)
    columns, log = chosen(table)
    assert columns == {"time": name, "position": "position", "torque": "torque"}
    scales = (units.scale([x or "s"], "time") for x in (log.chosen["time"][1], unit))
    assert np.ptp([*scales]) == 0.0 or not log.chosen["time"][1]
    time = {"column": name, "unit": unit or "s"}
    if form == 3:
        assert f"row {bad + 1}" in " ".join(log.problems)
        with pytest.raises(BadInput, match=f"{name[:4]}.*row {bad + 1}"):
            configured(table, time=time, position="position", torque="torque")
        return
    recording = configured(table, time=time, position="position", torque="torque")
    first = t[~lost][0]
    # linear across up to three holes
    error = CURVATURE * (4.0 / rate) ** 2 / 8.0
    np.testing.assert_allclose(recording.torque, drive(recording.time + first), atol=error)
    if dated:
        with pytest.raises(BadInput, match='unit = "s"'):
            configured(table, time=time | {"unit": "ms"}, position="position", torque="torque")


DATED = pd.Timestamp("2026-03-02T23:59:57")


@VARIANTS
def test_time_in_other_forms(number):
    """Without a name, in two columns, as steps, ticks, durations and clock times; or two rivals."""
    rng = np.random.default_rng([16, number])
    t = np.cumsum(rng.uniform(0.8, 1.2, 1500)) / rng.choice([100.0, 250.0])
    t -= t[0]
    ns, form = np.round(t * 1e9) + 1_763_800_000_123_456_789.0 % 2**40, number % 7
    texts = pd.Series(pd.to_timedelta(t, unit="s"))
    columns, taken, unit = [
        ({"": t / 1e-3}, 1, ""),
        ({"stamp.sec": ns // 1e9, "stamp.nanosec": ns % 1e9}, "stamp.sec + stamp.nanosec", "s"),
        ({"dt_ms": np.diff(t, prepend=-0.004) / 1e-3}, "sum of dt_ms", "ms"),
        ({"ticks": np.round(t / 1e-6)}, "ticks", ""),
        ({"elapsed": texts.to_numpy()}, "elapsed", "s"),
        ({"elapsed": texts.astype(str).to_numpy(dtype=object)}, "elapsed", "s"),
        ({"Zeitpunkt": t, "andere": 1.01 * t + 3.0}, units.OPEN, ""),
    ][form]
    columns |= {"angle": angle(t), "torque": drive(t), "sample": np.arange(t.size)}
    table = Table("log", [*columns], [*map(np.asarray, columns.values())].__getitem__)
    table = with_clocks(table)
    names, log = chosen(table)
    assert (names["time"], log.chosen["time"][1]) == (taken, unit)
    if form == 6:
        assert "Zeitpunkt or andere" in " ".join(log.problems)
        return
    time = {"column": taken, "unit": unit or ("ms" if form == 0 else "us")}
    recording = configured(table, time=time, position="angle", torque="torque")
    error = CURVATURE * np.diff(t).max() ** 2 / 8.0 + 1e-5
    np.testing.assert_allclose(recording.torque, drive(recording.time), atol=error)


@VARIANTS
def test_dated_clocks_of_two_groups(number):
    """They are counted from one date, also past midnight."""
    rng = np.random.default_rng([17, number])
    t = np.arange(0.0, 10.0, 1.0 / rng.uniform(200.0, 500.0))
    late = t + rng.uniform(0.02, 4.0)
    stamps = [DATED + pd.to_timedelta(x, unit="s") for x in (t, late)]
    clocks = [x.to_numpy() if number % 2 else x.astype(str).to_numpy(dtype=object) for x in stamps]
    columns = {"a/time": clocks[0], "b/time": clocks[1], "a/q": angle(t), "b/tau": drive(late)}
    table = with_clocks(shuffled(rng, columns))
    assert table.clocks == {"a/q": "a/time", "b/tau": "b/time"}
    time = {"column": "a/time", "unit": "s"}
    recording = configured(table, time=time, position="a/q", torque="b/tau")
    # dates are whole nanoseconds
    error = CURVATURE * (t[1] - t[0]) ** 2 / 8.0 + 1e-6
    np.testing.assert_allclose(recording.torque, drive(recording.time), atol=error)


@VARIANTS
def test_rows_that_where_selects_keep_their_times(number):
    """Pieces of a recording at a rate are segments, and rows of joints that take turns are not."""
    rng = np.random.default_rng([4, number])
    t, several = 0.01 * np.arange(3000), 1 + number % 3
    which = np.tile(np.arange(several), t.size)
    on = np.repeat((t < rng.uniform(8.0, 12.0)) | (t > rng.uniform(18.0, 22.0)), several)
    joint = rng.integers(several)
    columns = {"q": angle(np.repeat(t, several)), "tau": drive(np.repeat(t, several))}
    rows = (which == joint) & on
    table = shuffled(rng, columns).at(np.flatnonzero(rows), rows.size)
    channels = {
        key: {"column": c, "unit": "SI"} for key, c in {"position": "q", "torque": "tau"}.items()
    }
    source = Columns.model_validate({**channels, "rate": "100 Hz"})
    recording = measured(Recording(source, table=table))
    assert len(recording.segments) == 2
    np.testing.assert_allclose(recording.torque, drive(recording.time), atol=1e-9)


# -- the wrong one is taken


@VARIANTS
def test_the_joint_that_moves_and_what_drives_it(number):
    """Of several joints that stand still but for one, beside targets, limits and registers."""
    rng = np.random.default_rng([5, number])
    t = 0.004 * np.arange(2000)
    joints = list(rng.choice(JOINTS, 4, replace=False))
    moving, style = joints[rng.integers(4)], number % 5
    form = ["{j}_{s}", "{s}_{j}", "{j}.{s}", "/{j}/{s}", "{s}[{j}]"][style]
    position, effort = (
        rng.choice(["position", "pos", "q", "angle"]),
        rng.choice(["torque", "effort", "current"]),
    )
    clock = ["time", "loop_time", "unix_timestamp", "sensor.stamp"][number % 4]
    columns = {clock: t}
    for joint in joints:
        at, noise = float(joint == moving), 1e-4 * rng.standard_normal(t.size)
        for signal, values in (
            (position, at * angle(t) + noise),
            (effort, at * drive(t) + 0.01 * noise),
            (f"target_{position}", at * angle(t + 0.01)),
            (f"{effort}_limit", 5.0 + 0.0 * t),
        ):
            columns[form.format(j=joint, s=signal)] = values
    if number % 2:  # another joint's, first in the file, and a register that is 0
        columns = {"bus_voltage": 24.0 + 0.1 * drive(t), "load": 0.0 * t, **columns}
    names, log = chosen(shuffled(rng, columns))
    assert (log.joint, names["time"]) == (moving, clock)
    assert names["position"] == form.format(j=moving, s=position)
    drives = {"torque", "current", "voltage"} & names.keys()
    assert {names[key] for key in drives} == {form.format(j=moving, s=effort)}


@VARIANTS
def test_an_effort_of_another_joint_is_not_taken(number):
    rng = np.random.default_rng([6, number])
    t = 0.004 * np.arange(1000)
    one, other = rng.choice(JOINTS, 2, replace=False)
    form = ["{j}_{s}", "{s}_{j}", "{j}.{s}", "/{j}/{s}", "{s}[{j}]"][number % 5]
    columns = {"t": t, form.format(j=one, s="position"): angle(t)}
    columns[form.format(j=other, s=rng.choice(["torque", "current"]))] = drive(t)
    names, _ = chosen(shuffled(rng, columns))
    assert names.keys() == {"time", "position"}


MEASURED = ("actual", "measured", "meas", "present", "feedback", "pv", "is", "ist", "")
COMMANDS = (
    "demand", "planned", "set", "soll", "nominal", "expected", "reference", "model", "sim",
    "target", "cmd",
)  # fmt: skip


@VARIANTS
def test_the_measured_one_of_several(number):
    """Before a name that does not say so, which is before a command; of two others neither."""
    rng = np.random.default_rng([11, number])
    t, word = 0.004 * np.arange(1000), MEASURED[number % 9]
    form = ["{s}_{w}", "{w}_{s}", "{s} {w} value", "{s}_{w}_rad", "{w}.{s}"][number % 5]
    measured = form.format(s="position", w=word) if word else "position"
    columns = {"time": t, measured: angle(t), "torque_raw": drive(t)}
    for other in rng.choice(COMMANDS, 3, replace=False):
        columns[form.format(s="position", w=other)] = angle(t + 0.01)
    if word:
        columns["position"] = angle(t + 0.02)
    names, log = chosen(shuffled(rng, columns))
    assert names == {"time": "time", "position": measured, "torque": "torque_raw"}
    assert log.joint == ""
    again = form.format(s="position", w=word and MEASURED[(number + 1) % 8]) if word else "Position"
    if again == measured:
        return
    names, log = chosen(shuffled(rng, {**columns, again: angle(t - 0.01)}))
    if word and MEASURED[(number + 1) % 8]:
        assert names["position"] == units.OPEN
        assert all(name in " ".join(log.problems) for name in (measured, again))
    names, _ = chosen(shuffled(rng, {**columns, again: columns[measured]}))
    assert names["position"] in (measured, again)


STAMPED = [
    ("enc_time", "drv_time", "enc_pos", "drv_torque"), ("t1", "t2", "q1", "tau2"),
    ("enc/t_ms", "drv/t_us", "enc/q", "drv/tau"), ("t_enc", "t_drv", "q_enc", "tau_drv"),
    ("a.stamps", "b.stamps", "a.angle", "b.torque"), ("enc/t_sec", "amp/time_ms", "enc/q", "amp/i"),
    ("log/enc/time_us", "log/drv/time_us", "log/enc/pos", "log/drv/effort"),
    ("encoder_time", "drive_time", "encoder_position", "drive_torque"),
    ("t1", "t2", "q", "tau"), ("Time", "Time.1", "ActPos_deg", "ActTorque_Nm"),
]  # fmt: skip


@VARIANTS
def test_each_column_is_paired_by_the_clock_of_its_words(number):
    """Or the two clocks are named; of other epochs, or the same, they are one."""
    rng = np.random.default_rng([12, number])
    clock, other, position, torque = STAMPED[number // 2]
    t = np.arange(0.0, 10.0, 1.0 / rng.uniform(200.0, 500.0))
    late = t + rng.uniform(0.02, 0.03)
    scale, second = (units.scale([named(c).unit or "s"], "time") for c in (clock, other))
    columns = {clock: t / scale, other: late / second, position: angle(t), torque: drive(late)}
    table = with_clocks(shuffled(rng, columns))
    names, _ = chosen(table)
    assert (names["time"], names["position"]) == (clock, position)
    if number // 2 > 7:
        assert not table.clocks
        (doubt,) = table.doubts([position, torque])
        assert all(name in doubt for name in (clock, other, position, torque))
        unit = {"column": clock, "unit": named(clock).unit or "s"}
        _, said = noted(lambda: configured(table, time=unit, position=position, torque=torque))
        assert doubt in said
    else:
        assert table.clocks == {position: clock, torque: other}
        time = {"column": clock, "unit": named(clock).unit or "s"}
        recording = configured(table, time=time, position=position, torque=torque)
        error = CURVATURE * (t[1] - t[0]) ** 2 / 8.0
        np.testing.assert_allclose(recording.torque, drive(recording.time), atol=error)
        np.testing.assert_allclose(recording.position, angle(recording.time), atol=1e-9)
    columns[other] = (t + (1e6 if number % 2 else 0.0)) / second
    table = with_clocks(shuffled(rng, columns))
    assert not table.clocks
    assert not table.unpaired


FOREIGN = [
    ("Zeit [s]", "Winkel [rad]", "Drehzahl [1/min]", "Drehmoment [Nm]"),
    ("Temps (ms)", "Angle mesuré (deg)", "Vitesse (rpm)", "Couple (mNm)"),
    ("tempo_ms", "angolo_deg", "giri_rpm", "coppia_Nm"),
    ("aika_us", "kulma_rad", "nopeus_rpm", "vääntö_Nm"),
    ("datetime", "winkel_deg", "rpm", "strom_mA"),
]  # fmt: skip


@VARIANTS
def test_a_unit_of_one_channel_needs_no_known_name(number):
    """In brackets, as a suffix or in a row of units; a known name is before it."""
    rng = np.random.default_rng([13, number])
    t, foreign = 0.004 * np.arange(1000), list(FOREIGN[number % 5])
    stamps = (pd.Timestamp("2026-03-02") + pd.to_timedelta(t, unit="s")).astype(str).to_numpy()
    scale = units.scale([named(foreign[0]).unit or "s"], "time")
    time = stamps.astype(object) if number % 5 == 4 else t / scale
    values = [time, angle(t), speed(t), drive(t)]
    if number == 0:
        table = Table(
            "log", ["a", "b", "c", "d"], values.__getitem__, units=["s", "rad", "rpm", "A"]
        )
        foreign = list(table.names)
    else:
        columns = dict(zip(foreign, values, strict=True))
        table = shuffled(rng, columns | {"Latenz [ms]": rng.random(t.size)})
    names, log = chosen(table)
    assert list(names.values()) == foreign
    assert all(unit for _, unit in log.chosen.values())
    extra = {"pos": angle(t), "torque": drive(t), "Temperatur [°C]": 20.0 + drive(t)}
    names, _ = chosen(shuffled(rng, dict(zip(foreign, values, strict=True)) | extra))
    assert (names["position"], names["torque"]) in (("pos", "torque"),)


@pytest.mark.parametrize("kind", ["mat", "json", "jsonl"])
def test_nested_objects_are_columns_by_their_paths(kind, tmp_path):
    t = 0.004 * np.arange(1000)
    late = t + 0.01
    content = {
        "log": {"enc": {"time": t, "q": angle(t)}, "drv": {"time": late, "tau": drive(late)}}
    }
    lists = {"log": {k: {n: x.tolist() for n, x in v.items()} for k, v in content["log"].items()}}
    path = tmp_path / f"log.{kind}"
    if kind == "mat":
        savemat(path, content)
    elif kind == "json":
        path.write_text(json.dumps(lists))
    else:
        rows = (
            {k: {n: x[i] for n, x in v.items()} for k, v in lists["log"].items()}
            for i in range(t.size)
        )
        path.write_text("\n".join(json.dumps({"log": row}) for row in rows))
    table = read_table(path, TableOptions())
    assert table.clocks == {"log.enc.q": "log.enc.time", "log.drv.tau": "log.drv.time"}
    names, _ = chosen(table)
    assert names == {"time": "log.enc.time", "position": "log.enc.q", "torque": "log.drv.tau"}
    np.testing.assert_array_equal(table.values("log.drv.tau"), drive(late))


# -- units, prefixes, and words

SPELLINGS = [
    ("torque", "Nmm", 1e-3), ("torque", "in-oz", 0.00706155181422604),
    ("torque", "lbs-ft", 1.3558179483314004), ("torque", "kg cm", 0.0980665),
    ("torque", "Ncm", 0.01), ("torque", "dNm", 0.1), ("torque", "daNm", 10.0),
    ("torque", "N.m", 1.0), ("torque", "mN·m", 1e-3), ("torque", "Newton meters", 1.0),
    ("angle", "Degrees", np.pi / 180.0), ("angle", "RAD", 1.0), ("angle", "Revs", 2.0 * np.pi),
    ("angular_speed", "DEG/S", np.pi / 180.0), ("angular_speed", "kRPM", 1e3 * np.pi / 30.0),
    ("angular_speed", "RPS", 2.0 * np.pi), ("angular_speed", "1/min", np.pi / 30.0),
    ("angular_speed", "rad s-1", 1.0), ("current", "Arms", 1.0), ("current", "AMPS", 1.0),
]  # fmt: skip
CHANNEL = {"angle": "position", "angular_speed": "velocity"}
CONSTANTS = [
    ("Nm/Arms", 1.0), ("V/krpm", 0.03 / np.pi), ("V/1000 rpm", 0.03 / np.pi), ("Ncm/A", 0.01),
    ("oz-in/A", 0.00706155181422604), ("lbf-in/A", 0.1129848290276167), ("kgf-cm/A", 0.0980665),
    ("N.m/A", 1.0), ("mNm/A", 1e-3), ("V s/rad", 1.0), ("in-oz/A", 0.00706155181422604),
]  # fmt: skip


@VARIANTS
def test_units_as_data_sheets_spell_them(number):
    kind, text, value = SPELLINGS[number]
    assert units.scale([text], kind) == pytest.approx(value, rel=1e-12)
    column = named(f"{CHANNEL.get(kind, kind)} [{text}]")
    assert units.scale([column.unit], kind) == pytest.approx(value, rel=1e-12)
    for constant, worth in CONSTANTS:
        assert units.scale([f"2 {constant}"], "torque_constant") == pytest.approx(2.0 * worth)


PREFIXES = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "c": 0.01, "d": 0.1, "da": 10.0,
            "h": 100.0, "k": 1e3, "": 1.0}  # fmt: skip
BASES = [("torque", "Nm", "torque"), ("iq", "A", "current"), ("voltage", "V", "voltage"),
         ("tau", "N_m", "torque"), ("effort", "N.m", "torque")]  # fmt: skip


@VARIANTS
def test_a_prefix_is_read_or_the_unit_left_open(number):
    signal, base, kind = BASES[number % 5]
    joint = JOINTS[number]
    for prefix, value in PREFIXES.items():
        column = named(f"{joint}_{signal}_{prefix}{base}")
        assert column.unit, prefix
        assert units.scale([column.unit], kind) == pytest.approx(value, rel=1e-12)
    # capital letters are any in a name in capitals, but of no joint
    for prefix in ("M", "G") if base == "Nm" else ("p", "x", "milli", "kilo_", "micro "):
        assert named(f"{joint}_{signal}_{prefix}{base}").unit == "", prefix


@VARIANTS
def test_a_word_is_no_unit(number):
    """Body parts and mechanisms, of which pint reads half as lengths, masses or energies."""
    joint = JOINTS[number]
    for signal in ("position", "velocity", "torque", "current", "angle", "effort", "v", "i", "t"):
        forms = ["{j}_{s}", "{s}_{j}", "{j}.{s}", "/{j}/{s}", "{s}[{j}]"]
        for form in forms if len(signal) > 1 else ():
            column = named(form.format(j=joint, s=signal))
            assert (column.unit, column.joint) == ("", joint), (form, signal)
        assert named(f"{signal}_{joint}").unit == ""


# -- values that no joint can have


def noted(act):
    """Return the measurement, and all that is said of it; None where it is refused."""
    try:
        recording = act()
    except BadInput as error:
        return None, str(error)
    said = (*recording.steps, *recording.warnings, *observe(recording, Processing()).warnings)
    return recording, " ".join(said)


@VARIANTS
def test_a_unit_of_time_that_is_wrong_is_named(number):
    rng = np.random.default_rng([7, number])
    rate = rng.choice([100.0, 250.0, 500.0, 1000.0])
    t = np.arange(0.0, rng.uniform(4.0, 60.0), 1.0 / rate)
    true, wrong = [("us", "ns"), ("ms", "us"), ("s", "ms"), ("ms", "s"), ("us", "ms")][number % 5]
    scale = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
    table = shuffled(rng, {"t": t / scale[true], "q": angle(t), "tau": drive(t)})
    _, said = noted(lambda: configured(
        table, time={"column": "t", "unit": wrong}, position="q", torque="tau"))  # fmt: skip
    assert "unit of time" in said
    names, log = chosen(shuffled(rng, {f"t_{wrong}": t / scale[true], "q": angle(t)}))
    assert names["time"] == f"t_{wrong}"
    assert log.chosen["time"][1] == ""
    assert log.problems
    assert not implausible(1.0 / rate, t[-1])


@VARIANTS
def test_counters_and_sign_bits(number):
    """A counter of n bits that wraps, and a current whose sign is a bit, with holes."""
    rng = np.random.default_rng([8, number])
    t = np.arange(0.0, 12.0, 1.0 / rng.uniform(200.0, 1000.0))
    bits = int(rng.choice([16, 32] if number % 2 else [12, 14, 24]))
    a_turn = int(rng.choice([1024, 4096, 2500]))
    counts = np.round(
        angle(t) / (2.0 * np.pi) * 2.0**bits * rng.uniform(1.5, 4.0) + rng.integers(50)
    )
    truth = (counts - counts[0]) * 2.0 * np.pi / a_turn
    raw = np.round(drive(t) * 300.0)
    key = {"twos_complement": 16} if number % 4 < 2 else {"sign_bit": 15}
    coded = np.where(raw < 0.0, raw + 65536.0 if number % 4 < 2 else 32768.0 - raw, raw)
    columns = {"t": t, "q": counts % 2.0**bits, "tau": coded}
    columns["q"][rng.random(t.size) < 0.01] = np.nan
    keys = {"time": "t", "position": {"column": "q", "unit": f"turn/{a_turn}"}}
    torque = {"column": "tau", "unit": "N m/300"}
    _, said = noted(lambda: configured(shuffled(rng, columns), **keys, torque=torque))
    assert " = ".join(map(str, *key.items())) in said
    recording = configured(shuffled(rng, columns), **keys, torque=torque | key)
    assert "unwrapped" in " ".join(recording.steps)
    rise = recording.position - recording.position[0]
    first = np.interp(recording.time[0], t, truth)
    np.testing.assert_allclose(
        rise, np.interp(recording.time, t, truth) - first, atol=np.ptp(truth) * 1e-3
    )
    np.testing.assert_allclose(recording.torque, drive(recording.time), atol=0.01)


@VARIANTS
def test_zeros_of_failed_reads_are_left_out(number):
    rng = np.random.default_rng([9, number])
    t = np.arange(0.0, 12.0, 1.0 / rng.uniform(100.0, 500.0))
    position = 3.0 + angle(t) + 1e-4 * rng.standard_normal(t.size)
    torque = drive(t) + 0.01 * rng.standard_normal(t.size)
    lost = rng.random(t.size) < rng.uniform(0.002, 0.05)
    lost[rng.integers(t.size)] = True
    q, tau = np.where(lost, 0.0, position), np.where(lost, 0.0, torque)
    recording, said = noted(
        lambda: configured(
            shuffled(rng, {"t": t, "q": q, "tau": tau}), time="t", position="q", torque="tau"
        )
    )
    assert f"in {lost.sum()} rows" in said
    np.testing.assert_allclose(recording.position, 3.0 + angle(recording.time), atol=0.02)
    np.testing.assert_allclose(recording.torque, drive(recording.time), atol=0.1)


@VARIANTS
def test_a_velocity_that_differs_in_factor_and_lateness(number):
    rng = np.random.default_rng([10, number])
    t = np.arange(0.0, 20.0, 1.0 / rng.choice([100.0, 200.0, 500.0]))
    factor = rng.choice([180.0 / np.pi, np.pi / 30.0, 0.5, 1.6, 2.0 * np.pi])
    late = rng.choice([-1.0, 1.0]) * rng.uniform(0.04, 0.09) * (number % 2)
    velocity = factor * speed(t - late) + 1e-3 * factor * rng.standard_normal(t.size)
    columns = {"t": t, "q": angle(t), "v": velocity, "tau": drive(t)}
    recording = configured(
        shuffled(rng, columns), time="t", position="q", velocity="v", torque="tau"
    )
    said = " ".join(observe(recording, Processing()).warnings)
    (printed,) = re.findall(r"is ([-\d.]+) times the differentiated", said)
    assert float(printed) == pytest.approx(factor, rel=0.02)
    assert ("after the " in said or "before the " in said) == bool(late)


@VARIANTS
def test_a_counter_that_wraps_at_any_number(number):
    """At 10 to 50 thousand, or a turn of another gear than its unit says; or it only jumps."""
    rng = np.random.default_rng([11, number])
    t = np.arange(0.0, 12.0, 1.0 / rng.uniform(200.0, 1000.0))
    size = float(rng.choice([10000, 20000, 36000, 50000, 360.0, 400.0]))
    truth = 0.4 * size * (angle(t) * rng.uniform(2.0, 4.0) + rng.random())
    truth = np.round(truth) if number % 2 else truth
    values = truth % size
    unit = f"turn/{rng.choice([1.7, 3.0, 4.0]) * size}"
    columns = {"t": t, "q": values, "tau": drive(t)}
    keys = {"time": "t", "position": {"column": "q", "unit": unit}, "torque": "tau"}
    recording, said = noted(lambda: configured(shuffled(rng, columns), **keys))
    assert f"jumps by {size:.6g} counts" in said
    raw = recording.position / units.scale([unit], "angle")
    np.testing.assert_allclose(raw - raw[0], truth - truth[0], atol=1e-6 * size)
    moved = truth + np.where(t > 6.0, 5.0 * np.ptp(truth), 0.0)
    columns["q"] = moved
    recording, said = noted(lambda: configured(shuffled(rng, columns), **keys))
    assert "in 1 rows" in said
    raw = recording.position / units.scale([unit], "angle")
    np.testing.assert_allclose(raw, moved, rtol=1e-9, atol=1e-9)


@VARIANTS
def test_a_sign_bit_of_a_large_torque_and_a_magnitude(number):
    rng = np.random.default_rng([12, number])
    t = np.arange(0.0, 12.0, 1.0 / rng.uniform(200.0, 500.0))
    torque = (drive(t) + np.sign(speed(t))) / 6.0
    bit = int(rng.choice([10, 12, 15]))
    raw = np.round(torque * rng.uniform(0.2, 0.95) * 2.0**bit + rng.normal(0.0, 2.0, t.size))
    full = 2.0 ** (bit + 1)
    key = f"twos_complement = {bit + 1}" if number % 2 else f"sign_bit = {bit}"
    coded = np.where(raw < 0.0, raw + full if number % 2 else full / 2.0 - raw, raw)
    keys = {"time": "t", "position": "q", "torque": "tau"}

    def said(values):
        return noted(
            lambda: configured(shuffled(rng, {"t": t, "q": angle(t), "tau": values}), **keys)
        )[1]

    assert key in said(coded)
    right = said(raw)
    assert "magnitude" not in right
    assert "sign_bit" not in right
    # a drive that only pulls, against gravity
    pulls = said(torque - 1.2 * torque.min())
    assert "magnitude" not in pulls
    assert "'tau'" in said(np.abs(torque)).split(": never negative")[0]


@VARIANTS
def test_numbers_that_stand_for_failed_reads(number):
    rng = np.random.default_rng([13, number])
    t = np.arange(0.0, 12.0, 1.0 / rng.uniform(100.0, 500.0))
    code = rng.choice([-999.0, 9999.0, 65535.0, -32768.0, -1000.0])
    lost = rng.random(t.size) < rng.uniform(0.004, 0.05)
    lost[[5, 200]] = True
    columns = {"t": t, "q": angle(t), "tau": drive(t)}
    key = ("q", "tau")[number % 2]
    columns[key] = np.where(lost, code, columns[key])
    recording, said = noted(
        lambda: configured(shuffled(rng, columns), time="t", position="q", torque="tau")
    )
    assert f"{code:.6g} between values far from it in {lost.sum()} rows" in said
    np.testing.assert_allclose(recording.position, angle(recording.time), atol=0.02)
    np.testing.assert_allclose(recording.torque, drive(recording.time), atol=0.1)


@VARIANTS
def test_a_signal_that_is_read_more_slowly(number):
    """Rows that hold a value or lie on a line to the next are none; steps of an encoder are."""
    rng = np.random.default_rng([14, number])
    rate, hold = rng.uniform(300.0, 1000.0), int(rng.integers(2, 9))
    t = np.arange(0.0, 12.0, 1.0 / rate)
    columns = {"t": t, "q": angle(t) if number % 2 else np.round(angle(t), 5), "tau": drive(t)}
    key, drawn = ("q", "tau")[number // 2 % 2], number // 4 % 2
    own = columns[key][np.arange(t.size) // hold * hold]
    columns[key] = np.interp(t, t[::hold], own[::hold]) if drawn else own
    keys = {"time": "t", "position": "q", "torque": "tau"}
    recording, said = noted(lambda: configured(shuffled(rng, columns), **keys))
    assert f"{'drawn through' if drawn else 'held over'} {hold} rows" in said
    assert recording.pace == pytest.approx(rate / hold)
    inner = slice(0, -2 * hold)
    error = CURVATURE * (hold / rate) ** 2 / 4.0 + 2e-5
    np.testing.assert_allclose(recording.position[inner], angle(recording.time)[inner], atol=error)
    np.testing.assert_allclose(recording.torque[inner], drive(recording.time)[inner], atol=error)
    columns["q"] = np.floor(np.arange(t.size) / hold)  # one step of an encoder each
    # and commands: levels of any size, and ramps to and fro
    columns["tau"] = rng.normal(size=t.size)[np.arange(t.size) // 200]
    recording, _ = noted(lambda: configured(shuffled(rng, columns), **keys))
    assert recording.pace is None
    columns["tau"] = np.abs((np.arange(t.size) % 400) - 200.0) / 100.0
    assert noted(lambda: configured(shuffled(rng, columns), **keys))[0].pace is None


@VARIANTS
def test_a_clock_that_steps_back_is_not_misplaced_rows(number):
    rng = np.random.default_rng([15, number])
    t = np.arange(0.0, 6.0, 1.0 / rng.uniform(100.0, 500.0))
    at = int(rng.integers(200, 400))
    stamps = t - (np.arange(t.size) >= at) * 0.4
    keys = {"time": "t", "position": "q", "torque": "tau"}
    columns = {"t": stamps, "q": angle(t), "tau": drive(t)}
    assert "split the file" in noted(lambda: configured(shuffled(rng, columns), **keys))[1]
    columns["t"] = t.copy()
    columns["t"][[at, at + 1]] = t[[at + 1, at]]
    assert "sort the rows" in noted(lambda: configured(shuffled(rng, columns), **keys))[1]


def test_stamps_named_by_their_signals():
    t, late = 0.002 * np.arange(3000), 0.003 * np.arange(2000) + 0.001
    cells = [t, angle(t), late, drive(late)]
    table = with_clocks(Table("log", ["q_t", "q", "tau_t", "tau"], cells.__getitem__))
    assert table.clocks == {"q": "q_t", "tau": "tau_t"}
    assert chosen(table)[0] == {"position": "q", "torque": "tau", "time": "q_t"}


def test_the_joint_of_which_most_is_recorded():
    t = 0.002 * np.arange(3000)
    electrical = 7.0 * angle(t) % (2.0 * np.pi)
    columns = {"t": t, "theta_el": electrical, "theta_m": angle(t), "omega_m": speed(t)}
    columns["i_q"] = drive(t)
    assert chosen(Table("log", list(columns), list(columns.values()).__getitem__))[0] == {
        "position": "theta_m", "velocity": "omega_m", "current": "i_q", "time": "t",
    }  # fmt: skip


@pytest.mark.parametrize(("count", "period", "is_wrap"), [(9000, 7.35, False), (9000, 60.0, True)])
def test_a_clock_that_starts_again_is_no_wrap(count, period, is_wrap):
    t = 0.01 * np.arange(count)
    t = t[(t < 2.0 * period)]
    cells = [t % period, angle(t), drive(t)]
    table = Table("log", ["t", "q", "tau"], cells.__getitem__)
    if is_wrap:
        recording = configured(table, time="t", position="q", torque="tau")
        np.testing.assert_allclose(recording.position, angle(recording.time), atol=1e-6)
    else:
        with pytest.raises(BadInput, match="back in time"):
            configured(table, time="t", position="q", torque="tau")


def test_a_drive_that_answers_too_slowly_is_named():
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 9.0, 1.0 / 350.0)
    answers = np.cumsum(rng.choice([3, 3, 3, 9], t.size // 4))
    at = answers[np.searchsorted(answers, np.arange(t.size), "right") - 1]
    at = np.where(np.arange(t.size) < answers[0], 0, np.minimum(at, t.size - 1))
    table = Table("log", ["t", "q", "tau"], [t, angle(t[at]), drive(t[at])].__getitem__)
    with pytest.raises(BadInput, match=r"held for long.*steady = true"):
        observe(configured(table, time="t", position="q", torque="tau"), Processing())


def test_seconds_and_their_parts_of_ros_1():
    t = np.round(0.002 * np.arange(3000), 6)
    columns = {"secs": 1.7e9 + t // 1.0, "nsecs": np.round(t % 1.0 * 1e9), "q": angle(t)}
    columns["tau"] = drive(t)
    table = with_clocks(Table("log", list(columns), list(columns.values()).__getitem__))
    assert chosen(table)[0]["time"] == "secs + nsecs"
