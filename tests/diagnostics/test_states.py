"""States that a motion leaves behind, against what they are in closed form."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import signal

from bayesfric.diagnostics.motion import deflection, in_gap, resonating, since_reversal


def test_a_bristle_bends_exponentially_and_turns_about():
    q = np.linspace(0.0, 1.0, 1001)
    z = deflection(q, 0.2)
    np.testing.assert_allclose(z, 1.0 - np.exp(-q / 0.2), atol=1e-12)
    back = deflection(np.concatenate([q, q[::-1]]), 0.2)
    gone = np.exp(-1.0 / 0.2)
    assert back[-1] == pytest.approx(-1.0 + (2.0 - gone) * gone, abs=1e-12)
    # whichever way it goes first, and however it rests on its way
    rested = np.repeat(-q, 2)
    np.testing.assert_allclose(deflection(rested, 0.2)[::2], -z, atol=1e-12)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_distance_is_counted_from_the_last_reversal_that_is_one(way):
    """A triangle of many sizes; a reversal is one once it has gone further than the least."""
    turns, least, step = [0.0, 1.0, 0.2, 0.209, -0.5, -0.489, -0.8, 0.4], 0.0105, 0.001
    path, exact = [0.0], [0.0]
    turn, heading = 0.0, 0.0
    for begin, end in pairwise(turns):
        moves = begin + np.sign(end - begin) * step * np.arange(
            1, 1 + round(abs(end - begin) / step)
        )
        for x in moves:
            if heading == 0.0 and abs(x) > least:
                heading = np.sign(x)
            elif heading * (begin - x) > least and heading * (end - begin) < 0.0:
                turn, heading = begin, -heading
            path.append(x)
            exact.append(abs(x - turn))
    result = since_reversal(way * np.array(path) + 3.0, least)
    np.testing.assert_allclose(result, exact, atol=1e-9)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_load_crosses_its_gap_in_free_fall_and_stays(way):
    """Of each part of a recording anew, from the side that its first acceleration presses on."""
    period, half, pull = 1e-4, 0.002, 3.0
    need = np.full(8000, -pull)
    need[:1000] = pull
    need[4000:] = need[:4000]
    segments = np.array([[0, 3000], [3000, 4500], [4500, 8000]])
    place = in_gap(way * need, period, half, segments)
    falling = np.maximum(1.0 - 0.5 * pull * (period * np.arange(1, 2001)) ** 2 / half, -1.0)
    assert falling[-1] == -1.0
    exact = np.concatenate([np.ones(1000), falling, -np.ones(1000)])
    # the second part begins pressed back, and flies from 4000 on until it is cut off
    rising = 1.0 - (falling - 1.0) - 2.0
    exact = np.concatenate([exact, rising[:500], np.ones(500), falling, -np.ones(1000)])
    np.testing.assert_allclose(place, way * exact, atol=1e-9)


def test_a_load_that_is_pulled_back_in_its_gap_keeps_its_speed():
    """What it flies with comes from all accelerations since it left."""
    period, half = 1e-3, 1.0
    need = np.concatenate([[1.0], np.full(300, -2.0), np.full(300, 2.0), np.zeros(200)])
    place = in_gap(need, period, half, np.array([[0, need.size]]))
    t = period * np.arange(1, 301)
    np.testing.assert_allclose(place[1:301], 1.0 - t**2, atol=1e-9)
    np.testing.assert_allclose(place[301:601], 1.0 - 0.09 - 0.6 * t + t**2, atol=1e-9)
    np.testing.assert_allclose(place[601:], place[600], atol=1e-9)


@pytest.mark.parametrize("begin", [0.4, 1.38])
def test_an_elastic_transmission_is_a_damped_resonator(begin):
    """Against the differential equation ``y'' + 2 D w y' + w^2 y = w^2 x``, D a twentieth.

    What still rings at the end of a part is not there at its beginning.
    """
    period, hertz = 1e-3, [25.0, 40.0]
    t = period * np.arange(1500)
    pulse = np.exp(-0.5 * ((t - begin) / 0.02) ** 2) * np.sin(2 * np.pi * 9.0 * (t - begin))
    # a straight line passes a resonator as it is, and each part is by itself
    x = np.concatenate([np.ones(20), pulse + 3.0 - 2.0 * t, pulse[390:411]])
    parts = ((0, 20), (20, 1520), (1520, 1541))
    result = resonating(x, parts, period, hertz)
    for f, row in zip(hertz, result, strict=True):
        w = 2.0 * np.pi * f
        _, y, _ = signal.lsim(([w**2], [1.0, 0.1 * w, w**2]), pulse, t)
        np.testing.assert_allclose(row[20:1520], y - pulse, atol=2e-3 * np.abs(y).max())
        assert not row[:20].any()
        assert row[1520:].any() == (begin == 0.4)
