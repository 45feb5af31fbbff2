"""From a recording to what a model is compared with."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bayesfric.base.errors import BadInput
from bayesfric.recordings.signals import observe
from bayesfric.recordings.source import Processing
from tests.conftest import made_recording

W = 2 * np.pi * 0.5


def recording(n=4000, period=0.002, **changes):
    t = period * np.arange(n)
    keys = {
        "name": "swing",
        "time": t,
        "position": np.sin(W * t),
        "torque": 2 * -(W**2) * np.sin(W * t) + 3 * W * np.cos(W * t) + 0.5,
        "period": period,
    }
    return made_recording(**(keys | changes))


def check_parameters(o):
    """Compare the joint's parameters by least squares with the true ones."""
    design = np.array([o.qdd, o.qd, np.ones_like(o.q)])
    estimate = np.linalg.lstsq(o.filter.apply(design).T, o.measured, rcond=None)[0]
    np.testing.assert_allclose(estimate, [2, 3, 0.5], rtol=1e-4)


def test_parameters_of_a_simulated_joint():
    check_parameters(observe(recording(), Processing(dead_zone=0)))


def test_outputs_of_an_excerpt_are_those_of_the_recording():
    o = observe(recording(n=40_000), Processing(dead_zone=0))
    few = o.excerpt(300)
    assert o.excerpt(o.measured.size) is o
    assert few.measured.size <= 300
    outputs = np.searchsorted(o.time, few.time)
    assert outputs[-1] == o.time.size - 1
    for name in ("time", "measured", "speed", "segment_of"):
        np.testing.assert_array_equal(getattr(few, name), getattr(o, name)[outputs])
    for name in ("q", "qd", "qdd", "torque", "stamps"):
        filtered = few.filter.apply(getattr(few, name))
        np.testing.assert_array_equal(filtered, o.filter.apply(getattr(o, name))[outputs])


@given(
    st.lists(st.integers(20, 900), min_size=1, max_size=6),
    st.integers(60, 4000),
)
def test_an_excerpt_of_a_recording_keeps_its_segments(lengths, max_count):
    ends = np.cumsum([0, *lengths]).tolist()
    segments = tuple(pairwise(ends))
    whole = recording(n=ends[-1], segments=segments)
    short = whole.excerpt(max_count)
    assert short is whole or 0 < short.time.size <= max_count
    samples = np.searchsorted(whole.time, short.time)
    np.testing.assert_array_equal(short.position, whole.position[samples])
    for a, b in short.segments:
        np.testing.assert_array_equal(np.diff(samples[a:b]), 1)
        assert np.unique(np.searchsorted(ends, samples[a:b], "right")).size == 1


def test_no_window_touches_an_excluded_sample_or_an_end_of_a_segment():
    excluded, pieces = np.zeros(4000, dtype=bool), ((0, 1500), (1500, 4000))
    excluded[1000:1100] = True
    excluded[2000] = True
    o = observe(recording(excluded=excluded, segments=pieces), Processing(dead_zone=0))
    length = len(o.filter.taps)
    for start, segment in zip(o.filter.starts, o.segment_of, strict=True):
        assert not excluded[start : start + length].any()
        a, b = pieces[segment]
        assert a + 10 <= start
        assert start + length <= b - 10
    assert o.settings["dropped_excluded"] > 0
    assert set(o.segment_of) == {0, 1}


def test_dead_zone_leaves_slow_windows_out():
    o = observe(recording(), Processing(dead_zone="1 rad/s"))
    assert o.settings["dead_zone"] == 1.0
    assert np.abs(o.speed).min() >= 1.0
    assert o.settings["dropped_dead_zone"] > 0


def test_windows_next_to_a_reversal_stay_without_its_samples_where_few_others_are_left():
    everything = observe(recording(), Processing(band=2.0, dead_zone=0))
    o = observe(recording(), Processing(band=2.0))
    # what the low-pass smears next to a reversal costs a quarter
    assert o.measured.size >= 0.75 * everything.measured.size
    slow = np.abs(o.qd) < o.settings["dead_zone"]
    assert 0 < slow.sum() < 40
    # what is measured and modelled there does not count
    assert not o.filter.used[slow].any()
    torque = np.where(slow, 1e3, recording().torque)
    np.testing.assert_allclose(o.filter.apply(torque), o.measured, atol=1e-9)
    check_parameters(o)


def test_samples_next_to_a_standstill_are_not_used_those_next_to_a_reversal_are():
    t = 0.002 * np.arange(4000)
    position = np.where(t < 4.5, np.sin(W * t), 1.0)  # at standstill from 4.5 s on
    o = observe(recording(position=position), Processing(lowpass=50.0, dead_zone="0.05 rad/s"))
    reversal = round(0.5 / W * np.pi / 0.002)
    assert o.filter.used[reversal - 15] == o.filter.used[reversal + 15] == 1.0
    slow = np.flatnonzero(np.abs(o.qd) < 0.05)
    standstill = slow[slow > 2200][0]
    assert not o.filter.used[standstill - 10 : standstill].any()


@pytest.mark.parametrize(("band", "factor"), [(40, 7), (10, 27)])
def test_a_band_unlike_the_decimation_warns(band, factor):
    (warning,) = observe(recording(), Processing(decimate=10, band=band)).warnings
    assert f"decimate = {factor} would fit" in warning


@settings(deadline=None, max_examples=40)
@given(st.floats(20.0, 2000.0), st.floats(0.006, 0.45), st.sampled_from([0.0, 0.02, 0.2]))
@example(200.0, 3.5 / 200.0, 0.05)
def test_the_decimation_that_is_chosen_for_a_band_is_not_warned_of(fs, share, lowpass):
    r = recording(n=2000, period=1.0 / fs)
    o = observe(r, Processing(band=share * fs, dead_zone=0))
    assert o.settings["n_outputs"] > 0
    assert not [text for text in o.warnings if text.startswith("band")]
    # a low-pass does not change the decimation
    filtered = observe(r, Processing(band=share * fs, lowpass=lowpass * fs, dead_zone=0))
    factor = o.settings["decimate"]
    assert filtered.settings["decimate"] == factor
    # white noise stays nearly white: intervals depend on its sum over all lags
    taps = o.filter.taps
    if factor > 1:
        lags = np.correlate(taps, taps, "full")[(len(taps) - 1) % factor :: factor]
        assert 0.7 < lags.sum() / (taps @ taps) < 1.3


@pytest.mark.parametrize(
    ("changes", "options", "key"),
    [
        ({}, {"decimate": 1000}, "decimate"),
        ({}, {"trim": 3.99}, "trim"),
        ({"excluded": np.ones(4000, dtype=bool)}, {}, "exclude"),
        ({}, {"dead_zone": 100.0}, "dead_zone"),
        ({}, {"lowpass": 250}, "lowpass"),
        ({}, {"band": 250}, "band"),
    ],
)
def test_no_outputs_left_names_the_setting(changes, options, key):
    with pytest.raises(BadInput, match=key) as caught:
        observe(recording(**changes), Processing(**options))
    assert "swing" in caught.value.where


def test_a_glitch_in_an_excluded_span_stays_in_it():
    """The low-pass carries it past the borders; nothing that close is compared."""
    time = np.arange(4000) * 1e-3
    excluded = abs(time - 2.0) < 0.0105
    # 50 samples of trim: 2.5 periods of the cut-off on either side
    processing = Processing(lowpass=50.0, decimate=1, trim=0.05, dead_zone=0.0)
    with_glitch, without = (
        observe(recording(period=1e-3, excluded=excluded, position=position), processing)
        for position in (np.sin(W * time) + (time == 2.0), np.sin(W * time))
    )
    # slowest pole of the filter: exp(-2 pi 50 sin(pi/8) 0.06 s) = 7e-4 of an impulse whose
    # derivative is about 30 rad/s high
    difference = np.abs(with_glitch.speed - without.speed).max()
    assert 0.0 < difference < 2.0 * 7e-4 * 30.0
    assert not ((with_glitch.time > 1.94) & (with_glitch.time < 2.06)).any()


def test_measured_velocity_is_used():
    t = 0.002 * np.arange(4000)
    o = observe(recording(velocity=np.full(4000, 2.0) + 0.1 * t), Processing(lowpass=50.0))
    np.testing.assert_allclose(o.qd, 2 + 0.1 * t, atol=1e-6)
    np.testing.assert_allclose(o.qdd[20:-20], 0.1, atol=1e-4)
