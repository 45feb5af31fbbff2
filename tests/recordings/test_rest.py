"""Rests: found where the position does not change, and nowhere else."""

import numpy as np
import pytest

from bayesfric.recordings.checks import standstill_outputs, standstill_samples
from bayesfric.recordings.signals import observe
from bayesfric.recordings.source import Processing
from tests.conftest import made_recording

STEP = 2.0 * np.pi / 4096


def counts(position):
    return np.round(position / STEP) * STEP


def test_a_plateau_is_at_rest_and_a_ramp_is_not():
    ramp = np.linspace(0, 1, 200)
    position = counts(np.concatenate([ramp, np.full(50, 1.0), 1.0 + ramp]))
    flags = standstill_samples(position, ((0, 450),), 20)
    assert flags[200:250].all()
    # one step of the ramp on either side looks alike
    assert not flags[:198].any()
    assert not flags[252:].any()


def test_an_encoder_that_flickers_by_one_step_is_at_rest_and_by_two_is_not():
    rng = np.random.default_rng(1)
    for steps in (1, 2):
        flags = standstill_samples(STEP * rng.integers(0, steps + 1, 100), ((0, 100),), 20)
        assert set(flags) == {steps == 1}


def test_a_resampled_position_keeps_its_rests():
    """Between two counts interpolation makes others, but not at rest."""
    time = np.arange(400) * 0.01
    uneven = np.sort(np.random.default_rng(2).uniform(0.0, 3.99, 500))
    position = np.interp(uneven, time, counts(np.minimum(time, 2.0)))
    flags = standstill_samples(position, ((0, 500),), 20)
    assert flags[uneven > 2.02].all()
    assert not flags[uneven < 1.95].any()


def test_windows_lie_inside_and_keep_off_the_ends():
    still = np.zeros(200, dtype=bool)
    still[50:150] = True
    taps = np.full(11, 1 / 11)
    ramp = np.arange(200.0)
    recording = made_recording(ramp, np.zeros(200), ramp, 1.0)
    rest = standstill_outputs(recording, ramp, still, taps, 3, 20)
    assert rest.torque == pytest.approx(rest.stamps)
    assert rest.stamps.min() >= 50 + 20 + 5
    assert rest.stamps.max() <= 149 - 20 - 5
    assert np.diff(rest.stamps) == pytest.approx(3.0)
    assert standstill_outputs(recording, ramp, still, taps, 3, 46) is None


def observed(noise, **processing):
    """A joint that stands still every other second; its position in counts, or with noise."""
    rng, time = np.random.default_rng(4), np.arange(0.0, 12.0, 0.002)
    speed = np.where((time % 2.0) < 1.0, 3.0 * np.sin(2 * np.pi * time), 0.0)
    torque = np.sign(speed) + 0.01 * rng.standard_normal(time.size)
    position = np.cumsum(speed) * 0.002
    position = position + noise * rng.standard_normal(time.size) if noise else counts(position)
    return observe(made_recording(time, position, torque, 0.002), Processing(**processing))


def test_standstills_are_outputs_of_their_own():
    assert observed(0.0).rest is None
    o = observed(0.0, rest=True)
    assert o.rest.q.size == o.settings["rest_outputs"] > 50
    assert (o.rest.stamps % 2.0 > 1.0).all()
    assert np.abs(o.rest.torque).max() < 0.2
    # without a dead zone, too, standstill is no motion
    assert (np.abs(observed(0.0, rest=True, dead_zone=0).speed) > 0.0).all()
    noisy = observed(1e-3, rest=True)
    assert noisy.rest is None
    assert any(text.startswith("rest:") for text in noisy.warnings)
