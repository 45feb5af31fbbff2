"""Populations with outliers: brute force, and coverage."""

import numpy as np
import pytest
from scipy import stats

from bayesfric.population.population import likelihood, normal, with_outliers


def brute_force(y, s):
    """Probability of each run to be an outlier, and the mean of mu, on a plain dense grid."""
    typical = np.median(s)
    mu = np.linspace(y.min() - 6, y.max() + 6, 260)[:, None, None, None]
    log_tau = np.linspace(np.log(1e-3), np.log(100.0), 110)[None, :, None, None]
    log_e = np.linspace(np.log(1e-4), np.log(0.4), 30)[None, None, :, None]
    tau, e = np.exp(log_tau), np.exp(log_e)
    inside = stats.norm.pdf(y, mu, np.sqrt(s**2 + tau**2))
    outside = sum(
        stats.norm.pdf(y, mu, np.sqrt(s**2 + k**2 * (tau**2 + typical**2))) / 3
        for k in (3.0, 10.0, 30.0)
    )
    both = (1 - e) * inside + e * outside
    prior = tau**2 * np.sqrt((1 / (s**2 + tau**2) ** 2).sum(axis=-1, keepdims=True))
    weight = both.prod(axis=-1, keepdims=True) * prior * (1 - e) ** 18 * e
    weight /= weight.sum()
    return (weight * e * outside / both).sum(axis=(0, 1, 2)), float((weight * mu).sum())


def test_it_is_the_posterior_of_its_model():
    y = np.array([0.0, 0.6, -0.5, 0.3, 7.0, 0.1, -0.2])
    s = np.array([0.3, 0.4, 0.3, 0.5, 0.6, 0.2, 0.4])
    chances, mean = brute_force(y, s)
    found = with_outliers([normal(m, sd) for m, sd in zip(y, s, strict=True)])
    assert found.outlying == pytest.approx(chances, abs=0.03)
    assert found.outlying[4] > 0.8
    # the median of 8000 draws, where the mean of them would lean on the far tail
    assert found.mean.median == pytest.approx(mean, abs=0.1)


def test_units_of_measure_change_nothing():
    scale = 1e-6
    y, s = np.array([0.0, 0.6, -0.5, 0.3, 7.0]), np.array([0.3, 0.4, 0.3, 0.5, 0.6])
    runs = [[normal(k * m, k * sd) for m, sd in zip(y, s, strict=True)] for k in (1.0, scale)]
    one, other = map(with_outliers, runs)
    assert other.outlying == pytest.approx(one.outlying, rel=1e-6)
    assert other.spread.high == pytest.approx(scale * one.spread.high, rel=1e-6)


def made(seed, n, worn):
    """Draw what units say of a population of mean 5 and sd 0.2, the first few worn."""
    rng = np.random.default_rng(seed)
    true = 5.0 + 0.2 * rng.standard_normal(n)
    true[:worn] += 0.2 * rng.uniform(6.0, 12.0, worn)
    s = rng.uniform(0.05, 0.2, n)
    return true, s, rng


def test_worn_units_are_found_and_widen_nothing():
    true, s, rng = made(0, 300, 5)
    runs = [
        likelihood(t + e * (rng.standard_normal() + rng.standard_normal(300)), e)
        for t, e in zip(true, s, strict=True)
    ]
    found = with_outliers(runs)
    assert set(np.argsort(found.outlying)[-5:]) == set(range(5))
    assert min(found.outlying[:5]) > 0.5
    assert found.spread.low < 0.2 < found.spread.high
    # with them the sd of true values is another one
    assert found.spread.high < true.std()


@pytest.mark.slow
def test_intervals_hold_what_they_say():
    held, first = np.zeros(2), []
    repetitions = 100
    for seed in range(repetitions):
        true, s, rng = made(seed, 400, 4)
        runs = [normal(t + e * rng.standard_normal(), e) for t, e in zip(true, s, strict=True)]
        found = with_outliers(runs)
        held += [found.mean.low < 5.0 < found.mean.high, found.spread.low < 0.2 < found.spread.high]
        first.append(set(range(4)) <= set(np.argsort(found.outlying)[-8:]))
    # 90 %, and what chance does to a hundred of them (p = 0.001)
    low, high = stats.binom.ppf([0.0005, 0.9995], repetitions, 0.9)
    assert all(low <= one <= high for one in held), held
    assert np.mean(first) > 0.95
