"""Prediction: a band that covers what it says, and lines that break at gaps."""

import math

import numpy as np

import bayesfric.report.figures.prediction as module
from bayesfric.recordings.source import Processing
from bayesfric.report.figures.prediction import prediction_figure, predictive
from bayesfric.report.figures.style import save

from .conftest import by_gid


def test_band_covers_ninety_per_cent_of_simulated_data(make_fit):
    fit = make_fit(recordings=2, samples=4000)
    covered = total = 0
    for o, p in zip(fit.observations, predictive(fit), strict=True):
        covered += int(np.sum(np.abs(o.measured - p.mean) <= p.reach))
        total += o.measured.size
    # white noise of known size, a posterior far narrower: binomial. Four of its sd.
    assert total > 3000
    assert abs(covered - 0.9 * total) < 4 * math.sqrt(0.09 * total)


def test_band_is_that_of_simulated_draws(make_fit):
    # parameters uncertain enough to widen the band
    fit = make_fit(spread=0.03, samples=600)
    (p,) = predictive(fit)
    assert p.reach.max() > 1.2 * 1.645 * p.sigma.max()
    flat = fit.posterior.flat()
    torque = fit.target.likelihood.predict(fit.target.chain_values(flat))[0]
    noise = flat[:, -1:] * np.random.default_rng(0).standard_normal(torque.shape)
    low, high = np.quantile(torque + noise, [0.05, 0.95], axis=0)
    # 200 of the 1920 draws make mean and sd: 1/sqrt(2 * 200) = 5 % of the sd each, and
    # the quantile of 1920 normal draws scatters by 0.05 sd; four together over 400 outputs
    for mine, simulated in ((p.mean - p.reach, low), (p.mean + p.reach, high)):
        assert np.abs(mine - simulated).max() < 4 * 0.11 * p.reach.max() / 1.645


def test_mean_is_the_one_of_the_summary(knee, monkeypatch):
    (p,) = predictive(knee)
    np.testing.assert_allclose(
        knee.observations[0].measured - p.mean, knee.residuals[0], atol=1e-12
    )
    # in one piece or draw by draw
    monkeypatch.setattr(module, "_BUDGET", 1)
    (q,) = predictive(knee)
    np.testing.assert_allclose(q.mean, p.mean, atol=1e-13)
    np.testing.assert_allclose(q.reach, p.reach, rtol=1e-9)


def test_lines_break_where_outputs_are_missing(knee):
    figure = prediction_figure(knee)
    (o,) = knee.observations
    gaps = int(np.sum(np.diff(o.time) > 1.5 * o.period))
    assert gaps > 3
    for ax, gid in (
        (figure.axes[0], "measured"),
        (figure.axes[0], "mean"),
        (figure.axes[1], "residual"),
    ):
        t, y = by_gid(ax, gid).get_data()
        assert np.isnan(y).sum() == gaps
        assert np.isfinite(y).sum() == o.measured.size
        joined = np.isfinite(y[:-1]) & np.isfinite(y[1:])
        assert np.diff(t)[joined].max() < 1.5 * o.period
    # the band is a polygon for each run of outputs
    assert len(by_gid(figure.axes[0], "band").get_paths()) == gaps + 1


def test_two_sigma_lines(knee):
    lower = prediction_figure(knee).axes[1]
    levels = [
        np.nanmax(np.abs(line.get_ydata())) for line in lower.lines if line.get_gid() == "sigma"
    ]
    (p,) = predictive(knee)
    assert levels == [2 * p.sigma[0], 2 * p.sigma[0]]


def test_long_recordings_become_pixels(make_fit, tmp_path):
    fit = make_fit(samples=40_000, processing=Processing(lowpass=0, decimate=1, dead_zone=0))
    save(prediction_figure(fit), tmp_path, "long")
    pdf = tmp_path / "long.pdf"
    assert fit.observations[0].measured.size > 30_000
    assert pdf.stat().st_size < 600_000


def test_single_outputs_are_marked(make_fit):
    fit = make_fit(samples=1200, processing=Processing(lowpass=0, decimate=1, dead_zone=0.2))
    line = by_gid(prediction_figure(fit).axes[0], "measured")
    assert line.get_marker() == "."
    y = line.get_ydata()
    alone = [
        i
        for i in np.flatnonzero(np.isfinite(y))
        if (i == 0 or np.isnan(y[i - 1])) and (i == y.size - 1 or np.isnan(y[i + 1]))
    ]
    assert set(alone) <= set(line.get_markevery())
