"""Trace plot: true steps, every ensemble, awkward chains survived."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.report.figures.trace import trace_figure

from .conftest import SLIDE, draw_fast


def test_steps_and_lags_are_the_samplers(knee):
    figure = trace_figure(knee)
    thin = knee.posterior.diagnostics.thin
    left, right = figure.axes[:2]
    steps = left.lines[0].get_xdata()
    assert steps[0] == thin
    assert steps[-1] == knee.posterior.diagnostics.steps
    lags = right.lines[1].get_xdata()
    np.testing.assert_array_equal(lags, thin * np.arange(lags.size))
    assert right.lines[1].get_ydata()[0] == pytest.approx(1.0)
    assert right.texts[0].get_text() == r"$\tau$ = 2.5 steps"


def test_medians_of_each_ensemble(knee):
    left = trace_figure(knee).axes[0]
    draws = knee.posterior["motor.inertia"] * 1e4
    assert len(left.lines) == draws.shape[0]
    for line, ensemble in zip(left.lines, draws, strict=True):
        np.testing.assert_allclose(line.get_ydata(), np.median(ensemble, axis=0), rtol=1e-12)
    assert len({(line.get_color(), line.get_linestyle()) for line in left.lines}) == 3


def test_fourteen_rows_at_most(many):
    figure = trace_figure(many)
    assert len(figure.axes) == 28
    assert figure.axes[26].get_ylabel().startswith(r"$\sigma_{3}$")
    assert [text.get_text() for text in figure.texts] == [r"not shown: $\sigma_{4}$"]


def test_constant_parameter(make_fit):
    figure = trace_figure(make_fit(constant=("motor.viscous",)))
    draw_fast(figure)
    assert figure.axes[3].texts[0].get_text() == "never moved"


def test_one_stuck_walker_does_not_hide_the_others(knee):
    draws = knee.posterior.draws.copy()
    draws[0, 3] = draws[0, 3, 0]
    fit = replace(knee, posterior=replace(knee.posterior, draws=draws))
    figure = trace_figure(fit)
    draw_fast(figure)
    assert all(np.isfinite(line.get_ydata()).all() for line in figure.axes[1].lines)


@pytest.mark.parametrize("ensembles", [2, 20])
def test_few_and_many_ensembles(make_fit, ensembles):
    figure = trace_figure(make_fit(SLIDE, ensembles=ensembles))
    draw_fast(figure)
    assert len(figure.axes[0].lines) == ensembles
