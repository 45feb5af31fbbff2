"""The delay that recordings show: right where there is one, nothing where there is none."""

import numpy as np
import pandas as pd
import pytest

import bayesfric as bf
from bayesfric.errors import BadInput
from bayesfric.mechanism.excitation import current_loop, multisine
from bayesfric.mechanism.forward import simulate
from tests.axis import AXIS, VALUES

RATE, FINE = 500.0, 20


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


@pytest.mark.parametrize("late", [0.3, 2.0, -1.0])
def test_it_is_found_within_a_tenth_and_five_sds(late):
    (found,) = bf.Model(AXIS, bench(late, 4)).delays()
    assert found.samples == pytest.approx(late, rel=0.1)
    assert abs(found.value - late / RATE) < 5.0 * found.sd
    assert found.matters


def test_no_false_alarm_without_one():
    shares = []
    for seed in range(30):
        (found,) = bf.Model(AXIS, bench(0.0, seed)).delays()
        assert not found.matters
        shares.append(found.value / found.sd)
    # standard normal, were there nothing but noise
    assert abs(np.mean(shares)) < 1.0
    assert 0.4 < np.std(shares) < 1.8


def test_the_packaged_knee_raises_no_alarm():
    from bayesfric.commands.fit import demo_config

    (found,) = bf.Model.from_config(demo_config()).delays()
    assert not found.matters


@pytest.mark.parametrize("late", [0.3, 2.0])
def test_every_estimate_finds_it_and_what_it_would_have_moved(late):
    joint = bf.Joint(AXIS.elements, AXIS.load, offset=True, delay=True)
    model = bf.Model(joint, bench(late, 5))
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


def test_the_output_error_finds_it():
    joint = bf.Joint(AXIS.elements, AXIS.load, offset=True, delay=True)
    rows = bf.Model(joint, bench(2.0, 6, duration=4.0)).estimate("output-error")
    row = rows.loc["drive.delay"]
    assert row["value"] == pytest.approx(2.0 / RATE, rel=0.1)


def test_a_fixed_one_is_taken_and_no_parameter_any_more():
    joint = bf.Joint(AXIS.elements, AXIS.load, offset=True, delay=True)
    model = bf.Model(joint, bench(2.0, 5), priors={"drive.delay": 0.004})
    assert model.observations[0].settings["delay"] == 0.004
    assert "drive.delay" not in model.white_target().free
    row = model.estimate("input-error").loc["motor.viscous"]
    assert abs(row["value"] - VALUES["motor.viscous"]) < 5.0 * max(row["sd"], row["sd_robust"])


def test_one_that_is_longer_than_the_ends_is_refused():
    joint = bf.Joint(AXIS.elements, AXIS.load, offset=True, delay=True)
    with pytest.raises(BadInput, match="correct the time stamps, or raise trim"):
        bf.Model(joint, bench(0.0, 5), priors={"drive.delay": 1.0})


def test_a_simulated_recording_is_late_by_its_true_delay():
    joint = bf.Joint(AXIS.elements, AXIS.load, offset=True, delay=True)
    frame = joint.simulate(
        VALUES | {"drive.delay": 0.0015}, rate=1000, excitation="multisine", amplitude=3.0, seed=2
    )
    assert isinstance(frame, pd.DataFrame)
    columns = (frame[name].to_numpy() for name in ("time", "position", "torque"))
    (found,) = bf.Model(AXIS, bf.Recording.from_arrays(*columns, name="one")).delays()
    assert found.value == pytest.approx(0.0015, rel=0.1)
    assert found.matters
