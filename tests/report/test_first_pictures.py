"""The page's first screen: the seconds that tell most, and words."""

import copy
import re

import numpy as np
import pytest

from bayesfric.report.figures.registry import FinishedRun, run_figures
from bayesfric.report.figures.style import PAGE
from bayesfric.report.figures.worst import worst_figure, worst_seconds
from bayesfric.report.page.run_page import run_page
from bayesfric.report.summary.summary import summarise

from .conftest import build, draw_fast
from .made_summaries import FOUND, knee
from .page_reader import read_page


def test_words_come_before_raw_names(tmp_path):
    page = read_page(run_page(tmp_path, knee(), "run"))
    (first,) = page.all("section", id="why")
    names = [p for p in first.all("p") if p.attrs.get("class") == "names"]
    assert names
    for p in names:
        assert all(re.fullmatch(r"made up \w+\.\w+(; )?", s.text) for s in p.all("span"))


@pytest.mark.parametrize("number", [4, 5])
def test_dozens_of_remarks_stand_behind_one_line(tmp_path, number):
    told = knee() | {"warnings": [f"remark {k}" for k in range(number)], "may_be_simulated": True}
    told["findings"] = [FOUND | {"severity": "note"}]
    (first,) = read_page(run_page(tmp_path, told, "run")).all("section", id="why")
    flags = [p.attrs["data-kind"] for p in first.all("p") if p.attrs.get("class") == "flag"]
    assert flags == ["missing", *["warning"] * number, "simulated"]
    folds = [one for one in first.all("details") if one.attrs.get("class") == "flags"]
    behind = [p.attrs["data-kind"] for one in folds for p in one.all("p")]
    assert behind == (["warning"] * number if number > 4 else [])


def test_prior_intervals_are_of_the_priors():
    fit = build(samples=400, ensembles=2)
    found = summarise(fit).rows
    for prior, name in zip(fit.posterior.priors, fit.posterior.names, strict=True):
        low, high = found[name].prior_interval
        inside = prior.distribution.cdf([low, high]) - prior.distribution.cdf(prior.lower)
        assert inside / prior.mass == pytest.approx([0.05, 0.95], abs=1e-9)
    # of a total, by a large sample of its own
    rng = np.random.default_rng(1)
    draws = {
        name: prior.draw(20_000, rng)
        for name, prior in zip(fit.posterior.names, fit.posterior.priors, strict=True)
    }
    mine = (
        draws["motor.viscous"] + draws["joint.viscous"] * (1 + draws["gearbox.load_drive"]) / 2500
    )
    ends = np.quantile(mine, [0.05, 0.95])
    assert found["total_drive.viscous"].prior_interval == pytest.approx(ends, rel=0.15)


@pytest.fixture
def long():
    """A fit of 13 s in two halves, whose residuals are nothing but a burst at 9 s."""
    fit = build(samples=6000)
    residual = np.zeros_like(fit.target.likelihood.outputs[0].measured)
    time = fit.target.likelihood.outputs[0].time
    residual[(time > 5.9) & (time < 6.1)] = 0.3
    changed = copy.copy(fit)
    changed.__dict__["residuals"] = [residual]
    return changed


def test_the_worst_seconds_are_chosen_by_the_rule(long):
    (o,), (residual,) = long.target.likelihood.outputs, long.residuals
    found = worst_seconds(long)
    begin, end = found.outputs.time[0], found.outputs.time[-1]
    assert 4.5 < end - begin <= 5.0
    assert begin < 5.9
    assert end > 6.1
    inside = (o.time >= begin) & (o.time <= end)
    np.testing.assert_array_equal(found.residual, residual[inside])
    # no other window of 5 s is worse
    for first in o.time[:: o.time.size // 50]:
        other = (o.time >= first) & (o.time <= first + 5.0)
        if o.time[-1] >= first + 5.0:
            assert np.mean(residual[other] ** 2) <= np.mean(found.residual**2) * (1 + 1e-9)


def test_the_figure_is_of_those_seconds(long):
    found = worst_seconds(long)
    figure = worst_figure(long)
    draw_fast(figure)
    (ax,) = figure.axes
    assert figure.get_figwidth() == PAGE
    assert ax.get_xlim() == (found.outputs.time[0], found.outputs.time[-1])
    (measured,) = [line for line in ax.lines if line.get_gid() == "measured"]
    time, value = measured.get_data()
    # where outputs are missing the line breaks
    assert np.isnan(value).sum() == (~found.outputs.follows).sum()
    np.testing.assert_array_equal(value[np.isfinite(value)], found.outputs.measured)
    (mean,) = [line for line in ax.lines if line.get_gid() == "mean"]
    left = value - mean.get_ydata()
    np.testing.assert_allclose(left[np.isfinite(left)], found.residual, atol=1e-12)
    caption = run_figures()["worst"].caption_of(FinishedRun(long, summarise(long)))
    assert f"Not typical: {time[0]:.4g} s to {time[-1]:.4g} s of run 0" in caption


def test_what_is_no_page_json_is_left_out(tmp_path):
    for text in ("", "[]", "{}", '{"calculator": 3}', "\x00"):
        (tmp_path / "page.json").write_text(text, encoding="utf-8")
        page = read_page(run_page(tmp_path, knee(), "run"))
        (section,) = page.all("section", id="calculator")
        assert "holds no page.json" in section.text
