"""The torque that acts, made of the one that was recorded: closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, lfilter
from scipy.stats import binom

from bayesfric.recordings.filters import integrated_kinks
from bayesfric.recordings.measurement import Lag
from bayesfric.recordings.observation import applied_torque
from tests.conftest import made_recording

PERIOD = 0.002


def whole(x):
    return ((0, x.size),)


@given(bend=st.integers(10, 80), slope=st.floats(-100.0, 100.0).filter(lambda s: abs(s) > 1e-3))
def test_a_sum_is_the_integral_where_the_slope_jumps_at_a_sample(bend, slope):
    """Euler and Maclaurin: the trapezoid rule is off by dt²/12 of each jump of the slope."""
    k = np.arange(101)
    smooth = 1e-3 * slope * np.sin(2.0 * np.pi * k / 100)
    kinked = np.where(k > bend, 1.0 - np.exp(-(k - bend) * PERIOD / 0.02), 0.0) * 0.02 * slope
    found = integrated_kinks(kinked + smooth, whole(k))
    # of the exponential from the bend on, beside the smooth part, whose sum is its integral
    exact = slope * 0.02 * ((t := (100 - bend) * PERIOD) - 0.02 * (1.0 - np.exp(-t / 0.02)))
    ends = 0.5 * (kinked[0] + kinked[-1])

    def off(x):
        return PERIOD * (x - smooth).sum() - PERIOD * ends - exact

    assert abs(off(found)) < 0.25 * abs(off(kinked + smooth))


def test_noise_has_a_bend_in_one_recording_of_twenty():
    rng = np.random.default_rng(3)
    seeds = 400
    bent = sum(
        bool(np.any(integrated_kinks(x, whole(x)) != x)) for x in rng.standard_normal((seeds, 2000))
    )
    # no more than the chance that is allowed; neighbours count twice, so fewer may be
    assert bent <= binom.ppf(0.999, seeds, 0.05)


def test_a_command_that_is_held_acts_half_a_sample_later():
    """A staircase of a sine holds that sine times sin(x)/x, x = w dt/2, half a sample late."""
    time = np.arange(2000) * PERIOD
    w = 2.0 * np.pi * 11.0
    one = made_recording(time, np.sin(time), np.sin(w * time), PERIOD, held=True)
    x = 0.5 * w * PERIOD
    found = applied_torque(one, 4)[20:-20]
    exact = np.sin(x) / x * np.sin(w * (time - 0.5 * PERIOD))[20:-20]
    np.testing.assert_allclose(found, exact, atol=2e-6)


@pytest.mark.parametrize("order", [1, 2])
def test_what_a_makers_low_pass_took_is_given_back(order):
    fine = 50
    time = np.arange(2000 * fine) * PERIOD / fine
    true = np.sin(2 * np.pi * 3.0 * time) + 0.5 * np.sin(2 * np.pi * 7.0 * time)
    passed = lfilter(*butter(order, 5.0, fs=fine / PERIOD), true)
    torque, stamps = passed[::fine], time[::fine]
    one = made_recording(stamps, np.sin(stamps), torque, PERIOD, torque_lag=Lag(5.0, order))
    inner = slice(500, -50)  # the filter has settled
    assert np.abs(torque - true[::fine])[inner].max() > 0.3
    np.testing.assert_allclose(applied_torque(one, 6)[inner], true[::fine][inner], atol=5e-3)
