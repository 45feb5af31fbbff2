"""The delay that recordings show: right where there is one, nothing where there is none."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import bayesfric as bf
from bayesfric.base.errors import BadInput
from bayesfric.estimates.least_squares import least_squares
from bayesfric.estimates.processing import settled_delay
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.experiment import current_loop, multisine
from bayesfric.mechanism.forward import follow, simulate
from bayesfric.mechanism.joint import PRESETS
from bayesfric.recordings.measurement import Law
from tests.axis import AXIS, VALUES, recording_of

RATE, FINE = 500.0, 20
LATE = replace(AXIS, offset=True, delay=True)


def bench(late, seed, duration=10.0):
    """SIMULATED: finely, then sampled with the position some samples late and in counts."""
    rng = np.random.default_rng(seed)
    step = 1.0 / (RATE * FINE)
    time = np.arange(round((duration + 0.2) / step)) * step
    command = 2.0 * multisine(time, 1.0, (0.31, 0.73, 1.37, 2.9, 5.3), seed=seed)
    torque = current_loop(command, step, 0.003)
    motion = simulate(AXIS, AXIS.vector(VALUES), torque, step, substeps=1)
    stamps = np.arange(round(duration * RATE)) / RATE + 0.1
    position = np.interp(stamps - late / RATE, time, motion.q)
    position = np.round(position * 4096 / (2 * np.pi)) * 2 * np.pi / 4096
    noise = 0.05 * rng.standard_normal(stamps.size)
    return bf.Recording.from_arrays(
        stamps - 0.1, position, np.interp(stamps, time, torque) + noise, name=f"bench-{seed}"
    )


def by_totals(model):
    chain = replace(model.chain, delay=True)
    pairs = list(zip(model.recordings, model.observations, strict=True))
    return settled_delay(pairs, lambda observations: least_squares(chain, observations), chain)


@pytest.mark.parametrize("late", [0.3, 2.0, -1.0])
def test_it_is_found_within_a_tenth(late):
    assert by_totals(bf.Model(AXIS, bench(late, 4))) * RATE == pytest.approx(late, rel=0.1)


@pytest.mark.parametrize("late", [0.3, 2.0])
def test_every_estimate_finds_it_and_what_it_would_have_moved(late):
    model = bf.Model(LATE, bench(late, 5))
    for method in ("least-squares", "input-error"):
        rows = model.estimate(method)
        row = rows.loc["drive.delay"]
        assert row["unit"] == "s"
        assert row["value"] == pytest.approx(late / RATE, rel=0.1)
        viscous = rows.loc["motor.viscous"]
        sd = max(viscous["sd"], viscous["sd_robust"])
        assert abs(viscous["value"] - VALUES["motor.viscous"]) < 5.0 * sd
    ignored = bf.Model(AXIS, bench(late, 5)).estimates(["least-squares"])[0]
    # 0.05 N m of noise behind a filter that a tenth of it passes; a delay leaves more
    assert model.estimates(["least-squares"])[0].residual_rms < ignored.residual_rms


@pytest.mark.parametrize("late", [0.0, 0.02])
def test_load_losses_do_not_bend_the_delay_that_recordings_are_timed_by(late):
    """SIMULATED: a heavy arm whose gears lose a quarter, which totals take for a delay in part."""
    joint = replace(bf.Joint.preset("servo-pendulum"), delay=True)
    values = {
        "motor.inertia": 18.0,
        "motor.viscous": 18.0,
        "motor.coulomb": 11.0,
        "gearbox.load": 0.25,
        "load.first_moment": 11.5,
        "load.gravity_angle": -1.57,
        "drive.delay": late,
    }
    frame = bf.simulate(
        joint, values, rate=200, excitation="multisine", amplitude=120.0, seed=1, duration=30
    )
    model = bf.Model(joint, recording_of(frame, name="one"))
    row = model.estimate("input-error").loc["drive.delay"]
    sd = max(row["sd"], row["sd_robust"])
    assert abs(model.observations[0].settings["delay"] - late) < 5.0 * sd
    # what totals say lies outside: the case is one
    plain = by_totals(model)
    assert abs(plain - late) > 5.0 * sd


def test_a_delay_more_leaves_no_more_of_a_measured_torque(real_data):
    """MEASURED: a load loss bends totals so that the delay was taken for 0.1 s."""
    chain = PRESETS["servo-pendulum"].chain()
    arm = bf.Recording.from_file(
        real_data / "ur10e-joint2" / "joint_2.csv", time=1, position=3, velocity=9, current=15,
        torque_constant="10.6956 N m/A", start="8 s", stop="60 s",
    )  # fmt: skip
    left = [
        bf.Model(replace(chain, delay=late), arm).estimates(["input-error"])[0].residual_rms
        for late in (False, True)
    ]
    assert left[1] < left[0]


def test_the_output_error_finds_it():
    rows = bf.Model(LATE, bench(2.0, 6, duration=4.0)).estimate("output-error")
    row = rows.loc["drive.delay"]
    assert row["value"] == pytest.approx(2.0 / RATE, rel=0.1)


def test_a_fixed_one_is_taken_and_no_parameter_any_more():
    model = bf.Model(LATE, bench(2.0, 5), priors={"drive.delay": 0.004})
    assert model.observations[0].settings["delay"] == 0.004
    assert "drive.delay" not in model.white_target().free
    row = model.estimate("input-error").loc["motor.viscous"]
    assert abs(row["value"] - VALUES["motor.viscous"]) < 5.0 * max(row["sd"], row["sd_robust"])


def test_one_that_is_longer_than_the_ends_is_refused():
    with pytest.raises(BadInput, match="correct the time stamps, or raise trim"):
        bf.Model(LATE, bench(0.0, 5), priors={"drive.delay": 1.0})


SERVO = bf.Joint(
    [Element("motor", viscous=True, coulomb="symmetric")], Load(inertia=True, first_moment=True)
)
PENDULUM = {
    "motor.viscous": 0.05,
    "motor.coulomb": 0.08,
    "load.inertia": 0.025,
    "load.first_moment": 0.14,
}


def servo(rate, kp, samples, duration=24.0, seed=0):
    """SIMULATED: on a fine grid, a drive that holds its targets and acts some samples late."""
    rng = np.random.default_rng(seed)
    fine, n = round(2000.0 / rate), round(duration * rate)
    time, angles = np.arange(n) / rate, rng.uniform(0.0, 2.0 * np.pi, 5)
    hertz, sizes = (0.21, 0.53, 0.97, 1.7, 2.6), (0.7, 0.4, 0.25, 0.1, 0.05)
    each = zip(hertz, sizes, angles, strict=True)
    goal = sum(a * np.sin(2.0 * np.pi * f * time + p) for f, a, p in each)
    place = np.floor(np.arange(n * fine) / fine - samples + 1e-9).astype(int)
    law = Law(kp * goal[np.maximum(place, 0)], np.ones(n * fine), kp, limit=8.0)
    q, _ = follow(
        SERVO, SERVO.vector(PENDULUM)[None], law, 1.0 / (rate * fine), [(0, n * fine)],
        goal[:1], np.zeros(1), held=True,
    )  # fmt: skip
    step = 2.0 * np.pi / 4096
    frame = {"t": time, "q": step * np.round(q[0, ::fine] / step), "goal": goal}
    aim = {"column": "goal", "unit": "rad", "kp": f"{kp} N m/rad", "limit": "8 N m", "held": True}
    return bf.Recording.from_dataframe(pd.DataFrame(frame), time="t", position="q", target=aim)


@pytest.mark.parametrize(
    ("rate", "kp", "samples"),
    [
        (50.0, 4.0, 1.25),
        (50.0, 40.0, 0.5),
        (50.0, 40.0, 4.0),
        (100.0, 12.0, 2.0),
        (250.0, 4.0, 4.0),
        (250.0, 40.0, 1.25),
    ],
)
def test_a_late_target_is_no_friction(rate, kp, samples):
    model = bf.Model(replace(SERVO, delay=True), servo(rate, kp, samples))
    estimate = model.estimates(["input-error"])[0]
    for name, true in {**PENDULUM, "target.delay": samples / rate}.items():
        # of 225 numbers of 45 such recordings the furthest is 2.9 away
        assert abs(estimate[name].value - true) < 4.0 * estimate[name].larger_sd, name


def test_a_prompt_target_is_not_early():
    model = bf.Model(replace(SERVO, delay=True), servo(50.0, 40.0, 0.0))
    assert model.observations[0].settings["delay"] >= 0.0
    assert model.estimates(["input-error"])[0]["target.delay"].value < 1e-3
