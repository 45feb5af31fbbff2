"""Standard deviations and sums over time and groups, each written out as a double sum."""

import numpy as np
import pytest
from scipy.linalg import null_space

from bayesfric.estimates.autoregression import lag_one, long_run_variance
from bayesfric.estimates.information import Information, directions


def kernel(x):
    """Quadratic spectral kernel, Andrews (1991), eq. 2.7."""
    y = 6.0 * np.pi * x / 5.0
    return 1.0 if y < 1e-4 else 25.0 / (12.0 * (np.pi * x) ** 2) * (np.sin(y) / y - np.cos(y))


def written_out(score, places):
    """Every pair of terms, weighed by how far apart they stand, Andrews's eqs. 6.2 and 6.4."""
    pairs = [(i, i + 1) for i in range(score.size - 1) if places[i + 1] == places[i] + 1]
    rho = 0.0
    if pairs:
        mean = sum(score[i] * score[j] for i, j in pairs) / len(pairs)
        rho = np.clip(mean / np.mean(score**2), -0.97, 0.97)
    width = 1.3221 * (4.0 * rho**2 / (1.0 - rho) ** 4 * score.size) ** 0.2
    total = 0.0
    for i, a in enumerate(score):
        for j, b in enumerate(score):
            if i == j:
                total += a * b
            elif width > 0.0:
                total += kernel(abs(places[i] - places[j]) / width) * a * b
    return max(total, 0.0)


@pytest.mark.parametrize("rho", [-0.6, 0.0, 0.4, 0.9])
def test_the_long_run_variance_is_the_weighted_sum_of_all_pairs(rho):
    rng = np.random.default_rng(1)
    score = rng.standard_normal(120)
    for i in range(1, 120):
        score[i] += rho * score[i - 1]
    for gaps in ([], [3], [40, 41, 90]):
        places = 7 + np.arange(120) + np.searchsorted(gaps, np.arange(120)) * 6
        expected = written_out(score, places)
        assert long_run_variance(score, places) == pytest.approx(expected, rel=1e-5)
    assert long_run_variance(score[:1], np.array([5])) == pytest.approx(score[0] ** 2)
    assert long_run_variance(0.0 * score, places) == 0.0


def problem(known=0, collinear=False):
    """Random Jacobian in very different units, correlated residuals, and what is known."""
    rng = np.random.default_rng(2)
    units = np.array([1.0, 1e-4, 1e3, 0.2])
    jacobian = rng.standard_normal((90, 4)) / units
    if collinear:
        jacobian[:, 3] = 2.0 * jacobian[:, 2]
    residual = np.convolve(rng.standard_normal(92), [1.0, 1.0, 1.0], "valid")
    rows = np.eye(4)[:known] / np.array([0.5, 1e-4, 1.0, 1.0])[:known, None]
    return jacobian, residual, units, rows


@pytest.mark.parametrize("known", [0, 2])
@pytest.mark.parametrize("lost", [0, 9])
def test_sds_are_the_sandwich_s(known, lost):
    jacobian, residual, units, rows = problem(known)
    places = np.arange(90) + 30 * (np.arange(90) > 50)
    information = Information(jacobian, residual, units, places=places, known=rows, lost=lost)
    freedom = 90 - 4 - lost
    variance = residual @ residual / freedom
    assert information.freedom == freedom
    assert information.sigma == pytest.approx(np.sqrt(variance))
    whole = jacobian.T @ jacobian + variance * rows.T @ rows
    for gradient in (*np.eye(4), np.array([1.0, -2e4, 1e-3, 3.0])):
        weight = np.linalg.solve(whole, gradient)
        effect, by_known = jacobian @ weight, variance**2 * np.sum((rows @ weight) ** 2)
        plain, robust = information.sds(gradient)
        assert plain == pytest.approx(np.sqrt(variance * gradient @ weight), rel=1e-6)
        meat = 90.0 / freedom * written_out(effect * residual, places)
        assert robust == pytest.approx(np.sqrt(meat + by_known), rel=1e-5)
        assert information.directions.sd(gradient) == pytest.approx(
            plain / np.sqrt(variance), rel=1e-6
        )


def test_residuals_have_at_least_the_sd_of_the_encoder():
    jacobian, residual, units, _ = problem()
    coarse = Information(jacobian, residual, units, least=10.0)
    fine = Information(jacobian, residual, units, least=1e-3)
    assert coarse.sigma == 10.0
    assert fine.sigma == pytest.approx(np.sqrt(residual @ residual / 86))
    assert Information(jacobian[:3], residual[:3], units).freedom == 1


@pytest.mark.parametrize("collinear", [False, True])
def test_groups_are_weighed_by_what_they_leave_to_others(collinear):
    """Bell and McCaffrey: ``(1 - H)^(-1/2)`` of a group's own residuals, where one leaves any."""
    jacobian, residual, units, _ = problem(collinear=collinear)
    group = np.random.default_rng(3).permutation(np.repeat(np.arange(15), 6))
    information = Information(jacobian, residual, units, groups=group + 4)
    seen = jacobian[:, :3] if collinear else jacobian
    inverse = np.linalg.inv(seen.T @ seen)
    meat = np.zeros((seen.shape[1], seen.shape[1]))
    for k in range(15):
        rows = seen[group == k]
        values, vectors = np.linalg.eigh(np.eye(6) - rows @ inverse @ rows.T)
        root = vectors / np.sqrt(values) @ vectors.T
        score = rows.T @ root @ residual[group == k]
        meat += np.outer(score, score)
    covariance = inverse @ meat @ inverse
    for j, row in enumerate(np.eye(4)[: 2 if collinear else 4]):
        assert information.sds(row)[1] == pytest.approx(np.sqrt(covariance[j, j]), rel=1e-6)
    if collinear:
        assert information.sds(np.eye(4)[3]) == (np.inf, np.inf)
        assert information.sds(np.array([0.0, 0.0, 1.0, 2.0]))[1] == pytest.approx(
            np.sqrt(covariance[2, 2]), rel=1e-6
        )


def test_what_theory_says_is_open_is_open_whatever_differences_say():
    """A direction whose derivatives are only nearly zero; functions that do not change along it."""
    jacobian, residual, units, _ = problem()
    along = np.array([0.5, 2e-4, -1e3, 0.1])
    off = null_space((along / units)[None])
    blurred = (jacobian * units) @ (off @ off.T) / units
    blurred += 1e-4 * jacobian
    found = directions(blurred, units, known_null=along[None])
    assert found.null.tolist() == [False, False, False, True]
    assert abs(found.rows[3] @ (along / units)) == pytest.approx(np.linalg.norm(along / units))
    assert not directions(blurred, units).null.any()
    # the told rows make the same information as what is seen off that direction
    seen = (blurred * units) @ off @ off.T
    np.testing.assert_allclose(found.identified.T @ found.identified, seen.T @ seen, atol=1e-9)
    gradient = np.array([1.0, 3e3, 2e-3, 1.0])
    left = found.off_known(gradient)
    assert left @ along == pytest.approx(0.0, abs=1e-12)
    # what is taken off points along it, in units
    taken, way = (gradient - left) * units, along / units
    np.testing.assert_allclose(taken, way * (taken @ way) / (way @ way), rtol=1e-9)
    assert found.solve(gradient) is None
    expected = np.linalg.pinv(seen.T @ seen) @ (left * units) * units
    np.testing.assert_allclose(found.solve(left), expected, rtol=1e-6)
    assert directions(jacobian, units).off_known(gradient) is gradient
    information = Information(blurred, residual, units, known_null=along[None])
    assert information.freedom == 90 - 3


def test_neighbours_correlation_is_the_mean_of_their_products():
    rng = np.random.default_rng(5)
    x = rng.standard_normal(40)
    follows = np.ones(39, dtype=bool)
    follows[[4, 20]] = False
    products = [x[i] * x[i + 1] for i in range(39) if i not in (4, 20)]
    assert lag_one(x, follows) == pytest.approx(np.mean(products) / np.mean(x**2))
    assert np.isnan(lag_one(0.0 * x, follows))
    assert np.isnan(lag_one(x[:10], follows[:9]))
    assert np.isfinite(lag_one(x[21:32], follows[21:31]))


def regressors(n, seed=0):
    """A constant and two slow waves: scores of these are as correlated as the errors."""
    t = np.arange(n) / n
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, 2)
    return np.stack(
        [np.ones(n), np.sin(6 * np.pi * t + phase[0]), np.cos(14 * np.pi * t + phase[1])], axis=1
    )


def test_too_few_groups_fall_back_on_neighbours():
    x, residual = regressors(300), np.random.default_rng(7).standard_normal(300)
    few = Information(x, residual, np.ones(3), groups=np.repeat(np.arange(3), 100))
    none = Information(x, residual, np.ones(3))
    assert few.sds(np.eye(3)[1]) == none.sds(np.eye(3)[1])


def test_null_directions_have_no_sd_and_what_is_across_them_has():
    rng = np.random.default_rng(8)
    x = rng.standard_normal((300, 2))
    # only b + 2 c has an effect
    jacobian = np.stack([x[:, 0], x[:, 1], 2 * x[:, 1]], axis=1)
    residual = rng.standard_normal(300)
    information = Information(jacobian, residual, np.ones(3))
    assert information.directions.null.tolist() == [False, False, True]
    assert information.freedom == 298
    direct = Information(x, residual, np.ones(2))
    for gradient, same in (((0.0, 1.0, 2.0), (0.0, 1.0)), ((1.0, 0.0, 0.0), (1.0, 0.0))):
        expected = direct.sds(np.array(same))
        assert information.sds(np.array(gradient)) == pytest.approx(expected, rel=1e-9)
    for row in np.eye(3)[1:]:
        assert information.sds(row) == (np.inf, np.inf)
    # a known value of c closes it, and b is the sum less twice that
    known = Information(jacobian, residual, np.ones(3), known=np.array([[0.0, 0.0, 1 / 0.2]]))
    assert known.sds(np.eye(3)[2])[0] == pytest.approx(0.2, rel=1e-9)
    of_sum = information.sds(np.array([0.0, 1.0, 2.0]))[0]
    assert known.sds(np.eye(3)[1])[0] == pytest.approx(np.hypot(2 * 0.2, of_sum), rel=1e-3)
