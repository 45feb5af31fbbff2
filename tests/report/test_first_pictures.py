"""The page's first screen: words before names, remarks, and what its calculator takes."""

import numpy as np
import pytest

from bayesfric.report.page.pages import run_page
from bayesfric.report.summary.summary import summarise

from .conftest import build
from .made_summaries import knee
from .page_reader import read_page


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


def test_what_is_no_page_json_is_left_out(tmp_path):
    for text in ("", "[]", "{}", '{"calculator": 3}', "\x00"):
        (tmp_path / "page.json").write_text(text, encoding="utf-8")
        page = read_page(run_page(tmp_path, knee(), "run"))
        (section,) = page.all("section", id="calculator")
        assert "holds no page.json" in section.text
