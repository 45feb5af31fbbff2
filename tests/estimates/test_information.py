"""Standard deviations: plain and correlated, null directions, groups, gaps, told values."""

import numpy as np
import pytest
from scipy.signal import lfilter

from bayesfric.estimates.autoregression import long_run_variance
from bayesfric.estimates.information import Information


def autoregression(rng, n, rho, burn=200):
    """First-order autoregression of innovations with variance one."""
    return lfilter([1.0], [1.0, -rho], rng.standard_normal(n + burn))[burn:]


def regressors(n, seed=0):
    """A constant and two slow waves: scores of these are as correlated as the errors."""
    t = np.arange(n) / n
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, 2)
    return np.stack(
        [np.ones(n), np.sin(6 * np.pi * t + phase[0]), np.cos(14 * np.pi * t + phase[1])], axis=1
    )


def fit(x, y):
    solution = np.linalg.lstsq(x, y, rcond=None)[0]
    return solution, y - x @ solution


def test_plain_sds_are_the_textbooks():
    rng = np.random.default_rng(1)
    x = rng.standard_normal((200, 3)) * [1.0, 1e-4, 1e3]
    solution, residual = fit(x, x @ [1.0, 2.0, 3.0] + rng.standard_normal(200))
    information = Information(x, residual, np.abs(solution))
    sigma2 = residual @ residual / 197
    expected = np.sqrt(np.diag(np.linalg.inv(x.T @ x / np.outer([1, 1e-4, 1e3], [1, 1e-4, 1e3]))))
    for j in range(3):
        sd, _ = information.sds(np.eye(3)[j])
        assert sd == pytest.approx(np.sqrt(sigma2) * expected[j] / [1, 1e-4, 1e3][j], rel=1e-9)
    # a combination has the variance of its gradient
    gradient = np.array([1.0, -2e-4, 1e3])
    covariance = sigma2 * np.linalg.inv(x.T @ x)
    assert information.sds(gradient)[0] == pytest.approx(
        np.sqrt(gradient @ covariance @ gradient), rel=1e-6
    )
    assert information.sds(np.zeros(3)) == (0.0, 0.0)


@pytest.mark.parametrize("n", [600, 4000])
def test_robust_sds_are_those_of_autoregressive_errors(n):
    rho, repeats = 0.7, 300
    x = regressors(n)
    rng = np.random.default_rng(11)
    found, claimed, plain = (np.empty((repeats, 3)) for _ in range(3))
    for i in range(repeats):
        solution, residual = fit(x, autoregression(rng, n, rho))
        information = Information(x, residual, np.ones(3))
        sds = np.array([information.sds(row) for row in np.eye(3)])
        found[i], plain[i], claimed[i] = solution, sds[:, 0], sds[:, 1]
    spread = found.std(axis=0, ddof=1)
    # Andrews 1991: bias of the variance -1.4212 sqrt(alpha)/S² with the kernel's width S,
    # and about -S d/n because residuals are less correlated than errors
    alpha = 4 * rho**2 / (1 - rho) ** 4
    width = 1.3221 * (alpha * n) ** 0.2
    bias = 1.4212 * np.sqrt(alpha) / width**2 + 3 * width / n
    ratio = np.sqrt((claimed**2).mean(axis=0)) / spread
    error = 5 / np.sqrt(2 * repeats)
    assert (ratio < 1.0 + error).all()
    assert (ratio > np.sqrt(1.0 - bias) - error).all()
    # the plain sd is too small by about sqrt((1 + rho)/(1 - rho)) = 2.4 on slow regressors
    assert (spread / plain.mean(axis=0) > 2.0).all()


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.7, -0.5])
def test_long_run_variance_is_that_of_the_closed_form(rho):
    """Variance of a sum of n of an AR(1) with innovations of one: n/(1 - rho)²."""
    n, repeats = 20_000, 20
    rng = np.random.default_rng(3)
    found = [
        long_run_variance(autoregression(rng, n, rho), np.arange(n)) / n for _ in range(repeats)
    ]
    alpha = 4 * rho**2 / (1 - rho) ** 4
    width = 1.3221 * max(alpha * n, 1.0) ** 0.2
    expected = 1.0 / (1.0 - rho) ** 2
    # Andrews 1991, (3.2): bias and variance for the quadratic spectral kernel. The bias is
    # first order in 1/S²; a quarter of it is left for higher orders.
    bias = -1.4212 * 2 * rho / (1 - rho) ** 2 / width**2
    error = 5 * np.sqrt(2 * width / n / repeats)
    assert np.mean(found) / expected - 1.0 == pytest.approx(bias, abs=error + 0.25 * abs(bias))


def test_neighbours_across_a_gap_are_no_neighbours():
    """Samples far apart are uncorrelated, whatever stands next to them in memory."""
    rng = np.random.default_rng(5)
    series = rng.standard_normal(4000)
    together = long_run_variance(series, np.arange(4000))
    # spread so that no two are neighbours: nothing but the sum of squares is left
    apart = long_run_variance(series, np.arange(4000) * 50)
    assert apart == pytest.approx(series @ series, rel=1e-9)
    assert together == pytest.approx(series @ series, rel=0.3)


def test_groups_take_any_correlation_within():
    """All members of a group share one error: the sd is that of the groups' means."""
    groups, size, repeats = 80, 25, 300
    number = np.repeat(np.arange(groups), size)
    rng = np.random.default_rng(6)
    level = rng.standard_normal(groups)
    x = np.stack([np.ones(number.size), level[number]], axis=1)
    found, claimed = np.empty((repeats, 2)), np.empty((repeats, 2))
    for i in range(repeats):
        errors = rng.standard_normal(groups)[number] + 0.1 * rng.standard_normal(number.size)
        solution, residual = fit(x, errors)
        information = Information(x, residual, np.ones(2), groups=number)
        found[i] = solution
        claimed[i] = [information.sds(row)[1] for row in np.eye(2)]
    ratio = np.sqrt((claimed**2).mean(axis=0)) / found.std(axis=0, ddof=1)
    # cluster sums lose a leverage of about d/groups each
    np.testing.assert_allclose(ratio, 1.0, atol=5 / np.sqrt(2 * repeats) + 2 * 2 / groups)


def test_too_few_groups_fall_back_on_neighbours():
    rng = np.random.default_rng(7)
    x = regressors(300)
    _, residual = fit(x, rng.standard_normal(300))
    few = Information(x, residual, np.ones(3), groups=np.repeat(np.arange(3), 100))
    none = Information(x, residual, np.ones(3))
    assert few.sds(np.eye(3)[1]) == none.sds(np.eye(3)[1])


def test_null_directions_have_no_sd_and_what_is_across_them_has():
    rng = np.random.default_rng(8)
    x = rng.standard_normal((300, 2))
    # only b + 2 c shows
    jacobian = np.stack([x[:, 0], x[:, 1], 2 * x[:, 1]], axis=1)
    residual = rng.standard_normal(300)
    information = Information(jacobian, residual, np.ones(3))
    assert information.directions.null.tolist() == [False, False, True]
    assert information.freedom == 298
    assert information.sds(np.array([0.0, 1.0, 0.0])) == (np.inf, np.inf)
    assert information.sds(np.array([0.0, 0.0, 1.0])) == (np.inf, np.inf)
    seen = Information(x, residual, np.ones(2))
    assert information.sds(np.array([0.0, 1.0, 2.0])) == pytest.approx(
        seen.sds(np.array([0.0, 1.0])), rel=1e-9
    )
    assert information.sds(np.array([1.0, 0.0, 0.0])) == pytest.approx(
        seen.sds(np.array([1.0, 0.0])), rel=1e-9
    )


def test_units_do_not_change_what_is_known():
    rng = np.random.default_rng(9)
    x = rng.standard_normal((200, 2))
    _, residual = fit(x, rng.standard_normal(200))
    one = Information(x, residual, np.ones(2)).sds(np.array([1.0, 1.0]))
    other = Information(x, residual, np.array([1e-3, 50.0])).sds(np.array([1.0, 1.0]))
    assert other == pytest.approx(one, rel=1e-9)


def test_told_values_add_their_information():
    """Inverse variances of independent knowledge of one number add."""
    rng = np.random.default_rng(10)
    x = rng.standard_normal((400, 1))
    _, residual = fit(x, rng.standard_normal(400))
    alone, _ = Information(x, residual, np.ones(1)).sds(np.ones(1))
    told = 0.7 * alone
    both, robust = Information(x, residual, np.ones(1), known=np.array([[1 / told]])).sds(
        np.ones(1)
    )
    assert both == pytest.approx((alone**-2 + told**-2) ** -0.5, rel=1e-9)
    # a white residual's robust sd is the plain one but for its noise
    assert robust == pytest.approx(both, rel=5 * np.sqrt(3 / 400))


def test_told_values_close_null_directions():
    rng = np.random.default_rng(11)
    x = rng.standard_normal(300)
    residual = 0.1 * rng.standard_normal(300)
    jacobian = np.stack([x, x], axis=1)
    information = Information(jacobian, residual, np.ones(2), known=np.array([[0.0, 1 / 0.2]]))
    sd = information.sds(np.array([0.0, 1.0]))[0]
    assert sd == pytest.approx(0.2, rel=1e-9)
    sum_sd = information.sigma / np.linalg.norm(x)
    assert information.sds(np.array([1.0, 0.0]))[0] == pytest.approx(np.hypot(0.2, sum_sd))
