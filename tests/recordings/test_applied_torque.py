"""The torque that acts, made of the one that was recorded: closed forms."""

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from bayesfric.recordings.signals import applied_torque
from tests.conftest import made_recording

PERIOD = 0.002


def test_a_command_that_is_held_acts_half_a_sample_later():
    """A staircase of a sine holds that sine times sin(x)/x, x = w dt/2, half a sample late."""
    time = np.arange(2000) * PERIOD
    w = 2.0 * np.pi * 11.0
    recording = made_recording(time, np.sin(time), np.sin(w * time), PERIOD, held=True)
    x = 0.5 * w * PERIOD
    applied = applied_torque(recording, 4)[20:-20]
    exact = np.sin(x) / x * np.sin(w * (time - 0.5 * PERIOD))[20:-20]
    np.testing.assert_allclose(applied, exact, atol=2e-6)


@pytest.mark.parametrize("order", [1, 2])
def test_what_a_makers_low_pass_took_is_given_back(order):
    fine = 50
    time = np.arange(2000 * fine) * PERIOD / fine
    true = np.sin(2 * np.pi * 3.0 * time) + 0.5 * np.sin(2 * np.pi * 7.0 * time)
    passed = lfilter(*butter(order, 5.0, fs=fine / PERIOD), true)
    torque, stamps = passed[::fine], time[::fine]
    recording = made_recording(stamps, np.sin(stamps), torque, PERIOD, torque_lag=(5.0, order))
    inner = slice(500, -50)  # the filter has settled
    assert np.abs(torque - true[::fine])[inner].max() > 0.3
    np.testing.assert_allclose(applied_torque(recording, 6)[inner], true[::fine][inner], atol=5e-3)
