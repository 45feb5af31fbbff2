"""The whole sampler against posteriors known in closed form."""

import numpy as np
import pytest
from scipy import stats

from bayesfric.inference.fitting import fit, make_target, read_priors
from bayesfric.inference.sampling import Sampling
from bayesfric.inference.start import Start, climb, gauss_newton
from bayesfric.mechanism.joint import PRESETS

AXIS = PRESETS["motor-axis"]
QUICK = Sampling(seed=3, min_ess=4000)


FLAT = {
    "motor.inertia": [0.0, 1.0],
    "motor.viscous": [0.0, 5.0],
    "motor.coulomb": [0.0, 20.0],
    "offset": [-20.0, 20.0],
}


def target_of(observation, priors):
    chain = AXIS.chain()
    return make_target(chain, [observation], read_priors(chain, priors, [observation]), "shared")


@pytest.fixture(scope="module")
def axis_target(make_observation):
    """A linear model with flat priors far from every bound: Student t is exact."""
    observation = make_observation(AXIS.chain(), AXIS.values, sigma=0.02, n=800)
    reference = {"noise.sigma": {"distribution": "loguniform", "a": 1e-6, "b": 10.0}}
    return target_of(observation, FLAT | reference)


def assert_quantiles(draws, ess, distribution, slack=0.0):
    # no more are kept than these, however many were drawn
    n = min(ess, draws.size)
    for p in (0.05, 0.5, 0.95):
        share = (draws < distribution.ppf(p)).mean()
        assert abs(share - p) < 5.0 * np.sqrt(p * (1 - p) / n) + slack, p


def exact(observation):
    """With a prior 1/sigma, the marginals of a linear model are Student t."""
    o = observation
    x = np.stack([o.qdd, o.qd, np.sign(o.qd), np.ones_like(o.q)], axis=1)
    solution, *_ = np.linalg.lstsq(x, o.measured, rcond=None)
    residual = o.measured - x @ solution
    freedom = o.measured.size - 4
    variance = residual @ residual / freedom
    sd = np.sqrt(variance * np.diag(np.linalg.inv(x.T @ x)))
    return solution, sd, freedom, residual @ residual


def test_a_linear_model_has_its_exact_posterior(axis_target):
    result = fit(axis_target, QUICK)
    posterior, ess = result.posterior, result.posterior.diagnostics.ess
    assert posterior.diagnostics.status == "reliable", posterior.diagnostics.problems
    solution, sd, freedom, squares = exact(result.observations[0])
    for j, name in enumerate(FLAT):
        draws = posterior[name].ravel()
        n = min(ess[j], draws.size)
        reference = stats.t(freedom, solution[j], sd[j])
        assert posterior.names[j] == name
        assert abs(draws.mean() - solution[j]) < 5.0 * sd[j] / np.sqrt(n), name
        assert draws.std() / reference.std() == pytest.approx(1.0, abs=5.0 / np.sqrt(2 * n)), name
        assert_quantiles(draws, n, reference)
    # the variance is scaled inverse chi-squared
    variance = stats.invgamma(freedom / 2.0, scale=squares / 2.0)
    assert_quantiles(posterior["noise.sigma"].ravel() ** 2, ess[-1], variance)


def test_a_prior_far_narrower_than_the_data_is_the_posterior(make_observation):
    observation = make_observation(AXIS.chain(), AXIS.values, sigma=0.05, n=300)
    narrow = {"motor.viscous": {"distribution": "norm", "loc": 0.05, "scale": 1e-7}}
    posterior = fit(target_of(observation, narrow), QUICK).posterior
    draws, n = posterior["motor.viscous"].ravel(), posterior.diagnostics.ess.min()
    assert draws.std() == pytest.approx(1e-7, rel=5.0 / np.sqrt(2 * n))
    assert draws.mean() == pytest.approx(0.05, abs=5e-7 / np.sqrt(n))


def test_friction_of_zero_is_a_normal_cut_at_its_bound(make_observation):
    """Exact: a normal likelihood cut at zero, sigma all but known."""
    values = AXIS.values | {"motor.coulomb": 0.0}
    observation = make_observation(AXIS.chain(), values, sigma=0.05, n=3000, seed=5)
    posterior = fit(target_of(observation, FLAT), QUICK).posterior
    solution, sd, _, _ = exact(observation)
    cut = stats.truncnorm(-solution[2] / sd[2], np.inf, solution[2], sd[2])
    ess = posterior.diagnostics.ess[posterior.names.index("motor.coulomb")]
    assert_quantiles(posterior["motor.coulomb"].ravel(), ess, cut, slack=2e-3)


def test_climbing_finds_the_peak_of_a_normal():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(5, 5)) * np.geomspace(0.01, 100.0, 5)[:, None]
    sigma, mean = root @ root.T, rng.normal(size=5)
    precision = np.linalg.inv(sigma)

    def log_density(x):
        return -0.5 * np.einsum("ni,ij,nj->n", x - mean, precision, x - mean)

    mode = climb(log_density, mean + rng.normal(size=(4, 5)) @ root.T)
    assert np.abs(np.linalg.solve(root, mode - mean)).max() < 0.05


def test_the_starting_normal_of_a_linear_model_is_its_posterior(axis_target):
    solution, sd, _, _ = exact(axis_target.likelihood.observations[0])
    parameters = np.append(solution, 0.02)
    shaped = axis_target.with_widths(np.append(sd, 0.001))
    prior_draws = shaped.from_parameters(
        np.stack([p.draw(400, np.random.default_rng(1)) for p in shaped.priors], axis=1)
    )
    start = gauss_newton(shaped, shaped.from_parameters(parameters[None])[0], prior_draws)
    up, _ = shaped.to_parameters(start.mode + np.diag(np.sqrt(np.diag(start.covariance))))
    # the noise scale enters as given here, 0.02, not as estimated
    claimed = np.diag(up)[:4] - solution
    scale = 0.02 / np.sqrt(exact(axis_target.likelihood.observations[0])[3] / 796)
    np.testing.assert_allclose(claimed / scale, sd, rtol=0.02)
    assert np.diag(up)[4] - 0.02 == pytest.approx(0.02 / np.sqrt(2 * 800), rel=0.1)


def test_starts_at_zero_probability_are_redrawn():
    """A density on the positive half only: emcee would keep a bad start for ever."""

    def log_density(x):
        return np.where((x > 0).all(axis=1), -x.sum(axis=1), -np.inf)

    mode = climb(log_density, np.array([[0.5, 0.5]]))
    starts = Start(mode, np.eye(2)).draw(200, log_density, np.random.default_rng(1))
    assert np.isfinite(log_density(starts)).all()
    assert starts.std() > 0.3
    with pytest.raises(ValueError, match="zero probability"):
        climb(log_density, np.array([[-1.0, -1.0]]))
    with pytest.raises(RuntimeError, match="no start"):
        Start(np.array([-1e3, -1e3]), np.eye(2)).draw(5, log_density, np.random.default_rng(2))
