"""What is looked for at any place, against searches that try every place."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from bayesfric.diagnostics.disturbances import (
    sinusoid_columns,
    sinusoidal_disturbance,
    transient_columns,
    transient_disturbance,
    tune_frequency,
)
from tests.diagnostics.bench import laid_out

RATE = 50.0


def laid(*counts, gaps=()):
    return laid_out(*counts, gaps=gaps, rate=RATE)


def gain(y, layout, hertz):
    """Twice the rise of the log-likelihood by sine and cosine of a frequency, in each recording."""
    power = 0.0
    for t, part in zip(layout.stamps, layout.split(y), strict=True):
        power += abs(np.sum(part * np.exp(-2j * np.pi * hertz * (t - t[0])))) ** 2
    power /= 0.5 * float(y @ y)
    return power / (1.0 - power / y.size)


@pytest.mark.parametrize("counts", [(400,), (300, 120), (80, 90, 300)])
@pytest.mark.parametrize("seed", range(4))
def test_a_tone_is_the_largest_of_the_periodogram(counts, seed):
    layout, rng = laid(*counts, gaps=(30, 31, 77)), np.random.default_rng(seed)
    y = rng.standard_normal(layout.outputs)
    span = max(np.ptp(t) for t in layout.stamps)
    # grid of the transform: a power of two of samples, twice the longest recording at least
    fine = RATE / 2 ** np.ceil(np.log2(2.0 * span * RATE + 2.0))
    grid = fine * np.arange(1, 1000)
    grid = grid[(grid >= 2.0 / span) & (grid <= 0.45 * RATE)]
    gains = [gain(y, layout, f) for f in grid]
    scan = sinusoidal_disturbance(y, layout)
    assert scan.peak == pytest.approx(max(gains), rel=1e-6)
    low, mid, high = (gain(y, layout, grid[np.argmax(gains)] + k * fine) for k in (-1, 0, 1))
    if grid[0] < grid[np.argmax(gains)] < grid[-1]:
        parabola = np.polyfit([-1.0, 0.0, 1.0], [low, mid, high], 2)
        top = grid[np.argmax(gains)] - 0.5 * parabola[1] / parabola[0] * fine
        assert scan.place == pytest.approx(top, abs=1e-6 * fine)


@pytest.mark.parametrize("hertz", [0.11, 0.2, 22.0, 24.0])
def test_tones_are_looked_for_from_two_periods_on_and_below_nearly_half_the_rate(hertz):
    """Of ten seconds from 0.2 Hz on, at a rate of 50 Hz up to 22.5 Hz."""
    layout = laid(501)
    scan = sinusoidal_disturbance(np.sin(2 * np.pi * hertz * layout.stamps[0] + 0.3), layout)
    assert 0.2 - 0.05 <= scan.place <= 22.5 + 0.05
    if 0.2 <= hertz <= 22.5:
        assert scan.place == pytest.approx(hertz, abs=0.05)
    else:
        assert abs(scan.place - np.clip(hertz, 0.2, 22.5)) < 0.2


@pytest.mark.parametrize("seed", range(40))
def test_a_push_is_the_largest_mean_of_all_places(seed):
    """Also right at the ends, and in whichever recording."""
    rng = np.random.default_rng(seed)
    layout = laid(*rng.integers(30, 90, 3), gaps=rng.integers(5, 25, 12))
    width = rng.uniform(0.05, 0.3)
    y = rng.standard_normal(layout.outputs)
    parts = layout.split(y)
    begins = seed % 3 == 0
    k = seed % 2
    parts[k][: 6 if begins else None] += 3.0 * begins
    parts[k][None if begins else -6 :] += 3.0 * (not begins)
    y = np.concatenate(parts)
    best = (0.0, 0.0, 0)
    for k, (t, part) in enumerate(zip(layout.stamps, parts, strict=True)):
        place = t[0] + width
        while place < t[-1]:
            inside = part[(t >= place - 1.5 * width) & (t < place + 1.5 * width)]
            if inside.size >= 3:
                best = max(best, (inside.sum() ** 2 / inside.size / np.mean(y**2), place, k))
            place += width
    scan = transient_disturbance(y, layout, width)
    assert (scan.peak, scan.place, scan.recording) == pytest.approx(best, rel=1e-9)


def test_a_transient_has_three_outputs_at_least():
    for missing, some in ((9, False), (8, True)):  # two outputs alone, 19 and 20, or three
        layout = laid(40, gaps=[*range(10, 10 + missing), *range(21, 30)])
        y = np.zeros(layout.outputs)
        y[10 : 10 + 11 - missing] = 5.0
        scan = transient_disturbance(y, layout, 0.04)
        exact = 9 * 25.0 / 3 / np.mean(y**2) if some else 0.0
        assert scan.peak == pytest.approx(exact)
    assert not transient_disturbance(np.ones(8), laid(4, 4), 0.25).peak  # which are too short
    assert not sinusoidal_disturbance(np.sin([*range(9)]), laid(3, 3, 3)).peak


def test_what_a_scan_has_found_is_what_its_columns_take_out():
    layout = laid(1000, 1500)
    t, first = np.concatenate(layout.stamps), np.arange(2500) < 1000
    x = sinusoid_columns(layout, 4.0)
    exact = [f(8 * np.pi * t) * part for part in (first, ~first) for f in (np.sin, np.cos)]
    np.testing.assert_allclose(x.T, exact, atol=1e-9)
    y = np.exp(-0.5 * ((t - 7.1) / 0.25) ** 2) * ~first
    scan = transient_disturbance(y, layout, 0.25)
    x = transient_columns(layout, scan, 0.25)
    assert np.abs(y - x @ np.linalg.lstsq(x, y)[0]).max() < 0.02
    # bells as far apart as they are wide
    bells = transient_columns(layout, replace(scan, place=7.1), 0.25)
    for column, centre in ((2, 7.1), (0, 6.6), (4, 7.6)):
        exact = np.exp(-0.5 * ((t - centre) / 0.25) ** 2) * ~first
        np.testing.assert_allclose(bells[:, column], exact, atol=1e-12)


@pytest.mark.parametrize("counts", [(600,), (400, 700)])
@pytest.mark.parametrize("off", [-0.6, -0.15, 0.05, 0.6])
def test_a_tuned_tone_leaves_least_of_all_frequencies(counts, off):
    """Beside what the model explains, with phase and size of its own in each recording."""
    layout, rng = laid(*counts), np.random.default_rng(2)
    t, begin = np.concatenate(layout.stamps), 0
    y = 0.05 * rng.standard_normal(t.size)
    for n, phase, size in zip(counts, (0.3, 2.0), (1.0, 0.5), strict=False):
        y[begin : begin + n] += size * np.sin(2 * np.pi * 3.217 * t[begin : begin + n] + phase)
        begin += n
    base = np.linalg.qr(np.column_stack([np.ones(t.size), t]))[0]

    def left(x):
        return x - base @ (base.T @ x)

    def power(hertz):
        x = left(sinusoid_columns(layout, hertz))
        return float(((left(y) - x @ np.linalg.lstsq(x, left(y))[0]) ** 2).sum())

    span = max(np.ptp(t) for t in layout.stamps)
    best = minimize_scalar(power, bounds=(3.2, 3.235), method="bounded", options={"xatol": 1e-7}).x
    # four steps of at most a fifth of a period each
    assert abs(tune_frequency(left(y), layout, best + off / span, left) - best) < 0.01 / span
    far = best + 1.1 / span
    assert 0.2 / span < abs(tune_frequency(left(y), layout, far, left) - far) <= 0.8001 / span
