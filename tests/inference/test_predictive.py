"""Predictions of what was not fitted, against closed forms and against plain simulation."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from bayesfric.inference.posterior import Prediction, predict_held_out
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.recordings.held_out import HeldOut
from tests.report.conftest import NOISE, build


def held(o, part="last 20 %"):
    return HeldOut(SimpleNamespace(name=o.name), o, part)


def prediction(torque, noise, measured):
    part = SimpleNamespace(observation=SimpleNamespace(measured=measured))
    return Prediction(part, torque, noise, ())


@pytest.fixture
def mixture():
    rng = np.random.default_rng(1)
    torque = rng.normal(0.0, 0.5, (7, 30))
    noise = stats.norm(scale=rng.uniform(0.1, 2.0, (7, 1)))
    return prediction(torque, noise, rng.normal(0.0, 1.0, 30))


def test_the_probability_is_that_of_the_mixture(mixture):
    for m in range(30):
        each = [
            (mixture.measured[m] - mixture.torque[i, m], mixture.noise.kwds["scale"][i, 0])
            for i in range(7)
        ]
        pit = np.mean([stats.norm.cdf(r / s) for r, s in each])
        assert mixture.pit[m] == pytest.approx(pit, rel=1e-12)


def test_mean_and_variance_are_those_of_draws(mixture):
    rng = np.random.default_rng(2)
    n = 200_000
    pick = rng.integers(7, size=n)
    y = mixture.torque[pick, 3] + mixture.noise.kwds["scale"][pick, 0] * rng.standard_normal(n)
    assert mixture.mean[3] == pytest.approx(y.mean(), abs=4 * y.std() / np.sqrt(n))
    error = y.var() * np.sqrt((stats.kurtosis(y) + 2.0) / n)
    assert mixture.variance[3] == pytest.approx(y.var(), abs=4 * error)


@pytest.fixture(scope="module")
def three():
    """Three recordings whose noise scales are 1, 2 and 4 times one."""
    fit = build(recordings=3, samples=600, noise_scale="per-recording")
    for r, factor in enumerate((1.0, 2.0, 4.0)):
        fit.posterior.draws[..., fit.target.names.index(f"noise.sigma.run {r}")] *= factor
    return fit


def test_an_end_has_its_own_noise(three):
    found = predict_held_out(three.target, three.posterior, [held(o) for o in three.observations])
    for p, factor in zip(found, (1.0, 2.0, 4.0), strict=True):
        assert p.borrowed == ()
        assert p.noise.std().mean() == pytest.approx(factor * NOISE, rel=1e-3)


def test_a_whole_recording_gets_that_of_any(three):
    new = replace(three.observations[0], name="new")
    (p,) = predict_held_out(three.target, three.posterior, [held(new, "whole recording")])
    assert p.borrowed == ("noise scale",)
    counts = [
        np.count_nonzero(np.abs(p.noise.std() / (factor * NOISE) - 1.0) < 0.02)
        for factor in (1.0, 2.0, 4.0)
    ]
    n = p.torque.shape[0]
    assert sum(counts) == n
    # a third each: binomial, four of its sds
    assert all(abs(c - n / 3) < 4 * np.sqrt(n * 2 / 9) for c in counts)
    (again,) = predict_held_out(three.target, three.posterior, [held(new, "whole recording")])
    np.testing.assert_array_equal(p.noise.std(), again.noise.std())


def test_own_offsets_are_that_of_the_recording_or_of_any():
    chain = replace(build().chain, offset=True, own_offsets=("run 0", "run 1"))
    fit = build(chain, recordings=2, samples=600, spread=1e-9)
    for r, value in enumerate((0.5, -0.25)):
        fit.posterior.draws[..., fit.target.names.index(f"offset.run {r}")] = value
    first = fit.observations[0]
    new = replace(first, name="new")
    own, any_ = predict_held_out(fit.target, fit.posterior, [held(first), held(new, "whole")])
    values = fit.chain_draws(1)
    without = replace(chain, own_offsets=(), offset=False)
    keep = [i for i, name in enumerate(chain.names) if not name.startswith("offset.")]
    bare = inverse_torque(without, values[:, keep], first.q, first.qd, first.qdd)
    bare = first.filter.apply(bare)
    np.testing.assert_allclose(own.torque, np.tile(bare + 0.5, (len(own.torque), 1)), atol=1e-6)
    shift = (any_.torque - bare)[:, 0]
    assert set(np.round(shift, 5)) == {0.5, -0.25}
    assert own.borrowed == ()
    assert any_.borrowed == ("offset",)
