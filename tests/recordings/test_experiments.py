"""Experiments other than a motion under a recorded torque, with true values as oracles."""

import numpy as np
import pandas as pd
import pytest
from pydantic import ValidationError

import bayesfric as bf
from bayesfric.base.errors import BadInput
from bayesfric.diagnostics.candidates import BY_NAME
from bayesfric.recordings.checks import fresh_rows
from bayesfric.recordings.source import Torque
from tests.axis import swing

PENDULUM = {"motor.inertia": 0.025, "motor.coulomb": 0.02, "motor.viscous": 0.01}
AXIS = {"motor.inertia": 0.02, "motor.viscous": 0.1, "motor.coulomb": 0.3}


def assert_holds(model, truth, *, relative=0.0):
    (estimate,) = model.estimates(["input-error"])
    for name, value in truth.items():
        row = estimate[name]
        assert row.determined, name
        assert abs(row.value - value) < 4.0 * row.larger_sd + relative * value, name


def axis_torque(qd, qdd, truth, rng):
    torque = truth["motor.inertia"] * qdd + truth["motor.viscous"] * qd
    return torque + truth["motor.coulomb"] * np.sign(qd) + 0.003 * rng.standard_normal(qd.size)


# --- a number in place of a column --------------------------------------------------------------


def free_swing(step=1e-4, every=100, end=6.0):
    """Integrate a falling pendulum by semi-implicit Euler, of which a sample is every hundredth."""
    q, v, out = 1.2, 0.0, []
    j, c, b = PENDULUM.values()
    for k in range(int(end / step)):
        if k % every == 0:
            out.append(q)
        v -= step / j * (0.14 * 9.80665 * np.sin(q) + b * v + c * np.tanh(v / 1e-3))
        q += step * v
    return np.arange(len(out)) * step * every, np.array(out)


def test_a_motor_that_is_off_leaves_gravity_as_the_known_torque():
    time, q = free_swing()
    q += 1e-5 * np.random.default_rng(3).standard_normal(q.size)
    recording = bf.Recording.from_arrays(time, q, 0)
    pendulum = bf.Joint.preset("servo-pendulum")
    # the step of the integration is 0.1 % of the shortest time constant
    model = bf.Model(pendulum, recording, priors={"load.first_moment": 0.14})
    assert_holds(model, PENDULUM, relative=0.005)
    assert not any(row.determined for row in model.estimates(["least-squares"])[0].values)
    with pytest.raises(BadInput, match="first_moment"):
        bf.Model(pendulum, recording)


LIFT = {"motor.inertia": 2.0, "motor.viscous": 3.0, "motor.coulomb": 1.0, "offset": 0.5}
CONSTANTS = {"torque_constant": "2 N/A", "resistance": "1 ohm"}


@pytest.mark.parametrize("by", ["voltage", "column of voltages", "torque"])
def test_a_constant_input_moves_a_joint(by):
    time, recordings = np.arange(300) * 0.01, []
    j, b, c, offset = LIFT.values()
    brake = 0.0 if by == "torque" else 4.0  # kt²/R
    for volts in (7.0, 4.0, -5.0, -3.0):
        # closed form from rest; the measured torque holds the offset
        rate = (b + brake) / j
        final = (2.0 * volts - c * np.sign(volts) - offset) / (b + brake)
        speed = final * (1.0 - np.exp(-rate * time))
        position = final * (time - (1.0 - np.exp(-rate * time)) / rate)
        speed += 1e-4 * np.random.default_rng(4).standard_normal(time.size)
        drive = {"voltage": f"{volts} V"} | CONSTANTS
        if by == "column of voltages":
            drive["voltage"] = np.full(time.size, volts)
        if by == "torque":
            drive = {"torque": f"{2.0 * volts} N"}
        keys = {"velocity": speed, "name": f"at {volts:g} V"} | drive
        recordings.append(bf.Recording.from_arrays(time, position, **keys))
    joint = bf.Joint(
        [bf.Element("motor", inertia=True, coulomb="symmetric", viscous=True, motion="linear")],
        load=bf.Load(motion="linear"),
        offset=True,
    )
    model = bf.Model(joint, recordings)
    assert_holds(model, LIFT, relative=1e-3)
    # a delay of the back-EMF is J/(kt²/R) times an inertia: it must not be put in
    assert not [x for x in model.explain().applicable if x.kind == "delay"]


def test_a_current_that_never_changes_is_quoted_as_recorded():
    time = np.arange(300) * 0.01
    keys = {"current": np.full(300, 18.0), "torque_constant": "0.055 N m/A"}
    units = {"current": "mA"}
    recording = bf.Recording.from_arrays(time, np.sin(3.0 * time), units=units, **keys)
    with pytest.raises(BadInput) as caught:
        bf.Model(bf.Joint.preset("motor-axis"), recording)
    assert "18" in caught.value.problem.split()


@pytest.mark.parametrize(
    "torque", [{"value": 2.0}, {"column": "tau", "unit": "N m", "value": 0}, {"column": "tau"}, {}]
)
def test_a_number_needs_its_unit_and_no_column(torque):
    with pytest.raises(ValidationError):
        Torque.model_validate(torque)
    assert Torque.model_validate("-2 N m").value == "-2 N m"


# --- velocity without position ------------------------------------------------------------------


def speed_alone(**keys):
    time, rng = np.arange(1500) * 0.01, np.random.default_rng(5)
    _, qd, qdd = swing(time, ((0.3, 1.0), (0.7, 0.3), (1.3, 0.1)))
    torque = axis_torque(qd, qdd, AXIS, rng)
    speed = qd + 0.003 * rng.standard_normal(time.size)
    return bf.Recording.from_arrays(time, None, torque, velocity=speed, **keys)


def test_speed_alone_determines_all_but_terms_of_the_position():
    model = bf.Model(bf.Joint.preset("motor-axis"), speed_alone())
    assert_holds(model, AXIS)
    kinds = model.explain().kinds
    assert kinds
    assert not any(BY_NAME[kind].of_position for kind in kinds if kind in BY_NAME)


def test_speed_alone_beside_a_recording_with_its_position():
    time, rng = np.arange(1500) * 0.01, np.random.default_rng(5)
    q, qd, qdd = swing(time, ((0.3, 1.0), (0.7, 0.3), (1.3, 0.1)))
    torque = axis_torque(qd, qdd, AXIS, rng) + 0.05 * np.sin(q)
    recordings = [bf.Recording.from_arrays(time, q, torque, velocity=qd), speed_alone(name="b")]
    model = bf.Model(bf.Joint.preset("motor-axis"), recordings)
    assert "gravity" in model.explain().kinds


@pytest.mark.parametrize(
    ("load", "added"),
    [({"first_moment": True}, {}), ({"spring": True}, {}), ({}, {"added_mass": 1, "radius": 0.1})],
)
def test_terms_of_the_position_are_refused(load, added):
    motor = bf.Element("motor", inertia=True, coulomb="symmetric", viscous=True)
    with pytest.raises(BadInput):
        bf.Model(bf.Joint([motor], load=bf.Load(**load)), speed_alone(**added))


# --- points at constant speed -------------------------------------------------------------------

SPEEDS = np.array([0.2, 0.5, 1.0, 2.0, 3.0, 5.0, 8.0])
SPEEDS = np.concatenate([-SPEEDS[::-1], SPEEDS])
FRICTION = {"motor.viscous": 0.1, "motor.coulomb": 0.3}


def friction_curve(rng, *, sd=0.007, more=()):
    speed = np.append(SPEEDS, more)
    torque = 0.1 * speed + 0.3 * np.sign(speed) + sd * rng.standard_normal(speed.size)
    torque[SPEEDS.size :] += 100.0  # at rest friction may be anything
    return bf.Recording.from_arrays(None, None, torque, velocity=speed, steady=True)


def test_points_at_constant_speed_determine_friction_and_no_inertia():
    squares = {name: [] for name in FRICTION}
    rng = np.random.default_rng(6)
    for _ in range(40):
        model = bf.Model(bf.Joint.preset("motor-axis"), friction_curve(rng, more=[0.0, 0.0]))
        (estimate,) = model.estimates(["least-squares"])
        assert not estimate["motor.inertia"].determined
        for name, value in FRICTION.items():
            squares[name].append(((estimate[name].value - value) / estimate[name].sd) ** 2)
    # of Student's t with 11 degrees of freedom: mean 11/9, standard deviation 2.1
    for name, square in squares.items():
        assert abs(np.mean(square) - 11.0 / 9.0) < 4.0 * 2.1 / 40**0.5, name


def test_few_points_are_checked_as_any_recording():
    model = bf.Model(bf.Joint.preset("motor-axis"), friction_curve(np.random.default_rng(7)))
    explanation = model.explain()
    assert explanation.reason is None
    assert not explanation.findings
    with pytest.raises(BadInput):
        model.estimates(["output-error"])


@pytest.mark.parametrize(
    "wrong", [{"rate": 10}, {"start": 1}, {"torque": None}, {"velocity": None}]
)
def test_steady_points_have_speed_and_torque_alone(wrong):
    keys = {"time": None, "position": None, "torque": SPEEDS, "velocity": SPEEDS, "steady": True}
    with pytest.raises(BadInput):
        bf.Recording.from_arrays(**keys | wrong)


# --- what a constant torque is a share of -------------------------------------------------------


def test_a_sensor_that_reads_too_much_hints_at_an_offset():
    rng, time = np.random.default_rng(8), np.arange(2000) * 0.01
    q, qd, qdd = swing(time, ((0.2, 0.5), (0.6, 0.3), (1.4, 0.1)))
    load = 8.0 * np.sin(2.0 * np.pi * 0.37 * time)
    rotor = 0.6 * qdd + 6.0 * qd + 4.0 * np.sign(qd)
    torque = rotor - load + 0.05 * rng.standard_normal(time.size)
    recording = bf.Recording.from_arrays(time, q, torque, load_torque=load + 0.6)
    motor = bf.Element("motor", inertia=True, coulomb="symmetric", viscous=True)
    model = bf.Model(bf.Joint([motor], load=bf.Load()), recording)
    (finding, *_) = model.explain().findings
    assert finding.hint == "mechanism.offset = true"


@pytest.mark.parametrize("level", [0.0, 3.0])
def test_what_is_left_is_a_share_of_the_torque(level):
    rng, time = np.random.default_rng(9), np.arange(2000) * 0.01
    torque = level + 0.3 + 0.1 * 0.7 + 0.02 * rng.standard_normal(time.size)
    keys = {"sampling": {"max_steps": 200}, "self_check": {"recordings": 0}}
    recording = bf.Recording.from_arrays(time, 0.7 * time, torque)
    result = bf.Model(bf.Joint.preset("motor-axis"), recording, **keys).fit()
    noise = result.summary.fit.residual_rms
    mean = level + 0.37
    assert result.summary.verdict.left == pytest.approx(noise / np.hypot(mean, noise), rel=0.01)


# --- signs and repeats --------------------------------------------------------------------------

SERVO = {"motor.inertia": 0.05, "motor.viscous": 0.3, "motor.coulomb": 0.5}


def test_a_current_signed_by_braking_is_named_and_mended():
    rng, time = np.random.default_rng(10), np.arange(3000) * 0.005
    q, qd, qdd = swing(time, ((0.2, 0.8), (0.7, 0.4), (2.5, 0.2)))
    current = axis_torque(qd, qdd, SERVO, rng) * np.sign(qd)
    frame = {"time": time, "position": q, "velocity": qd, "current": current}
    keys = {"time": "time", "position": "position", "velocity": "velocity"}

    def model(**sign):
        column = {"column": "current", "unit": "A", "torque_constant": "1 N m/A", **sign}
        recording = bf.Recording.from_dataframe(pd.DataFrame(frame), current=column, **keys)
        return bf.Model(bf.Joint.preset("motor-axis"), recording)

    (finding, *_) = model().explain().findings
    assert finding.kind == "current_column"
    assert 'sign = "by-speed"' in finding.shape
    assert_holds(model(sign="by-speed"), SERVO)


@pytest.mark.parametrize("key", ["time", "position", "voltage"])
def test_only_torque_and_current_are_signed_by_speed(key):
    keys = {"time": "t", "position": "q", key: {"column": "x", "unit": "SI", "sign": "by-speed"}}
    if key != "voltage":
        keys["torque"] = "tau"
    with pytest.raises(BadInput):
        bf.Recording.from_file("none.csv", **keys)


def test_a_negative_torque_constant_is_a_sign():
    keys = {"current": np.ones(9), "torque_constant": "-0.055 N m/A"}
    with pytest.raises(BadInput) as caught:
        bf.Recording.from_arrays(np.arange(9.0), np.ones(9), **keys)
    assert "sign = -1" in caught.value.hint


def held(x, rows):
    return x[np.arange(x.size) // rows * rows]


@pytest.mark.parametrize("rows", [1, 5])
def test_values_that_are_held_over_rows_count_once(rows):
    rng, time = np.random.default_rng(11), np.arange(9000) / 350.0
    q, qd, qdd = swing(time, ((0.2, 0.8), (0.5, 0.4), (1.1, 0.15)))
    torque = axis_torque(qd, qdd, AXIS, rng)
    recording = bf.Recording.from_arrays(time, held(q, rows), held(torque, rows))
    model = bf.Model(bf.Joint.preset("motor-axis"), recording)
    assert_holds(model, AXIS)
    assert model.recordings[0].time.size == time.size // rows


def test_held_rows_of_speed_and_torque_are_steady_points():
    """Each answer counts once, and speeds of a step or two are a standstill."""
    rng, step = np.random.default_rng(13), 0.0147
    speed = np.repeat(rng.uniform(-1.0, 1.0, 600), 4) * (np.arange(2400) % 8 < 4)
    speed = step * np.round(speed / step + np.repeat(rng.integers(-1, 2, 600), 4))
    friction = np.where(np.abs(speed) > 3.5 * step, 0.1 * np.sign(speed) + 0.05 * speed, 0.0)
    torque = friction + np.repeat(0.004 * rng.standard_normal(600), 4)
    recording = bf.Recording.from_arrays(None, None, torque, velocity=speed, steady=True)
    model = bf.Model(bf.Joint.preset("motor-axis"), recording)
    assert_holds(model, {"motor.coulomb": 0.1, "motor.viscous": 0.05})
    assert model.observations[0].filter.n_outputs == np.sum(np.abs(speed[::4]) > 3.5 * step)


def test_a_standstill_and_coarse_steps_are_no_held_rows():
    rng, time = np.random.default_rng(12), np.arange(2000) * 0.01
    q = 0.02 * np.round(np.sin(0.3 * time) / 0.02)
    torque = 0.05 * np.round(np.cos(0.3 * time) / 0.05)
    assert fresh_rows([q, torque]) is None
    assert fresh_rows([q, rng.standard_normal(q.size)]) is None
    still = np.where(time > 5.0, held(np.sin(time), 4), 0.0)
    rows, lasting, hold = fresh_rows([still, 2.0 * still])
    assert (hold, np.diff(rows).max()) == (4, 4)
    assert np.array_equal(lasting, (time[rows] > 0.0) & (time[rows] <= 5.0))


def test_too_few_outputs_name_what_took_them():
    time = np.arange(400) * 0.01
    burst = np.clip(time - 1.8, 0.0, 0.3)
    recording = bf.Recording.from_arrays(time, burst, np.cos(9.0 * time), rate=None)
    with pytest.raises(BadInput) as caught:
        bf.Model(bf.Joint.preset("motor-axis"), recording)
    assert "dead_zone" in str(caught.value)


def test_a_ripple_at_constant_speeds_is_cogging_and_no_fault():
    """With this noise the torque constant explains it a little better."""
    recordings, time = [], np.arange(600) * 0.03
    for k, speed in enumerate((0.9, 1.4, -0.9, -1.4)):
        q = speed * time + 0.2 * k
        noise = 0.004 * np.random.default_rng(500 + k).standard_normal(time.size)
        torque = 0.22 + 0.05 * np.sign(speed) + 7e-4 * speed + 0.0012 * np.sin(3.0 * q) + noise
        recordings.append(bf.Recording.from_arrays(time, q, torque))
    (finding, *_) = bf.Model(bf.Joint.preset("motor-axis"), recordings).explain().findings
    assert finding.hint == "mechanism.elements.motor.cogging = [3]"
