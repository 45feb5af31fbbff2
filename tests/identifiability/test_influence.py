"""Power scaling, where the scaled posterior is known in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayesfric.identifiability.influence import (
    Influence,
    influence,
    sensitivity,
)
from bayesfric.inference.fitting import fit, make_target, read_priors
from bayesfric.inference.sampling.sampling import Sampling
from bayesfric.mechanism.presets import PRESETS

AXIS = PRESETS["motor-axis"]
# A normal prior and one normal datum.
PRIOR, DATUM, NOISE = (0.0, 1.0), 2.5, 0.6


def posterior(of_prior=1.0, of_likelihood=1.0):
    """Give the posterior when prior and likelihood are raised to powers: normal again."""
    precision = of_prior / PRIOR[1] ** 2 + of_likelihood / NOISE**2
    mean = of_prior * PRIOR[0] / PRIOR[1] ** 2 + of_likelihood * DATUM / NOISE**2
    return stats.norm(mean / precision, precision**-0.5)


def components(x):
    return stats.norm.logpdf(x, *PRIOR), stats.norm.logpdf(DATUM, x, NOISE)


def exact_distance(first, second, low, high):
    """Cumulative Jensen-Shannon distance by quadrature, the larger one of x and -x."""
    t = np.linspace(low, high, 100_001)
    found = []
    for p, q in ((first.cdf(t), second.cdf(t)), (first.sf(t), second.sf(t))):
        # both directions of the paper's definition, their linear terms as printed
        middle = (p + q) / 2
        forth = np.trapezoid(p * np.log2(p / middle), t) + np.trapezoid(q - p, t) / np.log(4)
        back = np.trapezoid(q * np.log2(q / middle), t) + np.trapezoid(p - q, t) / np.log(4)
        found.append(np.sqrt((forth + back) / np.trapezoid(p + q, t)))
    return max(found)


@pytest.fixture(scope="module")
def even():
    """Draws without any chance in them: 20 000 quantiles of the posterior."""
    n = 20_000
    return posterior().ppf((np.arange(n) + 0.5) / n)


def test_sensitivity_is_the_slope_by_the_binary_logarithm(even):
    low, high = even[0], even[-1]
    for k, log_component in enumerate(components(even)):
        (found,) = sensitivity(even[:, None], log_component)
        for h in (1e-2, 1e-3):
            powers = [1.0, 1.0]
            powers[k] = 2.0**h
            expected = exact_distance(posterior(), posterior(*powers), low, high) / h
            # forward differences: wrong by a share of about h
            assert found == pytest.approx(expected, rel=3e-3 + h), (k, h)


def test_random_draws_agree_within_their_chance(even):
    exact = [sensitivity(even[:, None], c)[0] for c in components(even)]
    found = []
    for seed in range(40):
        x = posterior().rvs(2000, random_state=seed)
        found.append([sensitivity(x[:, None], c)[0] for c in components(x)])
    error = np.mean(found, axis=0) - exact
    # ranges of draws vary, and squares of noise add a little: far below the 0.05 asked for
    assert np.abs(error).max() < 0.02
    assert np.std(found, axis=0).max() < 0.02


def test_a_parameter_apart_from_the_component_is_not_moved_and_columns_do_not_mix(even):
    rng = np.random.default_rng(3)
    other = rng.permutation(even)
    log_prior, _ = components(even)
    both = sensitivity(np.stack([even, other], axis=1), log_prior)
    assert both[0] == pytest.approx(sensitivity(even[:, None], log_prior)[0], rel=1e-9)
    assert both[0] > 0.1
    assert both[1] < 0.01


def test_no_scale_no_origin_no_sign_matters(even):
    log_prior, _ = components(even)
    moved = np.stack([even, 3e-4 * even, -7.0 * even, even + 1e3], axis=1)
    found = sensitivity(moved, log_prior)
    np.testing.assert_allclose(found, found[0], rtol=1e-6)


def test_a_constant_component_moves_nothing_and_constant_draws_have_no_number(even):
    assert sensitivity(even[:, None], np.full(even.size, -3.0)) == pytest.approx(0.0, abs=1e-6)
    draws = np.stack([np.full(even.size, 0.3), even], axis=1)
    found = sensitivity(draws, components(even)[0])
    assert np.isnan(found[0])
    assert np.isfinite(found[1])


def test_agrees_with_arviz():
    """ArviZ before 1.0 has the same measure; its weights are Pareto smoothed, which is little."""
    az = pytest.importorskip("arviz")
    if not hasattr(az, "psens"):
        pytest.skip("this ArviZ has another function for it")
    x = posterior().rvs(2000, random_state=1)
    log_prior, log_likelihood = components(x)
    data = az.from_dict(posterior={"x": x[None]}, log_likelihood={"y": log_likelihood[None]})
    data.add_groups({"log_prior": {"x": log_prior[None]}})
    for component, log_component in (("prior", log_prior), ("likelihood", log_likelihood)):
        expected = float(az.psens(data, component=component)["x"])
        assert sensitivity(x[:, None], log_component)[0] == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(
    ("prior", "likelihood", "words"),
    [
        (0.2, 0.2, "prior-data conflict"),
        (0.05, 0.05, "prior-data conflict"),
        (0.2, 0.01, "strong prior"),
        (0.01, 0.01, "weak likelihood"),
        (0.01, 0.2, "-"),
        (np.nan, 0.2, None),
    ],
)
def test_diagnosis(prior, likelihood, words):
    assert Influence(prior, likelihood).diagnosis == words


def axis_fit(make_observation, texts):
    chain = AXIS.chain()
    observation = make_observation(chain, AXIS.values, sigma=0.02, n=400)
    priors = read_priors(chain, texts, [observation])
    target = make_target(chain, [observation], priors, "shared")
    return fit(target, Sampling(seed=2, ensembles=2, min_ess=500))


@pytest.fixture(scope="module")
def wide_fit(make_observation):
    return axis_fit(make_observation, {})


def test_a_prior_far_off_is_a_conflict_and_wide_ones_are_not(wide_fit, make_observation):
    """A prior as wide as the data alone leave the parameter, eight sds off."""
    wide = influence(wide_fit)
    assert list(wide) == [*AXIS.chain().names, "noise.sigma"]
    assert {one.diagnosis for one in wide.values()} == {"-"}
    draws = wide_fit.posterior["motor.coulomb"]
    off = {"distribution": "norm", "loc": draws.mean() + 8 * draws.std(), "scale": draws.std()}
    found = influence(axis_fit(make_observation, {"motor.coulomb": off}))["motor.coulomb"]
    assert found.diagnosis == "prior-data conflict"
    # prior and data pull a normal to its middle, from as far and as hard
    assert found.prior == pytest.approx(found.likelihood, rel=0.5)


def test_a_fit_in_which_nothing_moves_has_no_numbers(wide_fit):
    posterior = wide_fit.posterior
    still = np.tile(np.median(posterior.flat(), axis=0), (*posterior.draws.shape[:3], 1))
    found = influence(replace(wide_fit, posterior=replace(posterior, draws=still)))
    assert all(np.isnan(one.prior) and one.diagnosis is None for one in found.values())
