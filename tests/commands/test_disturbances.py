"""Spans that a hand disturbed, found and told; and recordings in which nothing did."""

import json

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

import bayesfric as bf
from tests.recordings.samples import has

from .bench import cases

T = 0.002 * np.arange(8000)


def model(torque_more=0.0, seed=1, envelope=1.0, **keys):
    """A pendulum that is moved, with something more in the torque."""
    joint = bf.Joint.preset("servo-pendulum")
    values = {"motor.inertia": 0.05, "motor.coulomb": 0.2, "motor.viscous": 0.05,
              "load.first_moment": 0.1}  # fmt: skip
    q = 0.9 * np.sin(2 * np.pi * 0.4 * T) + 0.3 * np.sin(2 * np.pi * 1.1 * T + 1)
    q = q * envelope
    v = np.gradient(q, T)
    torque = values["motor.inertia"] * np.gradient(v, T) + values["motor.coulomb"] * np.sign(v)
    torque += values["motor.viscous"] * v + 9.81 * values["load.first_moment"] * np.sin(q)
    torque += 0.02 * np.random.default_rng(seed).standard_normal(T.size) + torque_more
    return bf.Model(joint, bf.Recording.from_arrays(T, q, torque, name="bench", **keys))


def push(start, stop, size=1.0):
    return size * np.where(
        (start < T) & (stop > T), np.sin(np.pi * (T - start) / (stop - start)), 0
    )


@pytest.mark.parametrize("span", [(3.0, 4.2), (9.1, 9.8)])
def test_a_push_is_found_where_it_was(span):
    (found,) = model(push(*span)).disturbances()
    assert found.recording == "bench"
    assert abs(found.start - span[0]) < 0.35
    assert abs(found.stop - span[1]) < 0.35
    assert found.times > 7.0
    # the hand's 1 N m, less what an average over 0.4 s takes, give or take all friction there is
    assert 0.85 < found.torque < 1.0 + 0.2 + 0.05 * 5.0
    # and it is gone where it is left out, by the span that is proposed
    spans = [[found.start, found.stop]]
    assert model(push(*span), exclude=spans).disturbances() == []


def swung(hand=0.0, seed=1):
    """A pendulum simulated with its losses, which a hand pushes besides the drive."""
    joint = bf.Joint.preset("servo-pendulum")
    values = {"motor.inertia": 0.05, "motor.coulomb": 0.2, "motor.viscous": 0.05,
              "load.first_moment": 0.1, "gearbox.load": 0.2, "load.gravity_angle": 0.0}  # fmt: skip
    drive = 0.7 * np.sin(2 * np.pi * 0.4 * T) + 0.3 * np.sin(2 * np.pi * 0.13 * T + 1)
    q, v = np.zeros_like(T), np.zeros_like(T)
    for i in range(T.size - 1):
        act = drive[i] + (hand[i] if np.ndim(hand) else hand)
        weight = 9.81 * values["load.first_moment"] * np.sin(q[i])
        free = act - weight - values["motor.viscous"] * v[i]
        faster = v[i] + 0.002 * free / values["motor.inertia"]
        # dry friction takes no more than what stops it
        most = 0.002 * (0.2 + 0.2 * abs(weight)) / values["motor.inertia"]
        v[i + 1] = np.sign(faster) * max(abs(faster) - most, 0.0)
        q[i + 1] = q[i] + 0.002 * v[i + 1]
    noise = np.random.default_rng(seed)
    step = 2 * np.pi / 8192
    q = step * np.round(q / step)
    measured = drive + 0.02 * noise.standard_normal(T.size)
    return bf.Model(joint, bf.Recording.from_arrays(T, q, measured, name="swung")), v


def test_a_jolt_in_a_reversal_is_found_where_it_was():
    _, v = swung()
    # where the speed changes sign, with the joint not at rest for long
    turns = T[1:][np.sign(v[1:]) * np.sign(v[:-1]) <= 0.0]
    turn = turns[np.argmin(np.abs(turns - 8.0))]
    hand = np.where((turn - 0.05 <= T) & (turn + 0.2 > T), 8.0, 0.0)
    (found,) = swung(hand)[0].disturbances()
    assert abs(found.start - (turn - 0.05)) < 0.05
    assert abs(found.stop - (turn + 0.2)) < 0.05
    # losses oppose the hand by Coulomb's, the load's and the viscous one at the speed it makes
    speed = 8.0 / 0.05 * 0.25
    assert abs(found.torque - 8.0) < 0.2 + 0.2 * 1.0 + 0.05 * speed


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_friction_is_no_part_of_what_a_jolt_is_told_to_be(way):
    """The hand's 4 N m for 0.4 s, along friction's torque or against it: at least so much."""
    middle = 5.0  # the joint moves one way about then: friction takes 0.2 to 0.4 N m
    hand = way * 4.0 * gaussian_filter1d((np.abs(T - middle) < 0.2).astype(float), 10.0)
    (found,) = model(hand).disturbances()
    # as found, noise averaged over 50 samples has an sd of 0.003 N m
    assert 4.0 - 2.0 * (0.2 + 0.05 * 5.0) < found.torque < 4.0 + 0.02


@pytest.mark.parametrize("seed", range(3))
def test_friction_in_reversals_is_no_jolt(seed):
    assert swung(seed=seed)[0].disturbances() == []


def test_two_pushes_are_two():
    found = model(push(3.0, 4.0) - push(10.0, 11.0)).disturbances()
    assert [round(0.5 * (one.start + one.stop)) in (3, 4, 10, 11) for one in found] == [True, True]


@pytest.mark.parametrize("seed", range(5))
def test_noise_is_no_push(seed):
    assert model(seed=seed).disturbances() == []


@pytest.mark.parametrize("seed", range(3))
def test_a_slow_push_among_larger_noise_is_found(seed):
    """Half a second of what no single output tells from noise for certain."""
    slow = gaussian_filter1d(np.random.default_rng(seed).standard_normal(T.size), 8.0)
    slow *= 0.15 / slow.std()
    pushed = 0.7 * ((T > 6.0) & (T < 6.5))
    found = model(slow + pushed).disturbances()
    assert model(slow).disturbances() == []
    (span,) = found
    assert abs(span.start - 6.0) < 0.35
    assert abs(span.stop - 6.5) < 0.35


def test_what_the_model_lacks_everywhere_is_no_push():
    """A ripple in the torque, as large as a push, all the time."""
    assert model(0.3 * np.sin(40.0 * T)).disturbances() == []


def test_check_proposes_what_to_exclude(bench):
    made = model(push(3.0, 4.2))
    measured = made.recordings[0]
    columns = (measured.time, measured.position, measured.torque)
    rows = np.stack(columns, axis=1).tolist()
    bench.recording(["t,q,tau", *(",".join(map(repr, row)) for row in rows)])
    bench.edit('preset = "motor-axis"', 'preset = "servo-pendulum"')
    (doubt,) = [
        one
        for one in json.loads(bench.run("check", "c.toml", "--json").out)["doubts"]
        if one["kind"] == "pushed"
    ]
    ((start, stop),) = doubt["exclude"]
    text = bench.run("check", "c.toml").out
    has(text, "WARNING: in run the torque is off for a while by at least "
        f"{doubt['torque']:.2g} N m at its worst, {doubt['times']:.0f} times as much as usual",
        f"exclude = [[{start:.1f}, {stop:.1f}]]")  # fmt: skip


def test_check_says_which_keys_leave_rests_and_pushes_out(bench):
    """The joint begins to move at 3 s, comes to rest at 13 s, and is pushed between."""
    going = np.clip((T - 3.0) / 1.0, 0, 1) ** 3 * np.clip((13.0 - T) / 1.0, 0, 1) ** 3
    made = model(push(7.0, 8.2), envelope=going).recordings[0]
    rows = np.stack((made.time, made.position, made.torque), axis=1).tolist()
    bench.recording(["t,q,tau", *(",".join(map(repr, row)) for row in rows)])
    bench.edit('preset = "motor-axis"', 'preset = "servo-pendulum"')
    told = json.loads(bench.run("check", "c.toml", "--json").out)["leave_out"]["run"]
    # a motion that begins with the cube of time is below a thousandth of its range for a tenth
    assert told["start"] == pytest.approx(3.1, abs=0.1)
    assert told["stop"] == pytest.approx(12.9, abs=0.1)
    ((start, stop),) = told["exclude"]
    assert (start, stop) == pytest.approx((7.0, 8.2), abs=0.4)
    text = bench.run("check", "c.toml").out
    keys = [f"start = {told['start']}", f"stop = {told['stop']}", f"exclude = [[{start}, {stop}]]"]
    has(text.split("[[recordings]]")[1], *keys)
    # with these keys there is nothing more to leave out
    bench.edit("[[recordings]]", "[[recordings]]\n" + "\n".join(keys))
    assert json.loads(bench.run("check", "c.toml", "--json").out)["leave_out"] == {}


# -- real recordings

# s, free of a hand as found by eye (../shared/data/README.md)
FREE = {
    "es500": [(0.0, 7.4)],
    "es1kg": [(0.0, 8.5), (12.7, 16.8)],
    "sac": [(0.0, 10.0)],
    "ilqr": [(3.4, 10.0)],
    "ddp": [(0.0, 6.0)],
    "dircol": [(0.0, 3.5)],
}


@pytest.mark.parametrize(
    ("file", "pushes"),
    cases(
        ("es500", "es500", 2),
        ("es1kg", "es1kg", 1),
        ("sac", "sac", 4),
        ("ilqr", "ilqr", 2),
        ("ddp", "ddp", 0),
        ("dircol", "dircol", 0),
    ),
)
def test_spans_agree_with_those_found_by_hand(real_data, file, pushes):
    one = bf.Recording.from_file(
        real_data / "dfki-pendulum" / f"{file}.csv", time="time", position="position",
        torque="torque",
    )  # fmt: skip
    found = bf.Model(bf.Joint.preset("servo-pendulum"), one).disturbances()
    assert len(found) == pushes
    for span in found:
        for start, stop in FREE[file]:
            # a window's width is what an average of residuals carries over
            assert min(span.stop, stop) - max(span.start, start) < 0.3


@pytest.mark.parametrize(
    ("file", "strong"),
    cases(("es500", "es500", [(15.95, 16.25)]), ("sac", "sac", [(18.0, 18.2), (22.0, 22.2)])),
)
def test_pushes_that_start_in_a_rest_are_found(real_data, file, strong):
    """With the measured speed, as users give it: nothing is compared there."""
    one = bf.Recording.from_file(
        real_data / "dfki-pendulum" / f"{file}.csv", time="time", position="position",
        velocity="velocity", torque="torque",
    )  # fmt: skip
    found = bf.Model(bf.Joint.preset("servo-pendulum"), one).disturbances()
    for start, stop in strong:
        (span,) = [one for one in found if one.start < stop and start < one.stop]
        assert abs(span.start - start) < 0.06
        assert abs(span.stop - stop) < 0.06
    # slow ones, that no rest hides, are told besides
    for span in found:
        for start, stop in FREE[file]:
            assert min(span.stop, stop) < max(span.start, start)


@pytest.mark.parametrize("velocity", [False, True])
def test_no_span_in_windows_free_of_a_hand(real_data, velocity):
    """A controller makes their torque follow the speed: no robust fit shall take that for all."""
    windows = [(file, *window) for file, found in FREE.items() for window in found]
    recordings = [
        bf.Recording.from_file(
            real_data / "dfki-pendulum" / f"{file}.csv", time="time", position="position",
            torque="torque", start=start, stop=stop, name=f"{file} from {start}",
            **({"velocity": "velocity"} if velocity else {}),
        )
        for file, start, stop in windows
    ]  # fmt: skip
    assert bf.Model(bf.Joint.preset("servo-pendulum"), recordings).disturbances() == []


def test_no_span_in_recordings_that_nobody_touched(real_data):
    knee = bf.Joint.preset("servo-pendulum")
    for path in sorted((real_data / "xl330-pendulum").glob("*.json")):
        one = bf.Recording.from_file(
            path, time="timestamp", position="position", torque_constant="0.354 N m/A",
            resistance="3.4 ohm", voltage={"column": "load", "unit": "V/885",
                                           "twos_complement": 16, "times": "input_volts"},
        )  # fmt: skip
        assert bf.Model(knee, one).disturbances() == [], path.name
    for name in ("DATA_EMPS", "DATA_EMPS_PULSES"):
        one = bf.Recording.from_file(
            real_data / "emps" / f"{name}.mat", time="t", position="qm", torque="vir"
        )
        assert bf.Model(bf.Joint.preset("motor-axis"), one).disturbances() == []
    arm = bf.Recording.from_file(
        real_data / "ur10e-joint2" / "joint_2.csv", time=1, position=3, velocity=9, current=15,
        torque_constant="10.6956 N m/A",
    )  # fmt: skip
    assert bf.Model(knee, arm).disturbances() == []


def test_check_says_where_it_did_not_look_for_a_push():
    """Half of the recording at rest: what pushes there, static friction takes."""
    held = np.clip(8.0 - T, 0.0, 1.0)
    checked = bf.check(model(envelope=held))
    (seconds,) = checked.found["no_push_told"].values()
    # the rest, and what is slower than the dead zone beside it
    assert 7.5 < seconds < 9.5
    assert "not looked for where the joint rests or is nearly still" in checked.text()
    assert f"{seconds:.3g} of 16 s of bench" in checked.text()
    # a joint that moves all the time is looked at all the time, but for its ends and reversals
    checked = bf.check(model())
    assert checked.found["no_push_told"]["bench"] < 0.5


@pytest.mark.parametrize(("factor", "few"), [(150, True), (25, False)])
def test_few_outputs_are_told_with_how_long_would_do(factor, few):
    (one,) = model().recordings
    again = bf.Recording.from_arrays(one.time, one.position, one.torque, name="bench")
    joint = bf.Joint.preset("servo-pendulum")
    checked = bf.check(bf.Model(joint, again, processing={"decimate": factor}))
    found = [one for one in checked.found["doubts"] if one["kind"] == "few"]
    assert bool(found) is few
    assert ("too few to look for the model's error" in checked.text()) is few
    if found:
        (one,) = found
        (o,) = [r["settings"]["n_outputs"] for r in checked.found["recordings"]]
        assert one["outputs"] == o < one["wanted"] == 8 * one["parameters_free"]
        assert one["seconds"] == pytest.approx(16.0 * one["wanted"] / o, rel=0.01)
