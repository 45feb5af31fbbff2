"""Autoregressive noise against covariance matrices written out, and exact densities."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg, stats

from bayesfric.estimates.autoregression import (
    autocovariance,
    burg,
    ljung_box,
    predictors,
    simulated,
    variances,
    whitened,
)
from bayesfric.inference.noise import Autoregressive

partials = st.lists(st.floats(-0.95, 0.95), min_size=0, max_size=4).map(np.array)


def covariance(partial, n):
    """Autocovariance by the state-space form: P = A P A' + B B', an equation of its own."""
    p = max(partial.size, 1)
    phi = np.zeros(p)
    phi[: partial.size] = predictors(partial[None])[-1][0]
    a = np.eye(p, k=-1)
    a[0] = phi
    b = np.zeros((p, p))
    b[0, 0] = 1.0
    state = linalg.solve_discrete_lyapunov(a, b)
    gamma = [state[0, 0]]
    for _ in range(n - 1):
        state = a @ state
        gamma.append(state[0, 0])
    return linalg.toeplitz(gamma)


def runs_of(lengths):
    follows = np.ones(sum(lengths) - 1, dtype=bool)
    follows[np.cumsum(lengths)[:-1] - 1] = False
    return follows


@given(partials)
def test_every_partial_autocorrelation_is_a_stationary_series(partial):
    phi = predictors(partial[None])[-1][0]
    roots = np.roots(np.concatenate([[1.0], -phi]))
    assert np.all(np.abs(roots) < 1.0)


@settings(max_examples=60)
@given(partials, st.lists(st.integers(1, 6), min_size=2, max_size=4), st.integers(0, 2**32 - 1))
def test_whitening_leaves_the_identity_and_simulation_inverts_it(partial, lengths, seed):
    n, follows = sum(lengths), runs_of(lengths)
    w = whitened(np.eye(n), partial, follows).T
    cov = linalg.block_diag(*(covariance(partial, k) for k in lengths))
    np.testing.assert_allclose(w @ cov @ w.T, np.eye(n), atol=1e-6)
    series = simulated(partial, follows, 2, np.random.default_rng(seed))
    innovations = np.random.default_rng(seed).standard_normal(series.shape)
    np.testing.assert_allclose(whitened(series, partial, follows), innovations, atol=1e-7)


@given(partials, st.floats(0.1, 3.0))
def test_standard_deviation_of_one_residual(partial, sigma):
    noise = Autoregressive(partial.size)
    expected = sigma * math.sqrt(covariance(partial, 1)[0, 0])
    assert noise.sd(np.concatenate([[sigma], partial])) == pytest.approx(expected, rel=1e-6)
    if partial.size:
        np.testing.assert_allclose(
            autocovariance(partial), covariance(partial, partial.size + 1)[0], rtol=1e-6, atol=1e-9
        )
    left = variances(partial[None])[0]
    assert np.all(np.diff(left) <= 0.0)
    assert left[-1] == 1.0


def test_burg_estimates_the_partial_autocorrelations_of_a_long_series():
    partial = np.array([0.7, -0.4])
    follows = runs_of([9000, 2, 11000])
    series = simulated(partial, follows, 1, np.random.default_rng(3))[0]
    # sd of a partial autocorrelation is about 1/sqrt(n) = 0.007
    np.testing.assert_allclose(burg([series], [follows], 3), [0.7, -0.4, 0.0], atol=0.028)


def test_ljung_box_is_uniform_for_white_noise_and_rejects_an_autoregression():
    rng = np.random.default_rng(8)
    follows = runs_of([300, 5, 200])
    white = [ljung_box([rng.standard_normal(505)], [follows], 10) for _ in range(400)]
    # fixed seed; the threshold is a one-in-a-thousand event
    assert stats.kstest(white, "uniform").pvalue > 1e-3
    series = simulated(np.array([0.5]), follows, 1, rng)
    assert ljung_box(list(series), [follows], 10) < 1e-6
