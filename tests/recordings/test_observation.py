"""From a recording to what a model is compared with."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bayesfric.base.errors import BadInput
from bayesfric.recordings.observation import observe
from bayesfric.recordings.source import Processing
from tests.conftest import made_recording

W = 2 * np.pi * 0.5


def recording(n=4000, period=0.002, **changes):
    t = period * np.arange(n)
    given = {
        "name": "swing",
        "time": t,
        "position": np.sin(W * t),
        "torque": 2 * -(W**2) * np.sin(W * t) + 3 * W * np.cos(W * t) + 0.5,
        "period": period,
    }
    return made_recording(**(given | changes))


def test_parameters_of_a_made_up_joint_come_back():
    seen = observe(recording(), Processing(dead_zone=0))
    design = np.array([seen.qdd, seen.qd, np.ones_like(seen.q)])
    found = np.linalg.lstsq(seen.filter.apply(design).T, seen.measured, rcond=None)[0]
    np.testing.assert_allclose(found, [2, 3, 0.5], rtol=1e-4)


def test_outputs_of_an_excerpt_are_the_whole_s():
    seen = observe(recording(n=40_000), Processing(dead_zone=0))
    few = seen.excerpt(300)
    assert seen.excerpt(seen.measured.size) is seen
    assert few.measured.size <= 300
    places = np.searchsorted(seen.time, few.time)
    assert places[-1] == seen.time.size - 1
    for name in ("time", "measured", "speed", "segment_of"):
        np.testing.assert_array_equal(getattr(few, name), getattr(seen, name)[places])
    for name in ("q", "qd", "qdd", "torque", "stamps"):
        made = few.filter.apply(getattr(few, name))
        np.testing.assert_array_equal(made, seen.filter.apply(getattr(seen, name))[places])


@given(
    st.lists(st.integers(20, 900), min_size=1, max_size=6),
    st.integers(60, 4000),
)
def test_an_excerpt_of_a_recording_keeps_its_segments(lengths, most):
    ends = np.cumsum([0, *lengths]).tolist()
    segments = tuple(pairwise(ends))
    whole = recording(n=ends[-1], segments=segments)
    short = whole.excerpt(most)
    assert short is whole or 0 < short.time.size <= most
    for a, b in short.segments:
        inside = [
            (s, e) for s, e in segments if whole.time[s] <= short.time[a] <= whole.time[e - 1]
        ]
        ((_, e),) = inside
        assert short.time[b - 1] <= whole.time[e - 1]
        np.testing.assert_allclose(np.diff(short.time[a:b]), whole.period)
    places = np.searchsorted(whole.time, short.time)
    np.testing.assert_array_equal(short.position, whole.position[places])


def test_no_window_touches_an_excluded_sample_or_an_end_of_a_segment():
    excluded, pieces = np.zeros(4000, dtype=bool), ((0, 1500), (1500, 4000))
    excluded[1000:1100] = True
    excluded[2000] = True
    seen = observe(recording(excluded=excluded, segments=pieces), Processing(dead_zone=0))
    length = len(seen.filter.taps)
    for start, segment in zip(seen.filter.starts, seen.segment_of, strict=True):
        assert not excluded[start : start + length].any()
        a, b = pieces[segment]
        assert a + 10 <= start
        assert start + length <= b - 10
    assert seen.settings["dropped_excluded"] > 0
    assert set(seen.segment_of) == {0, 1}


def test_dead_zone_leaves_slow_windows_out():
    seen = observe(recording(), Processing(dead_zone="1 rad/s"))
    assert seen.settings["dead_zone"] == 1.0
    assert np.abs(seen.speed).min() >= 1.0
    assert seen.settings["dropped_dead_zone"] > 0


def test_windows_beside_a_reversal_stay_without_its_samples_where_few_others_are_left():
    whole = observe(recording(), Processing(band=2.0, dead_zone=0))
    seen = observe(recording(), Processing(band=2.0))
    # 0.1.0 left none, and what the low-pass smears beside a reversal costs a quarter
    assert seen.measured.size >= 0.75 * whole.measured.size
    slow = np.abs(seen.qd) < seen.settings["dead_zone"]
    assert 0 < slow.sum() < 40
    assert not seen.filter.used[slow].any()
    # what is measured there, and what a model says there, has no say
    poisoned = recording()
    poisoned.torque[slow] = 1e3
    again = observe(poisoned, Processing(band=2.0))
    np.testing.assert_allclose(again.filter.apply(poisoned.torque), seen.measured, atol=1e-9)
    design = np.array([seen.qdd, seen.qd, np.ones_like(seen.q)])
    found = np.linalg.lstsq(seen.filter.apply(design).T, seen.measured, rcond=None)[0]
    np.testing.assert_allclose(found, [2, 3, 0.5], rtol=1e-4)


def test_samples_beside_a_rest_are_not_used_those_beside_a_reversal_are():
    t = 0.002 * np.arange(4000)
    position = np.where(t < 4.5, np.sin(W * t), 1.0)  # at rest from 4.5 s on
    seen = observe(recording(position=position), Processing(lowpass=50.0, dead_zone="0.05 rad/s"))
    rests = np.flatnonzero(np.abs(seen.qd) < 0.05)
    reversal = round(0.5 / W * np.pi / 0.002)
    assert seen.filter.used[reversal - 15] == seen.filter.used[reversal + 15] == 1.0
    end = rests[rests > 2200][0]
    assert not seen.filter.used[end - 10 : end].any()


def test_a_band_unlike_the_decimation_that_was_asked_for_warns():
    seen = observe(recording(), Processing(decimate=10, band=40))
    assert any("fold back; decimate = 7 would fit" in warning for warning in seen.warnings)
    seen = observe(recording(), Processing(decimate=10, band=10))
    assert any("share noise" in warning for warning in seen.warnings)


@settings(deadline=None, max_examples=40)
@given(st.floats(20.0, 2000.0), st.floats(0.006, 0.45), st.sampled_from([None, 0.0, 0.02, 0.2]))
@example(200.0, 3.5 / 200.0, None)
@example(200.0, 3.5 / 200.0, 0.05)
def test_the_decimation_that_is_chosen_for_a_band_is_not_warned_of(fs, share, lowpass):
    asked = Processing(
        band=share * fs, lowpass=None if lowpass is None else lowpass * fs, dead_zone=0
    )
    seen = observe(recording(n=2000, period=1.0 / fs), asked)
    assert seen.settings["n_outputs"] > 0
    assert not [text for text in seen.warnings if text.startswith("band")]
    # a low-pass does not change what the band takes
    factor = seen.settings["decimate"]
    assert factor == observe(recording(n=2000, period=1.0 / fs), Processing(
        band=share * fs, dead_zone=0
    )).settings["decimate"]  # fmt: skip
    # white noise comes out nearly white: its sum over all lags is what intervals rest on
    taps = seen.filter.taps
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
    period, n = 1e-3, 4000
    time = np.arange(n) * period
    position = np.sin(2 * np.pi * time)
    glitch = position.copy()
    glitch[2000] += 1.0
    excluded = np.zeros(n, dtype=bool)
    excluded[1990:2011] = True

    def outputs(q):
        torque = np.cos(2 * np.pi * time)
        recording = made_recording(time, q, torque, period, excluded=excluded)
        # 50 samples of trim: 2.5 periods of the cut-off on either side
        return observe(recording, Processing(lowpass=50.0, decimate=1, trim=0.05, dead_zone=0.0))

    with_glitch, without = outputs(glitch), outputs(position)
    # slowest pole of the filter: exp(-2 pi 50 sin(pi/8) 0.06 s) = 7e-4 of an impulse whose
    # derivative is about 30 rad/s high
    assert np.abs(with_glitch.speed - without.speed).max() < 2.0 * 7e-4 * 30.0
    assert not ((with_glitch.time > 1.94) & (with_glitch.time < 2.06)).any()


def test_measured_velocity_is_used():
    t = 0.002 * np.arange(4000)
    seen = observe(recording(velocity=np.full(4000, 2.0) + 0.1 * t), Processing(lowpass=50.0))
    np.testing.assert_allclose(seen.qd, 2 + 0.1 * t, atol=1e-6)
    np.testing.assert_allclose(seen.qdd[20:-20], 0.1, atol=1e-4)
