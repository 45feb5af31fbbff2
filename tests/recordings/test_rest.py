"""Rests: found where the position does not change, and nowhere else."""

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.recordings.checks import standstill_outputs, standstill_samples
from tests.conftest import made_recording

STEP = 2.0 * np.pi / 4096


def counts(position):
    return np.round(position / STEP) * STEP


def test_a_plateau_is_a_rest_and_a_ramp_is_none():
    position = counts(
        np.concatenate([np.linspace(0, 1, 200), np.full(50, 1.0), np.linspace(1, 2, 200)])
    )
    flags = standstill_samples(position, ((0, 450),), 20)
    assert flags[200:250].all()
    # one step of the ramp on either side is not told from it
    assert not flags[:198].any()
    assert not flags[252:].any()


def test_an_encoder_that_flickers_by_one_step_is_at_rest_and_by_two_is_not():
    rng = np.random.default_rng(1)
    one, two = (STEP * rng.integers(0, n + 1, 100) for n in (1, 2))
    assert standstill_samples(one, ((0, 100),), 20).all()
    assert not standstill_samples(two, ((0, 100),), 20).any()


def test_a_resampled_position_keeps_its_rests():
    """Between two counts interpolation makes others, but not at rest."""
    time = np.arange(400) * 0.01
    position = counts(np.where(time < 2.0, time, 2.0))
    uneven = np.sort(np.random.default_rng(2).uniform(0.0, 3.99, 500))
    flags = standstill_samples(np.interp(uneven, time, position), ((0, 500),), 20)
    assert flags[uneven > 2.02].all()
    assert not flags[uneven < 1.95].any()


def test_windows_lie_inside_and_keep_off_the_ends():
    still = np.zeros(200, dtype=bool)
    still[50:150] = True
    taps = np.full(11, 1 / 11)
    ramp = np.arange(200.0)
    recording = made_recording(ramp, np.zeros(200), ramp, 1.0)
    rest = standstill_outputs(recording, ramp, ((0, 200),), still, taps, 3, 20)
    assert rest.torque == pytest.approx(rest.stamps)
    assert rest.stamps.min() >= 50 + 20 + 5
    assert rest.stamps.max() <= 149 - 20 - 5
    assert np.diff(rest.stamps) == pytest.approx(3.0)
    assert standstill_outputs(recording, ramp, ((0, 200),), still, taps, 3, 46) is None


def stop_and_go():
    """Position that stands still every other second; torque of no meaning."""
    time = np.arange(0.0, 12.0, 0.002)
    moving = (time % 2.0) < 1.0
    speed = np.where(moving, 3.0 * np.sin(2 * np.pi * time), 0.0)
    position = np.cumsum(speed) * 0.002
    return (
        time,
        position,
        np.sign(speed) + 0.01 * np.random.default_rng(4).standard_normal(time.size),
    )


def observed(position, **processing):
    time, _, torque = stop_and_go()
    joint = bf.Joint([bf.Element("motor", inertia=True, coulomb="symmetric")])
    model = bf.Model(joint, bf.Recording.from_arrays(time, position, torque), processing=processing)
    return model.observations[0]


def test_rests_are_asked_for_and_leave_the_outputs_in_motion():
    position = counts(stop_and_go()[1])
    without, with_rests = observed(position), observed(position, rest=True)
    assert without.rest is None
    assert "rest_outputs" not in without.settings
    assert with_rests.rest.q.size == with_rests.settings["rest_outputs"] > 50
    second = with_rests.rest.stamps % 2.0
    assert (second > 1.0).all()
    assert np.abs(with_rests.rest.torque).max() < 0.2
    # with no dead zone, too, rests are no motion
    none = observed(position, rest=True, dead_zone=0)
    assert (np.abs(none.speed) > 0.0).all()


def test_a_position_that_cannot_tell_rest_says_so():
    position = stop_and_go()[1] + 1e-3 * np.random.default_rng(5).standard_normal(6000)
    found = observed(position, rest=True)
    assert found.rest is None
    assert any(text.startswith("rest:") for text in found.warnings)
