"""Prior against posterior: every parameter, its densities and its verdict."""

import copy

import numpy as np
import pytest

from bayesfric.report.figures.prior_posterior import prior_posterior_figure
from bayesfric.report.figures.quantity import quantities
from bayesfric.report.figures.style import PAGE
from bayesfric.report.summary.record import Summary
from bayesfric.report.summary.summary import summarise

from .conftest import draw_fast
from .made_summaries import failed


@pytest.fixture(scope="module")
def drawn(knee):
    summary = summarise(knee).as_dict()
    return knee, summary, prior_posterior_figure(knee, Summary.read(summary))


def text(ax, gid):
    return [t.get_text() for t in ax.texts if t.get_gid() == gid]


def test_every_parameter_has_a_panel_and_its_verdict(drawn):
    fit, summary, figure = drawn
    draw_fast(figure)
    assert figure.get_figwidth() == PAGE
    assert [ax.get_xlabel() for ax in figure.axes] == [q.label() for q in quantities(fit)]
    for name, ax in zip(fit.posterior.names, figure.axes, strict=True):
        (words,) = text(ax, "verdict")
        starts = {"data": "data", "weak": "weak", "prior": ("prior", "at most", "at least")}
        assert words.startswith(starts[summary["parameters"][name]["verdict"]])


def test_what_is_doubted_is_not_called_a_mixture_with_the_prior(drawn):
    fit, summary, _ = drawn
    read = Summary.read(summary)
    name = next(n for n, row in read.parameters.items() if row.verdict == "data")
    doubted = {"verdict": "weak", "undoubted": "data", "doubted": ["delay"]}
    figure = prior_posterior_figure(fit, read.with_rows({name: doubted}))
    (words,) = text(figure.axes[fit.posterior.names.index(name)], "verdict")
    assert words == "doubtful"


def test_densities_are_densities(drawn):
    fit, _, figure = drawn
    for q, ax in zip(quantities(fit), figure.axes, strict=True):
        (prior,) = [line for line in ax.lines if line.get_gid() == "prior"]
        x = prior.get_xdata()
        expected = np.exp(q.prior.log_density(x * q.factor)) * q.factor
        np.testing.assert_allclose(prior.get_ydata(), expected, rtol=1e-12)
        (fill,) = [p for p in ax.patches if p.get_gid() in ("posterior", "open")]
        values, edges, _ = fill.get_data()
        shown = q.draws / q.factor
        inside = np.mean((shown >= edges[0]) & (shown <= edges[-1]))
        assert inside > 0.998
        assert float(np.sum(values * np.diff(edges))) == pytest.approx(inside, rel=1e-12)


def test_what_is_open_is_hatched(drawn):
    fit, summary, _ = drawn
    other = copy.deepcopy(summary)
    for row in other["parameters"].values():
        row["verdict"], row["at_bound"] = "prior", None
    figure = prior_posterior_figure(fit, Summary.read(other))
    assert all([p.get_gid() for p in ax.patches if p.get_hatch()] == ["open"] for ax in figure.axes)
    # and has no interval
    assert all([line.get_gid() for line in ax.lines] == ["prior"] for ax in figure.axes)


def test_a_limit_is_told_as_one(drawn):
    fit, summary, _ = drawn
    other = copy.deepcopy(summary)
    row = other["parameters"]["motor.viscous"]
    row |= {"verdict": "prior", "at_bound": "lower", "data_sd": 1e-9, "prior_sd": 1.0}
    figure = prior_posterior_figure(fit, Summary.read(other))
    ax = figure.axes[fit.posterior.names.index("motor.viscous")]
    assert text(ax, "verdict") == [f"at most {row['interval'][1]:.3g}"]


def test_a_constant_parameter(make_fit):
    fit = make_fit(constant=("motor.viscous",), samples=400)
    draw_fast(prior_posterior_figure(fit, summarise(fit)))


def test_ensembles_that_disagree_determine_nothing(drawn):
    fit, summary, _ = drawn
    figure = prior_posterior_figure(fit, Summary.read(failed(summary)))
    for ax in figure.axes:
        assert text(ax, "verdict") == ["NOT converged"]
        assert [p.get_gid() for p in ax.patches if p.get_hatch()] == ["open"]
