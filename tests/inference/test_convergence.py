"""Diagnostics against series whose answer is known."""

import numpy as np
import pytest
from scipy.signal import lfilter

from bayesfric.inference.posterior import (
    autocorrelation_time,
    effective_sample_size,
    nested_rhat,
)


def ar1(rho, shape, seed=0):
    """Stationary unit-variance AR(1) along the last axis."""
    noise = np.random.default_rng(seed).standard_normal((*shape[:-1], shape[-1] + 500))
    return lfilter([np.sqrt(1 - rho**2)], [1.0, -rho], noise, axis=-1)[..., 500:]


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_tau_of_an_autoregression(rho):
    """Integrated autocorrelation time of AR(1) is (1 + rho)/(1 - rho)."""
    exact = (1 + rho) / (1 - rho)
    draws = ar1(rho, (1, 40, 20000))[..., None]
    # the larger of two estimates lies above; one series of means is worth 20000/tau draws
    tau = autocorrelation_time(draws)[0]
    assert 0.95 * exact < tau < 1.35 * exact


def test_walkers_that_move_together_count_once():
    """Forty copies of one series: the walkers' own autocorrelation would hide it."""
    series = ar1(0.5, (1, 1, 20000))
    draws = np.repeat(series, 40, axis=1)[..., None]
    assert autocorrelation_time(draws)[0] == pytest.approx(40 * 3.0, rel=0.2)


def test_a_stuck_parameter_has_no_finite_tau():
    draws = np.random.default_rng(0).normal(size=(2, 10, 200, 2))
    draws[1, :, :, 1] = 3.0
    tau = autocorrelation_time(draws)
    assert np.isfinite(tau[0])
    assert np.isinf(tau[1])
    assert effective_sample_size(draws, tau)[1] == 0.0


def test_nested_rhat_sees_an_ensemble_apart():
    draws = np.random.default_rng(2).normal(size=(4, 30, 500, 1))
    draws[0] += 1.0
    # means 1, 0, 0, 0: variance 1/4 over a variance of 1
    assert nested_rhat(draws)[0] == pytest.approx(np.sqrt(1.25), abs=0.01)


def test_nested_rhat_of_constants():
    draws = np.zeros((3, 4, 5, 2))
    draws[0, ..., 1] = 1.0
    rhat = nested_rhat(draws)
    assert rhat[0] == 1.0
    assert np.isinf(rhat[1])


def test_walkers_stuck_in_different_modes_are_worth_few_draws():
    """Each walker alone looks independent; around the common mean none of them ever turns."""
    rng = np.random.default_rng(3)
    modes = rng.choice([-6.0, 6.0], size=(4, 36, 1))
    draws = (modes + rng.normal(size=(4, 36, 800)))[..., None]
    tau = autocorrelation_time(draws)
    assert tau[0] > 800 / 4
    assert effective_sample_size(draws, tau)[0] < 4 * 36 * 4
