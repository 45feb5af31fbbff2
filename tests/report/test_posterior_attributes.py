"""``posterior.nc`` says of every number what it is, and what determined it."""

import json

import numpy as np
import pytest

from bayesfric.inference.archive import read_archive, write_archive
from bayesfric.report.run_directory import archived
from bayesfric.report.summary.record import Summary
from bayesfric.report.summary.summary import summarise

from .made_summaries import every_kind, knee


@pytest.fixture(scope="module")
def run(make_fit, tmp_path_factory):
    fit = make_fit(samples=400, ensembles=2)
    summary = summarise(fit)
    path = tmp_path_factory.mktemp("nc") / "posterior.nc"
    write_archive(path, **archived(fit, summary, "", []))
    return fit, summary, read_archive(path)


def test_every_variable_carries_unit_symbol_meaning_and_verdict(run):
    _, summary, data = run
    for group in ("posterior", "prior"):
        assert set(data[group].data_vars) == set(summary.parameters)
        for name, row in summary.parameters.items():
            told = data[group][name].attrs
            assert told["units"] == (row.unit or "1")
            assert (told["symbol"], told["long_name"]) == (row.symbol, row.meaning)
            assert told["verdict"] == row.verdict
    assert json.loads(data.attrs["noise"]) == summary.noise.as_dict()
    assert data.attrs["status"] == "reliable"


def test_derived_quantities_are_those_of_the_summary(run):
    _, summary, data = run
    found = data["derived"].data_vars
    assert {"total_drive.inertia", "gearbox.alpha_drive"} <= set(found) <= set(summary.derived)
    for name in found:
        row, draws = summary.derived[name], found[name]
        assert np.nanmedian(draws.values) == pytest.approx(row.median, rel=1e-12)
        assert draws.attrs["units"] == (row.unit or "1")
        assert draws.attrs["verdict"] == row.verdict
        assert draws.sizes["chain"] == data["posterior"].sizes["chain"]


def test_prior_intervals_are_of_the_priors(run):
    fit, found = run[0], run[1].rows
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


@pytest.mark.parametrize("made", [knee, every_kind])
def test_reading_and_writing_a_summary_changes_nothing(made):
    assert Summary.read(made()).as_dict() == made()


def test_a_data_frame_has_a_line_for_each_number():
    summary = Summary.read(every_kind())
    frame = summary.frame.set_index("name")
    assert list(frame.index) == [*summary.parameters, *summary.derived]
    line = frame.loc["motor.coulomb_positive"]
    assert (line["value"], line["low"], line["high"]) == (0.016, 0.002, 0.051)
    assert line["unit"] == "N m"
