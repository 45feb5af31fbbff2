"""Residuals: what is missing from a model shows where it acts."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from bayesfric.report.figures.prediction import binned, residuals
from bayesfric.report.summary.summary import summarise

from .conftest import NOISE


def disturbed(fit, change):
    """Add to what was measured; ``change`` gets the outputs and gives their additions."""
    likelihood = fit.target.likelihood
    outputs = tuple(
        replace(o, measured=o.measured + change(o, seen))
        for o, seen in zip(likelihood.outputs, fit.observations, strict=True)
    )
    other = object.__new__(type(likelihood))
    other.__dict__ |= likelihood.__dict__ | {"outputs": outputs}
    target = object.__new__(type(fit.target))
    target.__dict__ |= fit.target.__dict__ | {"likelihood": other}
    return replace(fit, target=target)


def memory(partial):
    """Add a first-order autoregression, to every recording another."""
    rng = np.random.default_rng(3)
    return lambda o, _: lfilter([1.0], [1.0, -partial], rng.standard_normal(o.time.size))


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("speed", lambda _, seen: 0.02 * np.abs(seen.speed)),
        ("position", lambda _, seen: 0.03 * np.sin(9 * seen.q[seen.filter.centres])),
    ],
)
def test_what_the_model_lacks_shows_where_it_acts(knee, name, change):
    """White noise of 90 outputs a bin has means within 4/sqrt(90) sds; what is missing does not."""
    with_it, without = (binned(residuals(fit), name) for fit in (disturbed(knee, change), knee))
    few = 4.0 * NOISE / np.sqrt(knee.residuals[0].size / len(without))
    assert (without["mean"].abs() < few).all()
    assert (with_it["mean"].abs() > few).any()
    # 90 % of a normal lie within 1.645 sds
    assert (without["high"] - without["low"]).mean() == pytest.approx(3.29 * NOISE, rel=0.1)


def test_binned_means_are_the_bins(knee):
    (left,) = knee.residuals
    (o,) = knee.observations
    table = binned(residuals(knee), "speed")
    of_bin = np.arange(left.size) * len(table) // left.size
    parts = [np.argsort(o.speed, kind="stable")[of_bin == k] for k in range(len(table))]
    np.testing.assert_allclose(table["speed"], [o.speed[p].mean() for p in parts], rtol=1e-9)
    np.testing.assert_allclose(table["mean"], [left[p].mean() for p in parts], rtol=1e-9)
    highs = [np.quantile(left[p], 0.95) for p in parts]
    np.testing.assert_allclose(table["high"], highs, rtol=1e-9)


def test_lag_1_is_about_zero_and_of_all_recordings(many):
    """Though residuals have a mean and recordings differ in length and noise."""
    noise = memory(-0.6)
    fit = disturbed(many, lambda o, _: o.measured.size * (0.5 + noise(o, _)))
    told = summarise(fit).noise.residual_lag1
    # a mean of 0.5 beside noise of variance 1/(1 - 0.6^2) and lag -0.6; four sds of a white lag
    pairs = sum(int(o.follows.sum()) for o in fit.target.likelihood.outputs)
    assert told == pytest.approx((0.25 - 0.6 / 0.64) / (0.25 + 1 / 0.64), abs=4 / np.sqrt(pairs))
