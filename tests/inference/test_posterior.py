"""Diagnostics of series whose answer is known, and predictions against closed forms."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

from bayesfric.inference.posterior import (
    Prediction,
    autocorrelation_time,
    effective_sample_size,
    nested_rhat,
    predict_held_out,
)
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.recordings.held_out import HeldOut
from tests.report.conftest import NOISE, build


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


def test_nested_rhat_of_an_ensemble_apart_and_of_constants():
    draws = np.random.default_rng(2).normal(size=(4, 30, 500, 3))
    draws[0, ..., 0] += 1.0
    draws[..., 1:] = 0.0
    draws[0, ..., 2] = 1.0
    # means 1, 0, 0, 0: variance 1/4 over a variance of 1
    assert nested_rhat(draws) == pytest.approx([np.sqrt(1.25), 1.0, np.inf], abs=0.01)


def test_walkers_stuck_in_different_modes_are_worth_few_draws():
    """Each walker alone looks independent; around the common mean none of them ever turns."""
    rng = np.random.default_rng(3)
    modes = rng.choice([-6.0, 6.0], size=(4, 36, 1))
    draws = (modes + rng.normal(size=(4, 36, 800)))[..., None]
    tau = autocorrelation_time(draws)
    assert tau[0] > 800 / 4
    assert effective_sample_size(draws, tau)[0] < 4 * 36 * 4


# --- predictions


def held(o, part="last 20 %"):
    return HeldOut(SimpleNamespace(name=o.name), o, part)


def test_a_prediction_is_a_mixture_of_normals():
    """Its variance is the mean variance and the variance of the means."""
    rng = np.random.default_rng(1)
    torque, sds = rng.normal(0.0, 0.5, (7, 30)), rng.uniform(0.1, 2.0, (7, 1))
    measured = rng.normal(0.0, 1.0, 30)
    part = SimpleNamespace(observation=SimpleNamespace(measured=measured))
    mixture = Prediction(part, torque, stats.norm(scale=sds), ())
    pit = stats.norm.cdf((measured - torque) / sds).mean(axis=0)
    np.testing.assert_allclose(mixture.pit, pit, rtol=1e-12)
    np.testing.assert_allclose(mixture.mean, torque.mean(axis=0), rtol=1e-12)
    second = (torque**2 + sds**2).mean(axis=0)
    np.testing.assert_allclose(mixture.variance, second - torque.mean(axis=0) ** 2, rtol=1e-12)


@pytest.fixture(scope="module")
def three_noises():
    """Three recordings whose noise scales are 1, 2 and 4 times one."""
    fit = build(recordings=3, samples=600, noise_scale="per-recording")
    for r, factor in enumerate((1.0, 2.0, 4.0)):
        fit.posterior.draws[..., fit.target.names.index(f"noise.sigma.run {r}")] *= factor
    return fit


def test_an_end_has_its_own_noise(three_noises):
    predictions = predict_held_out(
        three_noises.target, three_noises.posterior, [held(o) for o in three_noises.observations]
    )
    for p, factor in zip(predictions, (1.0, 2.0, 4.0), strict=True):
        assert p.borrowed == ()
        assert p.noise.std().mean() == pytest.approx(factor * NOISE, rel=1e-3)


def test_a_whole_recording_gets_that_of_any(three_noises):
    new = replace(three_noises.observations[0], name="new")
    (p,) = predict_held_out(
        three_noises.target, three_noises.posterior, [held(new, "whole recording")]
    )
    assert p.borrowed == ("noise scale",)
    counts = [
        np.count_nonzero(np.abs(p.noise.std() / (factor * NOISE) - 1.0) < 0.02)
        for factor in (1.0, 2.0, 4.0)
    ]
    n = p.torque.shape[0]
    assert sum(counts) == n
    # a third each: binomial, four of its sds
    assert all(abs(c - n / 3) < 4 * np.sqrt(n * 2 / 9) for c in counts)
    (again,) = predict_held_out(
        three_noises.target, three_noises.posterior, [held(new, "whole recording")]
    )
    np.testing.assert_array_equal(p.noise.std(), again.noise.std())


def test_own_offsets_are_that_of_the_recording_or_of_any():
    chain = replace(build().chain, offset=True, own_offsets=("run 0", "run 1"))
    fit = build(chain, recordings=2, samples=600, spread=1e-9)
    for r, value in enumerate((0.5, -0.25)):
        fit.posterior.draws[..., fit.target.names.index(f"offset.run {r}")] = value
    first = fit.observations[0]
    new = replace(first, name="new")
    end, any_ = predict_held_out(fit.target, fit.posterior, [held(first), held(new, "whole")])
    values = fit.chain_draws(1)
    without = replace(chain, own_offsets=(), offset=False)
    keep = [i for i, name in enumerate(chain.names) if not name.startswith("offset.")]
    bare = inverse_torque(without, values[:, keep], first.q, first.qd, first.qdd)
    bare = first.filter.apply(bare)
    np.testing.assert_allclose(end.torque, np.tile(bare + 0.5, (len(end.torque), 1)), atol=1e-6)
    shift = (any_.torque - bare)[:, 0]
    assert set(np.round(shift, 5)) == {0.5, -0.25}
    assert end.borrowed == ()
    assert any_.borrowed == ("offset",)
