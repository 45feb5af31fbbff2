"""Residual analysis: white noise passes, and what is missing from a model shows."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from scipy.signal import lfilter

from bayesfric.inference.fitting import read_priors, target_of
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.noise.autoregressive import Autoregressive
from bayesfric.recordings import Processing
from bayesfric.report.figures.residual import residual_analysis, residual_figure
from bayesfric.report.figures.style import PAGE
from bayesfric.report.summary.summary import summarise

from .conftest import SLIDE, draw_fast

# Outputs at 100 Hz.
SLOW = Processing(lowpass=0, decimate=10, dead_zone=0.02)


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


def test_white_residuals_stay_in_the_band(knee):
    found = residual_analysis(knee)
    outside = np.abs(found.correlation) > found.white
    # 40 lags, 5 % each: more than 7 come once in a thousand
    assert outside.sum() <= 7
    n = knee.target.likelihood.outputs[0].measured.size
    assert found.white[0] == pytest.approx(1.96 / np.sqrt(n), rel=0.02)
    for b in found.against:
        assert (np.abs(b.mean) > 4.0 * b.error).sum() == 0, b.name


def test_the_autocorrelation_is_that_of_the_noise(knee):
    """A first-order autoregression of 0.8 has 0.8, 0.64, ... at lags 1, 2, ..."""
    found = residual_analysis(disturbed(knee, memory(0.8)))
    # Bartlett: sd of the lag-1 estimate is sqrt((1 - 0.8^2)/1400) = 0.016; gaps cost a little
    assert found.correlation[0] == pytest.approx(0.8, abs=0.06)
    assert found.correlation[1] == pytest.approx(0.64, abs=0.09)
    outside = int((np.abs(found.correlation) > found.white).sum())
    assert outside > 5


def test_correlation_counts_no_pairs_across_gaps(knee):
    """The recording has a second of nothing in its middle."""
    found = residual_analysis(knee)
    (o,) = knee.target.likelihood.outputs
    place = np.rint((o.time - o.time[0]) / o.period).astype(int)
    pairs = int((np.diff(place) == 1).sum())
    assert 0 < pairs < o.time.size - 1
    assert found.white[0] == pytest.approx(1.959964 / np.sqrt(pairs), rel=1e-6)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("joint speed", lambda _, seen: 0.02 * np.abs(seen.speed)),
        ("joint angle", lambda _, seen: 0.03 * np.sin(9 * seen.q[seen.filter.centres])),
    ],
)
def test_what_the_model_lacks_shows_where_it_acts(knee, name, change):
    fit = disturbed(knee, change)
    (binned,) = [b for b in residual_analysis(fit).against if b.what.startswith(name)]
    assert (np.abs(binned.mean) > 4.0 * binned.error).any()
    (without,) = [b for b in residual_analysis(knee).against if b.what.startswith(name)]
    assert binned.explained > 5.0 * without.explained


def test_a_mean_of_outputs_that_repeat_each_other_is_less_known(make_fit):
    """By sqrt(1.9/0.1) = 4.4 of a first-order memory of 0.9, less for lags that are left out."""
    fit = make_fit(SLIDE, samples=20000, processing=SLOW)
    (speed, *_) = residual_analysis(disturbed(fit, memory(0.9))).against
    (white, *_) = residual_analysis(disturbed(fit, memory(0.0))).against
    # of so much larger a sd, too
    assert np.mean(speed.error / white.error) * np.sqrt(1 - 0.9**2) == pytest.approx(
        np.sqrt(1.9 / 0.1), rel=0.25
    )


def test_binned_means_are_the_bins(knee):
    (left,) = knee.residuals
    (o,) = knee.observations
    (binned,) = [b for b in residual_analysis(knee).against if b.what.startswith("joint speed")]
    order = np.argsort(o.speed, kind="stable")
    parts = np.array_split(order, binned.centre.size)
    np.testing.assert_allclose(binned.mean, [left[p].mean() for p in parts], rtol=1e-12)
    between = sum(p.size * (left[p].mean() - left.mean()) ** 2 for p in parts)
    assert binned.explained == pytest.approx(between / ((left - left.mean()) ** 2).sum())


def remembering(fit, partial):
    """Give the fit's noise a memory of one, known well."""
    likelihood = TorqueLikelihood(fit.chain, fit.observations, Autoregressive(1))
    priors = read_priors(fit.chain, {}, fit.observations, likelihood.noise.quantities)
    target = target_of(likelihood, priors, "shared")
    draws = fit.posterior.draws
    draws = np.concatenate([draws, np.full((*draws.shape[:3], 1), partial)], axis=-1)
    posterior = replace(fit.posterior, names=target.names, priors=target.priors, draws=draws)
    return replace(fit, target=target, posterior=posterior)


def test_innovations_are_what_a_memory_leaves(knee):
    fit = disturbed(remembering(knee, 0.8), memory(0.8))
    found = residual_analysis(fit)
    assert (np.abs(found.correlation) > found.white).sum() > 5
    # gaps of the dead zone hide some of the past: a few more than chance are let pass
    assert np.abs(found.innovations[0]) < 0.1
    assert (np.abs(found.innovations) > found.white).sum() <= 7
    figure = residual_figure(fit)
    draw_fast(figure)
    assert any(line.get_gid() == "innovations" for line in figure.axes[0].lines)
    assert residual_analysis(knee).innovations is None


@pytest.mark.parametrize("which", ["knee", "slide", "many"])
def test_the_figure_is_a_page_wide(which, request):
    figure = residual_figure(request.getfixturevalue(which))
    assert figure.get_figwidth() == PAGE
    draw_fast(figure)


def test_no_words_stand_on_bars(knee):
    """Residuals that remember for long, of noise that has a memory, too: every bar is long."""

    def slow(o, _):
        return 2.0 * np.sin(np.linspace(0.0, 6.0, o.measured.size))

    figure = residual_figure(disturbed(remembering(knee, 0.9), slow))
    figure.draw_without_rendering()
    words = 0
    for ax in figure.axes:
        legend = ax.get_legend()
        boxes = [text.get_window_extent() for text in ax.texts]
        boxes += [legend.get_window_extent()] if legend else []
        words += len(boxes)
        for lines in ax.collections:
            if not isinstance(lines, LineCollection):
                continue
            for path in lines.get_paths():
                ends = lines.get_transform().transform(path.vertices)
                for box in boxes:
                    beside = (ends[:, 0] < box.x0) | (ends[:, 0] > box.x1)
                    assert (beside | (ends[:, 1].max() < box.y0)).all()
    assert words >= 4


def test_lag_1_is_one_number_in_caption_and_summary(many):
    """About zero, though residuals have a mean and recordings differ in length and noise."""
    noise = memory(-0.6)
    fit = disturbed(many, lambda o, _: o.measured.size * (0.5 + noise(o, _)))
    told = summarise(fit).noise.residual_lag1
    assert residual_analysis(fit).correlation[0] == pytest.approx(told, rel=1e-12)
    # a mean of 0.5 beside noise of variance 1/(1 - 0.6^2) and lag -0.6; four sds of a white lag
    pairs = sum(int(o.follows.sum()) for o in fit.target.likelihood.outputs)
    assert told == pytest.approx((0.25 - 0.6 / 0.64) / (0.25 + 1 / 0.64), abs=4 / np.sqrt(pairs))
