"""Cutting recordings into segments for the output error."""

import numpy as np
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.estimates.trajectory import divided, trajectory
from bayesfric.recordings.measurement import Inputs
from bayesfric.recordings.signals import observe
from bayesfric.recordings.source import Processing
from tests.conftest import made_recording


def made(n=1000, segments=None, excluded=(), period=0.01):
    flags = np.zeros(n, dtype=bool)
    for a, b in excluded:
        flags[a:b] = True
    time = np.arange(n) * period
    return made_recording(
        time,
        np.sin(time),
        np.cos(time),
        period,
        segments=segments or ((0, n),),
        excluded=flags,
        inputs=Inputs(2.0, 0.5),
    )


def cut(recording, length):
    processing = Processing(lowpass=0.0, decimate=1, dead_zone=0.0)
    return trajectory(recording, observe(recording, processing), length)


def test_stretches_are_divided_completely_and_where_the_joint_is_fast():
    t = cut(made(), 1.5)
    # 10 s in about 1.5 s: seven parts
    assert len(t.segments) == 7
    assert t.segments[0, 0] == 0
    assert t.segments[-1, 1] == 1000
    assert np.array_equal(t.segments[1:, 0], t.segments[:-1, 1])
    even = 1000 / 7
    borders = t.segments[1:, 0]
    assert np.abs(borders - even * np.arange(1, 7)).max() <= even / 4 + 1
    # nowhere within a quarter of a piece is the joint faster
    speed = np.abs(np.cos(np.arange(1000) * 0.01))
    for i, border in enumerate(borders, start=1):
        near = speed[int(even * (i - 0.24)) : int(even * (i + 0.24))]
        assert speed[border] >= near.max() - 1e-3
    assert np.array_equal(t.samples, np.arange(1000))
    assert np.array_equal(np.bincount(t.segment_of), np.diff(t.segments, axis=1)[:, 0])


def test_gaps_and_excluded_samples_are_never_simulated_over():
    t = cut(made(segments=((0, 400), (400, 1000)), excluded=((600, 650),)), np.inf)
    assert t.segments.tolist() == [[0, 400], [400, 600], [650, 1000]]


def test_states_to_start_from_are_those_of_the_motion():
    t = cut(made(), 2.0)
    time = t.segments[:, 0] * 0.01
    assert np.allclose(t.q0, np.sin(time), atol=1e-12)
    # second-order differences of a sine with 10 ms steps: the error is h²/3 at the very end
    assert np.allclose(t.qd0, np.cos(time), atol=0.01**2)
    assert (t.inputs.added_mass, t.inputs.radius) == (2.0, 0.5)


def test_divided_is_what_trajectory_makes():
    recording = made(excluded=((300, 350),))
    observation = observe(recording, Processing(lowpass=0.0, decimate=1, dead_zone=0.0))
    whole = trajectory(recording, observation, np.inf)
    again, direct = divided(whole, observation, 1.0), trajectory(recording, observation, 1.0)
    assert np.array_equal(again.segments, direct.segments)
    assert np.array_equal(again.qd0, direct.qd0)
    with pytest.raises(BadInput, match="segment: "):
        divided(whole, observation, 0.05)


@pytest.mark.parametrize("length", [0.21, 0.25, 0.3])
def test_short_segments_lose_no_samples(length):
    t = cut(made(), length)
    assert np.diff(t.segments, axis=1).min() >= 20
    assert t.samples.size == 1000
