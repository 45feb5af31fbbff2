"""The log-posterior against its parts, and what is no number."""

import numpy as np
import pytest

from bayesfric.inference.fitting import make_target, read_priors
from bayesfric.mechanism.joint import PRESETS

KNEE = PRESETS["rabbit-knee"]


@pytest.fixture(scope="module")
def knee(make_observation):
    chain = KNEE.chain()
    observations = [
        make_observation(chain, KNEE.values, n=600, factor=5, name="bare"),
        make_observation(
            chain, KNEE.values, n=500, seed=1, added_mass=2.0, radius=0.35, name="loaded"
        ),
    ]
    return chain, observations


def rows(chain, n=8, seed=0):
    rng = np.random.default_rng(seed)
    return chain.vector(KNEE.values) * rng.uniform(0.5, 1.5, (n, len(chain.names)))


@pytest.mark.parametrize("scale", ["shared", "per-recording"])
def test_the_target_is_prior_likelihood_and_jacobian(knee, scale):
    chain, observations = knee
    priors = read_priors(chain, {"load.first_moment": 0.42}, observations)
    target = make_target(chain, observations, priors, scale)
    assert "load.first_moment" not in target.names
    n_sigma = {"shared": 1, "per-recording": 2}[scale]
    assert target.dimension == len(chain.names) - 1 + n_sigma
    kept = [j for j, name in enumerate(chain.names) if name != "load.first_moment"]
    parameters = np.concatenate([rows(chain)[:, kept], np.full((8, n_sigma), 0.02)], axis=1)
    u = target.from_parameters(parameters)
    back, jacobian = target.to_parameters(u)
    np.testing.assert_allclose(back, parameters, rtol=1e-9)
    expected = jacobian + target.log_prior(parameters) + target.log_likelihood(parameters)
    np.testing.assert_allclose(target(u), expected, rtol=1e-12)
    full = target.chain_values(parameters)
    assert (full[:, chain.names.index("load.first_moment")] == 0.42).all()


def test_what_is_no_number_counts_as_impossible_and_is_counted(knee):
    chain, observations = knee
    priors = read_priors(chain, {}, observations)
    target = make_target(chain, observations, priors, "shared")
    u = np.tile(target.from_parameters(np.append(rows(chain, 1), 0.02)[None]), (3, 1))
    u[1, 0] = np.nan
    u[2] = 1e300
    values = target(u)
    assert np.isfinite(values[0])
    assert np.isneginf(values[1:]).all()
    target.likelihood.log_density = lambda values, _: np.full(values.shape[0], np.nan)
    assert np.isneginf(target(u[:1])).all()
    assert target.not_finite == 1


def test_the_edge_of_a_prior_that_is_infinite_there_is_impossible(make_observation):
    """Rounding puts a walker on the edge, where no other place could ever be better."""
    axis = PRESETS["motor-axis"]
    chain = axis.chain()
    observations = [make_observation(chain, axis.values, n=300)]
    pole = {"distribution": "gamma", "a": 0.1, "loc": 0.01, "scale": 0.1}
    priors = read_priors(chain, {"motor.coulomb": pole}, observations)
    target = make_target(chain, observations, priors, "shared")
    j = target.names.index("motor.coulomb")
    u = np.tile(target.from_parameters(np.append(chain.vector(axis.values), 0.02)[None]), (2, 1))
    u[1, j] = -50.0
    assert target.to_parameters(u)[0][1, j] == 0.01
    assert np.isposinf(target.log_prior(target.to_parameters(u)[0])[1])
    values = target(u)
    assert np.isfinite(values[0])
    assert np.isneginf(values[1])
    assert target.not_finite == 0
