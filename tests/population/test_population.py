"""The population of runs: exact posteriors of normal toys, limits, and coverage."""

import numpy as np
import pytest
from scipy import stats

from bayesfric.population.population import population, with_outliers


def test_normal_runs_have_the_posterior_of_the_closed_form():
    """Of the spread, whose density is a sum over its grid with the mean integrated exactly."""
    y, s = np.array([0.3, 1.9, -0.8, 2.6, 1.1, 0.2]), np.array([0.5, 0.9, 0.7, 0.4, 1.2, 0.6])
    tau = np.geomspace(1e-4, 1e4, 20_000)
    v = s**2 + tau[:, None] ** 2
    total = (1.0 / v).sum(axis=1)
    centre = (y / v).sum(axis=1) / total
    log = 0.5 * np.log((1.0 / v**2).sum(axis=1)) + 2.0 * np.log(tau)  # the prior, of log tau
    log -= 0.5 * (np.log(v) + (y - centre[:, None]) ** 2 / v).sum(axis=1) + 0.5 * np.log(total)
    cdf = np.cumsum(np.exp(log - log.max()))
    for level in (0.1, 0.5, 0.9):
        spread = population(y, s, level).spread
        shares = np.interp([spread.low, spread.high], tau, cdf / cdf[-1])
        # three standard errors of 8000 draws, and the grid
        expected = [0.5 - level / 2.0, 0.5 + level / 2.0]
        assert shares == pytest.approx(expected, abs=3 * 0.5 / np.sqrt(8000) + 0.01)


@pytest.mark.parametrize("scale", [1.0, 1e-7, 1e6])
def test_far_above_their_sds_runs_give_students_t_and_chi_squares(scale):
    """tau^2 >> s^2: the reference prior is 1/tau, whose intervals are exact in any sample."""
    y = scale * np.array([3.0, 5.0, 8.5, 4.0, 11.0, 6.5])
    result = population(y, np.full(6, 1e-3 * scale), 0.9)
    half = stats.t.ppf(0.95, 5) * y.std(ddof=1) / np.sqrt(6)
    error = 0.05 * half  # of a quantile of 8000 draws
    assert result.mean.low == pytest.approx(y.mean() - half, abs=error)
    assert result.mean.high == pytest.approx(y.mean() + half, abs=error)
    ends = y.std(ddof=1) * np.sqrt(5.0 / stats.chi2.ppf([0.95, 0.05], 5))
    assert [result.spread.low, result.spread.high] == pytest.approx(ends, rel=0.05)
    reach = stats.t.ppf(0.95, 5) * y.std(ddof=1) * np.sqrt(1.0 + 1.0 / 6.0)
    assert result.following.high - result.following.low == pytest.approx(2.0 * reach, rel=0.05)
    # what each run says by itself is left as it is
    assert result.runs[0].median == pytest.approx(y[0], rel=1e-3)


def test_a_far_value_without_precision_moves_nothing():
    near = population([1.0, 1.2, 1.1], [0.1, 0.1, 0.1])
    far = population([1.0, 1.2, 1.1, 50.0], [0.1, 0.1, 0.1, 1e6])
    assert far.mean.median == pytest.approx(near.mean.median, abs=0.02)


def test_cochrans_q_has_its_closed_form():
    y, s = np.array([1.0, 1.5, 3.0]), np.array([0.5, 0.25, 1.0])
    result = population(y, s)
    w = 1.0 / s**2
    q = (w * (y - np.average(y, weights=w)) ** 2).sum()
    assert result.q == pytest.approx(q, rel=1e-12)
    assert result.p_value == pytest.approx(stats.chi2.sf(q, 2), rel=1e-12)


def test_no_value_is_below_its_bound():
    """Two runs far apart leave a normal population room below zero, where no friction is."""
    result = population([0.1, 0.9], [0.01, 0.01], lower=0.0)
    assert (result.mean.low, result.following.low) == (0.0, 0.0)
    assert result.following.high > 0.9


@pytest.mark.parametrize("method", [population, with_outliers])
def test_a_population_takes_two_runs(method):
    with pytest.raises(ValueError, match="two runs"):
        method([1.0], [1.0])


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


def test_outliers_have_the_posterior_of_the_dense_grid():
    y = np.array([0.0, 0.6, -0.5, 0.3, 7.0, 0.1, -0.2])
    s = np.array([0.3, 0.4, 0.3, 0.5, 0.6, 0.2, 0.4])
    chances, mean = brute_force(y, s)
    result = with_outliers(y, s)
    assert result.outlying == pytest.approx(chances, abs=0.03)
    assert result.outlying[4] > 0.8
    # the median of 8000 draws, where the mean of them would lean on the far tail
    assert result.mean.median == pytest.approx(mean, abs=0.1)


def test_units_of_measure_change_no_probability():
    scale = 1e-6
    y, s = np.array([0.0, 0.6, -0.5, 0.3, 7.0]), np.array([0.3, 0.4, 0.3, 0.5, 0.6])
    first, second = (with_outliers(k * y, k * s) for k in (1.0, scale))
    assert second.outlying == pytest.approx(first.outlying, rel=1e-6)
    assert second.spread.high == pytest.approx(scale * first.spread.high, rel=1e-6)


def units(seed, n, worn):
    """Draw true values and sds of a population of mean 5 and sd 0.2, the first few worn."""
    rng = np.random.default_rng(seed)
    true = 5.0 + 0.2 * rng.standard_normal(n)
    true[:worn] += 0.2 * rng.uniform(6.0, 12.0, worn)
    s = rng.uniform(0.05, 0.2, n)
    return true, s, rng


def test_worn_units_are_outliers_and_widen_nothing():
    true, s, rng = units(0, 300, 5)
    result = with_outliers(true + s * rng.standard_normal(300), s)
    assert set(np.argsort(result.outlying)[-5:]) == set(range(5))
    assert min(result.outlying[:5]) > 0.5
    assert result.spread.low < 0.2 < result.spread.high
    # with them the sd of true values is another one
    assert result.spread.high < true.std()


@pytest.mark.slow
def test_intervals_cover_at_their_level():
    covered, first = np.zeros(2), []
    repetitions = 100
    for seed in range(repetitions):
        true, s, rng = units(seed, 400, 4)
        result = with_outliers(true + s * rng.standard_normal(400), s)
        covered += [
            result.mean.low < 5.0 < result.mean.high,
            result.spread.low < 0.2 < result.spread.high,
        ]
        first.append(set(range(4)) <= set(np.argsort(result.outlying)[-8:]))
    # 90 %, and what chance does to a hundred of them (p = 0.001)
    low, high = stats.binom.ppf([0.0005, 0.9995], repetitions, 0.9)
    assert all(low <= count <= high for count in covered), covered
    assert np.mean(first) > 0.95
