"""What is looked for at any place, in noise whose gain is known."""

import numpy as np
import pytest

from bayesfric.diagnostics.memory import Layout
from bayesfric.diagnostics.scans import bump, push, tone, tuned, waves

RATE = 50.0


def layout(*counts):
    at = tuple(np.arange(n) for n in counts)
    return Layout(tuple(np.ones(n - 1, bool) for n in counts), at, tuple(a / RATE for a in at))


def test_a_tone_is_found_where_it_is_and_its_gain_is_its_power():
    where, rng = layout(2000), np.random.default_rng(1)
    t = where.stamps[0]
    y = 0.5 * np.sin(2 * np.pi * 3.217 * t + 1.0) + rng.standard_normal(t.size)
    found = tone(y, where)
    assert found.place == pytest.approx(3.217, abs=0.01)
    # amplitude squared times half the outputs over the variance, and two of chance
    assert found.peak == pytest.approx(0.125 * t.size, rel=0.3)
    assert tuned(y, where, found.place, lambda x: x) == pytest.approx(3.217, abs=2e-3)


def test_a_push_is_found_in_its_recording_at_its_time():
    where, rng = layout(1000, 1500), np.random.default_rng(2)
    y = rng.standard_normal(2500)
    y[1000 + 600 : 1000 + 640] += 2.0
    found = push(y, where, 0.25)
    assert found.recording == 1
    assert found.place == pytest.approx(12.4, abs=0.3)


def test_what_a_scan_has_found_is_what_its_columns_take_out():
    where = layout(1000, 1500)
    t = np.concatenate(where.stamps)
    phases = np.where(np.arange(2500) < 1000, 0.3, 2.0)
    y = np.sin(2 * np.pi * 4.0 * t + phases)
    x = waves(where, 4.0)
    assert np.abs(y - x @ np.linalg.lstsq(x, y)[0]).max() < 1e-9
    y = np.exp(-0.5 * ((t - 7.1) / 0.25) ** 2) * (np.arange(2500) >= 1000)
    found = push(y, where, 0.25)
    x = bump(where, found, 0.25)
    assert np.abs(y - x @ np.linalg.lstsq(x, y)[0]).max() < 0.02
