"""Predictions cover what they say, lines break at gaps; residuals show where a model lacks."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from bayesfric.report.figures.prediction import binned_residuals, prediction_figure, predictive
from bayesfric.report.summary.summary import summarise

from .conftest import NOISE, by_gid


def test_band_covers_ninety_per_cent_of_simulated_data(make_fit):
    fit = make_fit(recordings=2, samples=4000)
    covered = total = 0
    for o, (mean, half, _) in zip(fit.observations, predictive(fit), strict=True):
        covered += int(np.sum(np.abs(o.measured - mean) <= half))
        total += o.measured.size
    # white noise of known size, a posterior far narrower: binomial. Four of its sd.
    assert total > 3000
    assert abs(covered - 0.9 * total) < 4 * math.sqrt(0.09 * total)


def test_band_is_that_of_simulated_draws(make_fit):
    # parameters uncertain enough to widen the band
    fit = make_fit(spread=0.03, samples=600)
    ((mean, half, sigma),) = predictive(fit)
    assert half.max() > 1.2 * 1.645 * sigma.max()
    flat = fit.posterior.flat()
    torque = fit.target.likelihood.predict(fit.target.chain_values(flat))[0]
    noise = flat[:, -1:] * np.random.default_rng(0).standard_normal(torque.shape)
    low, high = np.quantile(torque + noise, [0.05, 0.95], axis=0)
    # 200 of the 1920 draws make mean and sd: 1/sqrt(2 * 200) = 5 % of the sd each, and
    # the quantile of 1920 normal draws scatters by 0.05 sd; four together over 400 outputs
    for end, simulated in ((mean - half, low), (mean + half, high)):
        assert np.abs(end - simulated).max() < 4 * 0.11 * half.max() / 1.645


def test_lines_break_where_outputs_are_missing(knee):
    above, below = prediction_figure(knee).axes
    (o,) = knee.observations
    gaps = int(np.sum(np.diff(o.time) > 1.5 * o.period))
    assert gaps > 3
    for ax, gid in ((above, "measured"), (above, "mean"), (below, "residual")):
        t, y = by_gid(ax, gid).get_data()
        assert (np.isnan(y).sum(), np.isfinite(y).sum()) == (gaps, o.measured.size)
        assert np.diff(t)[np.isfinite(y[:-1]) & np.isfinite(y[1:])].max() < 1.5 * o.period
    # the band is a polygon for each run of outputs
    assert len(by_gid(above, "band").get_paths()) == gaps + 1


def disturbed(fit, change):
    """Add to what was measured; ``change`` gets the outputs and gives their additions."""
    likelihood = fit.target.likelihood
    outputs = tuple(
        replace(o, measured=o.measured + change(o, observation))
        for o, observation in zip(likelihood.outputs, fit.observations, strict=True)
    )
    other = object.__new__(type(likelihood))
    other.__dict__ |= likelihood.__dict__ | {"outputs": outputs}
    target = object.__new__(type(fit.target))
    target.__dict__ |= fit.target.__dict__ | {"likelihood": other}
    return replace(fit, target=target)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("speed", lambda _, observation: 0.02 * np.abs(observation.speed)),
        ("position", lambda _, o: 0.03 * np.sin(9 * o.q[o.filter.centres])),
    ],
)
def test_what_the_model_lacks_shows_where_it_acts(knee, name, change):
    """White noise of 90 outputs a bin has means within 4/sqrt(90) sds; what is missing does not."""
    with_it, without = (binned_residuals(fit)[name] for fit in (disturbed(knee, change), knee))
    _, mean, low, high = without
    few = 4.0 * NOISE / np.sqrt(knee.residuals[0].size / mean.size)
    assert (abs(mean) < few).all()
    assert (abs(with_it[1]) > few).any()
    # 90 % of a normal lie within 1.645 sds
    assert (high - low).mean() == pytest.approx(3.29 * NOISE, rel=0.1)


def test_lag_1_is_about_zero_and_of_all_recordings(many):
    """Though residuals have a mean and recordings differ in length and noise."""
    rng = np.random.default_rng(3)

    def change(o, _):
        noise = lfilter([1.0], [1.0, 0.6], rng.standard_normal(o.time.size))
        return o.measured.size * (0.5 + noise)

    lag = summarise(disturbed(many, change)).noise.residual_lag1
    # a mean of 0.5 beside noise of variance 1/(1 - 0.6^2) and lag -0.6; four sds of a white lag
    pairs = sum(int(o.follows.sum()) for o in many.target.likelihood.outputs)
    assert lag == pytest.approx((0.25 - 0.6 / 0.64) / (0.25 + 1 / 0.64), abs=4 / np.sqrt(pairs))
