"""Residual analysis: white noise passes, and what is missing from a model shows."""

import io
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import LineCollection
from scipy.signal import lfilter
from scipy.stats import binom

from bayesfric.inference.fitting import read_priors, target_of
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.noise.autoregressive import Autoregressive
from bayesfric.recordings import Processing
from bayesfric.report.figures.residual import residual_figure
from bayesfric.report.figures.style import PAGE
from bayesfric.report.page.run_page import run_page
from bayesfric.report.paper.methods_text import methods_text
from bayesfric.report.paper.tables import parameter_table, parameters_csv
from bayesfric.report.summary.residual_analysis import (
    _outside,
    residual_analysis,
    residual_words,
)
from bayesfric.report.summary.summary import summarise
from bayesfric.report.text_templates import filled

from .conftest import SLIDE, draw_fast
from .page_reader import read_page

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


def test_white_residuals_stay_in_the_band(knee):
    found = residual_analysis(knee)
    outside = np.abs(found.correlation) > found.white
    # 40 lags, 5 % each: more than 7 come once in a thousand
    assert outside.sum() <= 7
    n = knee.target.likelihood.outputs[0].measured.size
    assert found.white[0] == pytest.approx(1.96 / np.sqrt(n), rel=0.02)
    assert all(b.p_value > 1e-3 for b in found.against)
    assert abs(found.kurtosis) < 0.5
    said = " ".join(residual_words(knee))
    assert "none of joint speed, load, joint angle" in said
    assert "close to normal" in said


def test_the_autocorrelation_is_that_of_the_noise(knee):
    """A first-order autoregression of 0.8 has 0.8, 0.64, ... at lags 1, 2, ..."""

    def memory(o, _):
        rng = np.random.default_rng(3)
        return 1.0 * lfilter([1.0], [1.0, -0.8], rng.standard_normal(o.measured.size))

    found = residual_analysis(disturbed(knee, memory))
    # Bartlett: sd of the lag-1 estimate is sqrt((1 - 0.8^2)/1400) = 0.016; gaps cost a little
    assert found.correlation[0] == pytest.approx(0.8, abs=0.06)
    assert found.correlation[1] == pytest.approx(0.64, abs=0.09)
    outside = int((np.abs(found.correlation) > found.white).sum())
    words = residual_words(disturbed(knee, memory))
    assert outside > 5
    assert "as many as chance allows" not in words[0]


@pytest.mark.parametrize(("outside", "words"), [(4, "as many as chance allows"), (6, "p = 0.014")])
def test_lags_outside_the_band_are_judged_by_the_binomial(outside, words):
    """Two of 40 are expected; four or more come by chance in 14 %, six or more in 1.4 %."""
    correlation = np.full(40, 0.1)
    correlation[:outside] = 0.25
    found = _outside(correlation, np.full(40, 0.2))
    assert found["by_chance"] == pytest.approx(binom.sf(outside - 1, 40, 0.05))
    macro = filled(
        "residual.txt.j2", found=SimpleNamespace(kurtosis=0.0, against=[]), residuals=found,
        innovations=None, drifts=False, tails=1.0,
    )  # fmt: skip
    assert words in macro
    assert ("more than chance has (2 are expected" in macro) == (outside == 6)


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
    assert binned.p_value < 1e-6
    assert any(f"depends on {name}" in words for words in residual_words(fit))
    assert binned.outcome == "depends"
    (without,) = [b for b in residual_analysis(knee).against if b.what.startswith(name)]
    assert without.outcome == "none"


def s_curve(share, seed=3):
    """Give what a quadratic loss leaves, in noise that remembers 0.97 of each output before."""

    def change(_, seen):
        v, rng = seen.speed, np.random.default_rng(seed)
        a = seen.qdd[seen.filter.centres]
        base = np.linalg.qr(np.stack([v, np.sign(v), a], axis=1))[0]
        lack = v * np.abs(v)
        lack -= base @ (base.T @ lack)
        noise = lfilter([1.0], [1.0, -0.97], rng.standard_normal(v.size))
        return np.sqrt(share) * lack / lack.std() + np.sqrt(1.0 - share) * noise / noise.std()

    return change


def speed_of(fit):
    (found,) = [b for b in residual_analysis(fit).against if b.name == "joint speed"]
    return found


def test_a_smooth_dependence_does_not_hide_behind_a_memory(make_fit):
    """The S of a UR10e elbow held 41 % of the variance and passed for memory."""
    long = make_fit(SLIDE, samples=20000, processing=SLOW)
    fit = disturbed(long, s_curve(0.4))
    found = speed_of(fit)
    assert found.explained == pytest.approx(0.4, abs=0.1)
    assert found.outcome == "depends"
    assert speed_of(disturbed(long, s_curve(0.0))).outcome == "none"


def test_no_all_clear_beside_a_large_share(make_fit):
    """Two swings in noise of long memory: nobody can tell, and that is what is said."""
    fit = disturbed(make_fit(SLIDE, samples=2000, processing=SLOW), s_curve(0.5))
    found = speed_of(fit)
    assert found.p_value > 1e-3
    assert found.explained > found.chance + 0.05
    words = " ".join(residual_words(fit))
    assert "depends on none" not in words
    share = f"{100 * found.explained:.2g} %"
    assert f"depends on joint speed cannot be told: it holds {share}" in words
    assert found.outcome not in ("depends", "none")


def test_the_share_expected_of_chance_is_that_of_chance(make_fit):
    """Means of noise alone, over recordings that differ in it alone."""
    fit = make_fit(SLIDE, samples=20000, processing=SLOW)
    found = [speed_of(disturbed(fit, s_curve(0.0, seed))) for seed in range(40)]
    explained = np.array([one.explained for one in found])
    expected = np.mean([one.chance for one in found])
    # the memory after the first lag that chance explains is left out: a little too few
    spread = explained.std() / np.sqrt(explained.size)
    assert expected == pytest.approx(explained.mean(), abs=4 * spread + 0.2 * explained.mean())
    assert sum(one.outcome != "none" for one in found) <= 1


def test_binned_means_are_the_bins(knee):
    (left,) = knee.residuals
    (o,) = knee.observations
    (binned,) = [b for b in residual_analysis(knee).against if b.what.startswith("joint speed")]
    order = np.argsort(o.speed, kind="stable")
    parts = np.array_split(order, binned.centre.size)
    np.testing.assert_allclose(binned.mean, [left[p].mean() for p in parts], rtol=1e-12)
    np.testing.assert_allclose(binned.sd, [left[p].std() for p in parts], rtol=1e-12)
    between = sum(p.size * (left[p].mean() - left.mean()) ** 2 for p in parts)
    assert binned.explained == pytest.approx(between / ((left - left.mean()) ** 2).sum())


def test_heavy_tails_are_told(knee):
    rng = np.random.default_rng(7)

    def heavy(o, _):
        return 0.05 * rng.standard_t(3, o.measured.size)

    fit = disturbed(knee, heavy)
    assert any("heavier tails" in words for words in residual_words(fit))


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
    def memory(o, _):
        return lfilter([1.0], [1.0, -0.8], np.random.default_rng(3).standard_normal(o.time.size))

    fit = disturbed(remembering(knee, 0.8), memory)
    found = residual_analysis(fit)
    assert (np.abs(found.correlation) > found.white).sum() > 5
    # gaps of the dead zone hide some of the past: a few more than chance are let pass
    assert np.abs(found.innovations[0]) < 0.1
    assert (np.abs(found.innovations) > found.white).sum() <= 7
    words = " ".join(residual_words(fit))
    assert "autocorrelation of the innovations" in words
    assert "Innovations are close to normal" in words
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


def test_what_was_measured_as_a_current_is_told_in_amperes_too(knee):
    assert summarise(knee).fit.current_rms is None
    assert not any(child.get_gid() == "amperes" for child in children(residual_figure(knee)))
    (o,) = knee.observations
    o.settings["torque_constant"] = 0.32
    try:
        summary, figure = summarise(knee), residual_figure(knee)
        methods = methods_text(knee, summary).plain
    finally:
        del o.settings["torque_constant"]
    current = summary.fit.residual_rms / 0.32
    assert summary.fit.current_rms == pytest.approx(current)
    assert f"{current:.3g} A of the motor's current" in methods
    draw_fast(figure)
    (right,) = [child for child in children(figure) if child.get_gid() == "amperes"]
    left = figure.axes[2]
    scales = [
        float(found[1]) if (found := re.search(r"10\^\{(-?\d+)\}", ax.get_ylabel())) else 0.0
        for ax in (left, right)
    ]
    ends = [
        np.array(ax.get_ylim()) * 10.0**by for ax, by in zip((left, right), scales, strict=True)
    ]
    np.testing.assert_allclose(ends[1], ends[0] / 0.32, rtol=1e-6)


def test_torques_of_the_motor_are_told_in_amperes_and_no_others(knee, tmp_path):
    (o,) = knee.observations
    assert not any(row.current for row in summarise(knee).rows.values())
    # a negative constant: current is counted the other way
    o.settings["torque_constant"] = -0.32
    try:
        summary = summarise(knee)
    finally:
        del o.settings["torque_constant"]
    told = {name: row.current for name, row in summary.rows.items() if row.current}
    # simulated with 0.02 N m of noise
    assert told["noise.sigma"][0] == pytest.approx(0.02 / 0.32, rel=0.02)
    assert {name.partition(".")[0] for name in told} == {
        *("motor", "noise", "total", "total_drive", "total_back")
    }
    # of the joint's bearing only what the motor feels of it
    rest = [name for name, row in summary.rows.items() if row.unit == "N m" and name not in told]
    assert {name.partition(".")[0] for name in rest} == {"joint"}
    assert all(summary.rows[name].unit == "N m" for name in told)
    frame = summary.frame.set_index("name")
    assert set(frame.index[frame["current"].notna()]) == set(told)
    ends = frame.loc["motor.coulomb_positive", ["low", "high", "current_low", "current_high"]]
    np.testing.assert_allclose(ends.iloc[:2].astype(float), 0.32 * ends.iloc[2:].astype(float))
    table = parameter_table(summary)
    (note,) = [x for x in table.notes if "in A" in x]
    assert f"noise.sigma is {told['noise.sigma'][0]:.3g}" in note
    rows = pd.read_csv(io.StringIO(parameters_csv(table))).set_index("name")
    assert set(rows.index[rows["current"].notna()]) <= set(told)
    assert rows.loc["noise.sigma", "current"] == pytest.approx(told["noise.sigma"][0])
    page = read_page(run_page(tmp_path, summary, "knee"))
    (line,) = [r for r in page.all("tr") if r.attrs.get("data-name") == "noise.sigma"]
    assert f"{told['noise.sigma'][0]:.3g} A [" in line.text


def test_behind_an_unknown_gain_only_the_noise_is_a_current(make_fit):
    fit = make_fit(replace(SLIDE, gain=True), samples=400)
    (o,) = fit.observations
    o.settings["torque_constant"] = 5.0
    told = {name for name, row in summarise(fit).rows.items() if row.current}
    assert told == {"noise.sigma"}


def children(figure):
    return [child for ax in figure.axes for child in ax.child_axes]


def test_lag_1_is_one_number_in_caption_and_summary(many):
    """About zero, though residuals have a mean and recordings differ in length and noise."""

    rng = np.random.default_rng(5)

    def moved(o, _):
        noise = lfilter([1.0], [1.0, 0.6], rng.standard_normal(o.measured.size))
        return o.measured.size * (0.5 + noise)

    fit = disturbed(many, moved)
    told = summarise(fit).noise.residual_lag1
    assert residual_analysis(fit).correlation[0] == pytest.approx(told, rel=1e-12)
    # a mean of 0.5 beside noise of variance 1/(1 - 0.6^2) and lag -0.6; four sds of a white lag
    pairs = sum(int(o.follows.sum()) for o in fit.target.likelihood.outputs)
    assert told == pytest.approx((0.25 - 0.6 / 0.64) / (0.25 + 1 / 0.64), abs=4 / np.sqrt(pairs))
