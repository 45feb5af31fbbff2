"""What estimates say of processing: the band without noise, the delay, and the refined motion."""

from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest
from scipy.ndimage import gaussian_filter1d

import bayesfric as bf
from bayesfric.base.errors import BadInput
from bayesfric.estimates.least_squares import least_squares
from bayesfric.estimates.processing import fine_motion, settled_delay
from bayesfric.mechanism.closed_loop import follow
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.experiment import current_loop, multisine
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.recordings.filters import lowpass
from bayesfric.recordings.measurement import Law
from tests.axis import AXIS, VALUES, recording_of

RATE, COUNT = 500.0, 2.0 * np.pi / 4096
LATE = replace(AXIS, offset=True, delay=True)


def bench(torque, seed, *, rate=RATE, seconds=10.0, noise=0.05, off=0.0, count=COUNT):
    """SIMULATED finely: an axis whose position is read ``off`` s of the stamps, in counts.

    Gives the recording and the exact speed at its stamps.
    """
    step = 1.0 / (20.0 * rate)
    time = np.arange(round((seconds + 0.2) / step)) * step
    applied = torque(time)
    motion = simulate(AXIS, AXIS.vector(VALUES), applied, step, substeps=1)
    stamps = np.arange(round(seconds * rate)) / rate + 0.1
    position = np.interp(stamps + off, time, motion.q)
    position = np.round(position / count) * count if count else position
    noise = noise * np.random.default_rng(seed).standard_normal(stamps.size)
    measured = np.interp(stamps, time, applied) + noise
    recording = bf.Recording.from_arrays(stamps - 0.1, position, measured, name=f"bench-{seed}")
    return recording, np.interp(stamps, time, motion.qd)


def lines(time, amplitude, seed):
    command = multisine(time, amplitude, (0.31, 0.73, 1.37, 2.9, 5.3), seed=seed)
    return current_loop(command, time[1], 0.003)


# --- delay ----------------------------------------------------------------------------


def delayed(samples, seed, seconds=10.0):
    torque = partial(lines, amplitude=2.0, seed=seed)
    return bench(torque, seed, seconds=seconds, off=-samples / RATE)[0]


def by_totals(model):
    chain = replace(model.chain, delay=True)
    pairs = list(zip(model.recordings, model.observations, strict=True))
    return settled_delay(pairs, lambda observations: least_squares(chain, observations), chain)


@pytest.mark.parametrize("samples", [0.3, 2.0, -1.0])
def test_a_delay_is_estimated_within_a_tenth(samples):
    assert by_totals(bf.Model(AXIS, delayed(samples, 4))) * RATE == pytest.approx(samples, rel=0.1)


@pytest.mark.parametrize("samples", [0.3, 2.0])
def test_every_estimate_has_the_delay_and_what_it_would_have_moved(samples):
    model = bf.Model(LATE, delayed(samples, 5))
    for method in ("least-squares", "input-error"):
        rows = model.estimate(method)
        assert rows.loc["drive.delay", "unit"] == "s"
        assert rows.loc["drive.delay", "value"] == pytest.approx(samples / RATE, rel=0.1)
        viscous = rows.loc["motor.viscous"]
        sd = max(viscous["sd"], viscous["sd_robust"])
        assert abs(viscous["value"] - VALUES["motor.viscous"]) < 5.0 * sd
    ignored = bf.Model(AXIS, delayed(samples, 5)).estimates(["least-squares"])[0]
    # 0.05 N m of noise behind a filter that a tenth of it passes; a delay leaves more
    assert model.estimates(["least-squares"])[0].residual_rms < ignored.residual_rms


def test_the_output_error_has_the_delay():
    rows = bf.Model(LATE, delayed(2.0, 6, seconds=4.0)).estimate("output-error")
    assert rows.loc["drive.delay", "value"] == pytest.approx(2.0 / RATE, rel=0.1)


@pytest.mark.parametrize("late", [0.0, 0.02])
def test_load_losses_do_not_bend_the_delay_that_recordings_are_timed_by(late):
    """SIMULATED: a heavy arm whose gears lose a quarter, which totals take for a delay in part."""
    joint = replace(bf.Joint.preset("servo-pendulum"), delay=True)
    values = dict(zip(joint.names, (18.0, 18.0, 11.0, 0.25, 11.5, -1.57, late), strict=True))
    options = {"rate": 200, "excitation": "multisine", "amplitude": 120.0, "duration": 30}
    model = bf.Model(joint, recording_of(bf.simulate(joint, values, **options), name="arm"))
    row = model.estimate("input-error").loc["drive.delay"]
    sd = max(row["sd"], row["sd_robust"])
    assert abs(model.observations[0].settings["delay"] - late) < 5.0 * sd
    # what totals say lies outside: the case is one
    assert abs(by_totals(model) - late) > 5.0 * sd


def test_a_delay_more_leaves_no_more_of_a_measured_torque(real_data):
    """MEASURED: a load loss bends totals so that the delay was taken for 0.1 s."""
    joint = bf.Joint.preset("servo-pendulum")
    arm = bf.Recording.from_file(
        real_data / "ur10e-joint2" / "joint_2.csv", time=1, position=3, velocity=9, current=15,
        torque_constant="10.6956 N m/A", start="8 s", stop="60 s",
    )  # fmt: skip
    without, with_delay = (
        bf.Model(replace(joint, delay=late), arm).estimates(["input-error"])[0].residual_rms
        for late in (False, True)
    )
    assert with_delay < without


def test_a_fixed_delay_is_taken_and_is_no_parameter():
    model = bf.Model(LATE, delayed(2.0, 5), priors={"drive.delay": 0.004})
    assert model.observations[0].settings["delay"] == 0.004
    assert "drive.delay" not in model.white_target().free
    row = model.estimate("input-error").loc["motor.viscous"]
    assert abs(row["value"] - VALUES["motor.viscous"]) < 5.0 * max(row["sd"], row["sd_robust"])
    with pytest.raises(BadInput, match="correct the time stamps, or raise trim"):
        bf.Model(LATE, delayed(0.0, 5), priors={"drive.delay": 1.0})


SERVO = bf.Joint(
    [Element("motor", viscous=True, coulomb="symmetric")], Load(inertia=True, first_moment=True)
)
PENDULUM = {
    "motor.viscous": 0.05, "motor.coulomb": 0.08, "load.inertia": 0.025, "load.first_moment": 0.14,
}  # fmt: skip


def servo(rate, kp, samples, duration=24.0, seed=0):
    """SIMULATED: on a fine grid, a drive that holds its targets and acts some samples late."""
    rng = np.random.default_rng(seed)
    fine, n = round(2000.0 / rate), round(duration * rate)
    time, angles = np.arange(n) / rate, rng.uniform(0.0, 2.0 * np.pi, 5)
    waves = zip((0.21, 0.53, 0.97, 1.7, 2.6), (0.7, 0.4, 0.25, 0.1, 0.05), angles, strict=True)
    goal = sum(a * np.sin(2.0 * np.pi * f * time + p) for f, a, p in waves)
    place = np.floor(np.arange(n * fine) / fine - samples + 1e-9).astype(int)
    law = Law(kp * goal[np.maximum(place, 0)], np.ones(n * fine), kp, limit=8.0, held=True)
    q, _ = follow(
        SERVO, SERVO.vector(PENDULUM)[None], law, 1.0 / (rate * fine), [(0, n * fine)],
        goal[:1], np.zeros(1),
    )  # fmt: skip
    frame = {"t": time, "q": COUNT * np.round(q[0, ::fine] / COUNT), "goal": goal}
    aim = {"column": "goal", "unit": "rad", "kp": f"{kp} N m/rad", "limit": "8 N m", "held": True}
    return bf.Recording.from_dataframe(pd.DataFrame(frame), time="t", position="q", target=aim)


@pytest.mark.parametrize(
    ("rate", "kp", "samples"),
    [
        (50.0, 4.0, 1.25), (50.0, 40.0, 0.5), (50.0, 40.0, 4.0), (100.0, 12.0, 2.0),
        (250.0, 4.0, 4.0), (250.0, 40.0, 1.25),
    ],
)  # fmt: skip
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


# --- band -----------------------------------------------------------------------------


def swinging(shaken, seed):
    """SIMULATED: near its own rhythm, where gravity and inertia cancel and little torque is left.

    Stamps wander by ``shaken`` s (sd), from one to the next but little: that is noise of the
    position that grows with speed, and none where positions are looked at for their noise.
    """
    rhythm = np.sqrt(9.81 * VALUES["load.first_moment"] / VALUES["motor.inertia"])
    wander = gaussian_filter1d(np.random.default_rng(1000 + seed).standard_normal(2000), 2.0)
    return bench(
        lambda time: np.sin(0.85 * rhythm * time) + 0.3 * np.sin(0.31 * rhythm * time + 1.0),
        seed, rate=200.0, noise=0.02, off=shaken * wander / wander.std(), count=0.0,
    )[0]  # fmt: skip


def inertia(model):
    """By plain least squares, over the true one."""
    return model.estimate("least-squares").loc["motor.inertia", "value"] / VALUES["motor.inertia"]


def attenuated(model):
    return [row for row in bf.check(model).record["doubts"] if row["kind"] == "attenuated"]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.usefixtures("unexplained")
def test_the_band_ends_where_the_acceleration_is_noise(seed):
    recording = swinging(0.001, seed)
    requested = bf.Model(AXIS, recording, processing={"decimate": 10})
    chosen = bf.Model(AXIS, recording)
    (o,) = chosen.observations
    assert o.settings["band_by"] == "model"
    assert any("band: ends at" in step for step in o.steps)
    # the noise's power in a band grows at least with its width to the third, the motion's does not
    lost, left = 1.0 - inertia(requested), abs(1.0 - inertia(chosen))
    assert lost > 0.3
    assert left < 0.5 * lost
    # a requested band is left as it is, and doubted
    (doubt,) = attenuated(requested)
    ((used, narrower),) = doubt["bands"].values()
    assert used == pytest.approx(10.0)
    assert narrower < used
    # with the torque's rate in addition to the totals, and without: they are near each other
    assert doubt["times"] == pytest.approx(inertia(chosen) / inertia(requested), rel=0.5)


@pytest.mark.usefixtures("unexplained")
def test_white_noise_leaves_the_band_alone():
    """Chance narrows few: 1.7 sds of both bands are 3 or more of what differs between them."""
    for seed in range(20):
        model = bf.Model(AXIS, swinging(0.0, seed))
        assert model.observations[0].settings["band_by"] == "sampling"
        assert not attenuated(model)


# --- refined motion -------------------------------------------------------------------


def refined(seed):
    """Friction takes a third of the torque."""
    recording, speed = bench(partial(lines, amplitude=0.63, seed=seed), seed, noise=0.003)
    return bf.Model(AXIS, recording), speed


@pytest.fixture(scope="module")
def model():
    """Model and exact speed."""
    return refined(8)


def turns(speed):
    """Places, in samples, where a speed ``(N,)`` changes its sign."""
    k = np.flatnonzero(speed[1:] * speed[:-1] < 0.0)
    return k + speed[k] / (speed[k] - speed[k + 1])


def test_the_refined_motion_is_nearer_than_the_encoder_s(model):
    """Friction lets a low-passed speed cross zero late, where it brakes more than it speeds up.

    Above the low-pass the model takes the measured torque, of all but what sticks, which no
    acceleration tells; below it the motion is the encoder's.
    """
    model, exact = model
    (encoder,), (fine,), (recording,) = model.encoder, model.observations, model.recordings
    end, order = float(encoder.settings["lowpass"]), int(encoder.settings["order"])

    def low(x, cutoff):
        return lowpass(x, recording.segments, RATE, cutoff, order)

    true, late, left = turns(exact)[2:-2], [], []
    for o in (encoder, fine):
        places = turns(o.qd)
        nearest = places[np.abs(places - true[:, None]).argmin(axis=1)]
        late.append(np.median(np.abs(nearest - true)))
        motion = o.q, o.qd, o.qdd
        torque = inverse_torque(AXIS, AXIS.vector(VALUES), *motion, inputs=o.inputs, time=o.stamps)
        rest = fine.compared - torque
        left.append(np.median(np.abs(rest - low(rest, 2.0 * end))[50:-50]))
    assert late[1] < min(0.3 * late[0], 1.0)
    assert left[1] < 0.2 * left[0]
    slow = [low(o.qdd, 0.5 * end)[100:-100] for o in (encoder, fine)]
    assert np.std(slow[1] - slow[0]) < 1e-2 * np.std(slow[0])


@pytest.mark.parametrize(
    "processing",
    [
        {"differentiation": "central"},  # as in published analyses
        {"decimate": 1},  # no filter separates what is compared from the rest
        {"lowpass": "10 Hz", "decimate": 20},  # the band ends above half of the low-pass
    ],
)
def test_a_motion_of_the_encoder_alone_stays(model, processing):
    other = bf.Model(AXIS, model[0].given, processing=processing)
    np.testing.assert_array_equal(other.observations[0].qd, other.encoder[0].qd)


def test_a_joint_without_inertia_keeps_its_motion(model):
    (encoder,), (recording,) = model[0].encoder, model[0].recordings
    massless = bf.Joint([bf.Element("motor", coulomb="symmetric", viscous=True)])
    assert fine_motion(massless, np.array([0.1, 0.1]), recording, encoder) is encoder


def test_the_inertia_is_unbiased_by_the_refined_motion():
    """SIMULATED, eight recordings: 2 to 3 sds too large by the encoder's motion alone."""
    z = []
    for seed in range(20, 28):
        model, _ = refined(seed)
        estimates = [
            least_squares(AXIS, o)["motor.inertia"] for o in (model.encoder, model.observations)
        ]
        z.append([(e.value - VALUES["motor.inertia"]) / e.sd for e in estimates])
    by_encoder, by_refined = np.mean(z, axis=0)
    assert by_encoder > 1.5
    # the mean of eight standard normals has an sd of 0.35
    assert abs(by_refined) < 1.05
