"""Smooth dependences of correlated residuals: found, and as seldom found where there is none."""

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

from bayesfric.report.summary.dependence import smooth_p_value

TIMES = 1000
MEMORIES = {"white": [1.0], "AR(1)": [1.0, -0.97], "AR(2)": [1.0, -1.8, 0.85]}


def swung(rng):
    """Speed, columns of a model without quadratic loss, and that loss, of 26 s at 50 Hz."""
    time = np.arange(1300) / 50.0
    q = v = a = 0.0
    for frequency, size in ((0.5, 0.6), (0.9, 0.3)):
        w, phase = 2.0 * np.pi * frequency, rng.uniform(0.0, 2.0 * np.pi)
        q = q + size * np.sin(w * time + phase)
        v = v + size * w * np.cos(w * time + phase)
        a = a - size * w**2 * np.sin(w * time + phase)
    columns = np.stack([a, v, np.sign(v), np.sin(q), np.cos(q), np.ones_like(q)], axis=1)
    base = np.linalg.qr(columns)[0]
    lack = v * np.abs(v)
    lack -= base @ (base.T @ lack)
    return v, columns, lack / lack.std()


def noise(memory, n, rng):
    series = lfilter([1.0], memory, rng.standard_normal(n + 300))[300:]
    return series / series.std()


@pytest.mark.parametrize("name", MEMORIES)
def test_chance_is_found_as_often_as_it_says(name):
    rng = np.random.default_rng(21)
    found = np.empty(TIMES)
    for k in range(TIMES):
        v, columns, _ = swung(rng)
        found[k] = smooth_p_value(noise(MEMORIES[name], v.size, rng), v, columns)
    for level in (1e-3, 1e-2, 0.1):
        # as many as come once in ten thousand, were the level exact
        most = stats.binom.isf(1e-4, TIMES, level)
        assert np.count_nonzero(found < level) <= most, level
    assert np.count_nonzero(found < 0.1) >= stats.binom.ppf(1e-4, TIMES, 0.05)


@pytest.mark.parametrize("name", MEMORIES)
def test_a_quadratic_loss_is_found_in_any_noise(name):
    """A third of the variance, in 13 swings."""
    rng = np.random.default_rng(22)
    seen = 0
    for _ in range(100):
        v, columns, lack = swung(rng)
        residual = np.sqrt(0.5) * lack + noise(MEMORIES[name], v.size, rng)
        seen += smooth_p_value(residual, v, columns) < 1e-3
    assert seen >= stats.binom.ppf(1e-4, 100, 0.9)


def test_too_few_swings_and_curves_of_the_model_tell_nothing():
    rng = np.random.default_rng(23)
    v, columns, lack = swung(rng)
    assert smooth_p_value(lack[:200], v[:200], columns[:200]) == 1.0
    assert smooth_p_value(np.zeros_like(v), v, columns) == 1.0
    assert smooth_p_value(lack, v, np.column_stack([columns, v**2, v**3, lack])) > 1e-3
