"""The population of runs: exact posteriors of normal toys, limits, and coverage."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad

from bayesfric.population.population import likelihood, normal, population


def exact(y, s):
    """Posterior mean of mu and of tau for normal runs, by quadrature of the closed form."""

    def log_marginal(tau):
        v = s**2 + tau**2
        total = (1.0 / v).sum()
        centre = (y / v).sum() / total
        prior = 0.5 * np.log((tau**2 / v**2).sum())
        return prior - 0.5 * np.log(v).sum() - 0.5 * np.log(total) - 0.5 * (
            (y - centre) ** 2 / v
        ).sum(), centre

    top = max(log_marginal(t)[0] for t in np.geomspace(1e-3, 1e3, 500))

    def integral(f):
        ends = [0.0, 0.1, 0.5, 1.0, 2.0, 5.0, 20.0, 200.0]
        return sum(
            quad(lambda t: f(*log_marginal(t), t), a, b, limit=200)[0] for a, b in pairwise(ends)
        )

    norm = integral(lambda log, _, __: np.exp(log - top))
    mean = integral(lambda log, centre, _: np.exp(log - top) * centre) / norm
    below = {
        t: integral(lambda log, _, tau, t=t: np.exp(log - top) * (tau < t)) / norm
        for t in (0.5, 1.0, 2.0, 5.0)
    }
    return mean, below


def test_normal_runs_have_the_posterior_of_the_closed_form():
    y, s = np.array([0.3, 1.9, -0.8, 2.6, 1.1, 0.2]), np.array([0.5, 0.9, 0.7, 0.4, 1.2, 0.6])
    _, below = exact(y, s)
    runs = [normal(m, sd) for m, sd in zip(y, s, strict=True)]
    # the share of the draws below each spread, by intervals of several levels
    for tau, share in below.items():
        levels = np.linspace(0.04, 0.96, 12)
        ends = [population(runs, level).spread for level in levels]
        cdf = sorted(
            [(one.low, 0.5 - k / 2) for one, k in zip(ends, levels, strict=True)]
            + [(one.high, 0.5 + k / 2) for one, k in zip(ends, levels, strict=True)]
        )
        found = np.interp(tau, *zip(*cdf, strict=True))
        # three standard errors of 8000 draws, and the interpolation
        assert found == pytest.approx(share, abs=3 * 0.5 / np.sqrt(8000) + 0.01)


@pytest.mark.parametrize("scale", [1.0, 1e-7, 1e6])
def test_far_above_their_sds_runs_give_students_t_and_chi_squares(scale):
    """tau^2 >> s^2: the reference prior is 1/tau, whose intervals are exact in any sample."""
    y = scale * np.array([3.0, 5.0, 8.5, 4.0, 11.0, 6.5])
    found = population([normal(one, 1e-3 * scale) for one in y], 0.9)
    half = stats.t.ppf(0.95, 5) * y.std(ddof=1) / np.sqrt(6)
    error = 0.05 * half  # of a quantile of 8000 draws
    assert found.mean.low == pytest.approx(y.mean() - half, abs=error)
    assert found.mean.high == pytest.approx(y.mean() + half, abs=error)
    ends = y.std(ddof=1) * np.sqrt(5.0 / stats.chi2.ppf([0.95, 0.05], 5))
    assert [found.spread.low, found.spread.high] == pytest.approx(ends, rel=0.05)
    reach = stats.t.ppf(0.95, 5) * y.std(ddof=1) * np.sqrt(1.0 + 1.0 / 6.0)
    assert found.following.high - found.following.low == pytest.approx(2.0 * reach, rel=0.05)
    # what each run says by itself is left as it is
    assert found.runs[0].median == pytest.approx(y[0], rel=1e-3)


def test_runs_that_are_all_one_value_are_drawn_together():
    found = population([normal(2.0, 1.0) for _ in range(40)], 0.9)
    assert found.agree
    assert found.spread.high < 0.6
    for run in found.runs:
        assert run.high - run.low < 2 * 1.645


def test_a_far_value_without_precision_moves_nothing():
    near = population([normal(1.0, 0.1), normal(1.2, 0.1), normal(1.1, 0.1)])
    far = population([normal(1.0, 0.1), normal(1.2, 0.1), normal(1.1, 0.1), normal(50.0, 1e6)])
    assert far.mean.median == pytest.approx(near.mean.median, abs=0.02)


def test_cochrans_q_has_its_closed_form():
    y, s = np.array([1.0, 1.5, 3.0]), np.array([0.5, 0.25, 1.0])
    found = population([normal(m, sd) for m, sd in zip(y, s, strict=True)])
    w = 1.0 / s**2
    q = (w * (y - np.average(y, weights=w)) ** 2).sum()
    assert found.q == pytest.approx(q, rel=1e-12)
    assert found.p_value == pytest.approx(stats.chi2.sf(q, 2), rel=1e-12)


def test_a_likelihood_has_the_moments_of_its_draws():
    draws = np.random.default_rng(1).gamma(4.0, size=20_000)
    found = likelihood(draws)
    assert found.mean == pytest.approx(draws.mean(), rel=0.01)
    assert found.sd == pytest.approx(draws.std(), rel=0.02)
    assert likelihood(draws, sd=3.0 * draws.std()).sd == pytest.approx(3.0 * draws.std(), rel=0.02)


def test_a_prior_is_divided_out_once():
    """Posterior N(0.8, 0.8) under a N(0, 4) prior: the data said N(1, 1)."""
    rng = np.random.default_rng(2)
    posterior = 0.8 + np.sqrt(0.8) * rng.standard_normal(20_000)
    found = likelihood(posterior, prior=2.0 * rng.standard_normal(5000))
    # the likelihood ends where the draws do, some three sds out
    assert found.mean == pytest.approx(1.0, abs=0.05)
    assert found.sd == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("runs", [[], [normal(1.0, 1.0)]])
def test_one_run_is_no_population(runs):
    with pytest.raises(ValueError, match="two runs"):
        population(runs)


def test_draws_that_do_not_differ_are_no_likelihood():
    with pytest.raises(ValueError, match="do not differ"):
        likelihood(np.ones(100))
