"""``posterior.nc`` says of every number what it is, and ArviZ reads it."""

import json
import warnings

import numpy as np
import pytest
import xarray as xr

from bayesfric.report.posterior_file import posterior_bytes
from bayesfric.report.summary.record import Summary
from bayesfric.report.summary.summary import summarise

from .made_summaries import every_kind, knee

# not ASCII, and of several lines
CONFIG = 'a = "ä"\n[b]\n'


def written(fit, summary, draws=None):
    return posterior_bytes(fit, summary, CONFIG, [], draws)


@pytest.fixture(scope="module")
def fitted(make_fit):
    fit = make_fit(samples=400, ensembles=2)
    return fit, summarise(fit)


@pytest.fixture(scope="module")
def path(fitted, tmp_path_factory):
    path = tmp_path_factory.mktemp("nc") / "posterior.nc"
    path.write_bytes(written(*fitted))
    return path


@pytest.fixture(scope="module")
def run(fitted, path):
    return *fitted, xr.load_datatree(path, engine="h5netcdf")


def test_two_writes_are_the_same(fitted, path):
    assert written(*fitted) == path.read_bytes()


def test_arviz_reads_it(run, path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # 0.23 announces its own refactoring, once a day
        import arviz
    _, _, data = run
    read = arviz.from_netcdf(str(path), engine="h5netcdf")
    for name, draws in data["posterior"].data_vars.items():
        assert read["posterior"][name].dims == ("chain", "draw")
        np.testing.assert_array_equal(read["posterior"][name].values, draws.values)
    assert read.attrs["seed"] == data.attrs["seed"]


def test_log_prior_is_the_density_of_each_prior_at_each_draw(run):
    fit, _, data = run
    assert set(data["log_prior"].data_vars) == set(fit.posterior.names)
    total = sum(data["log_prior"].data_vars.values())
    assert total.dims == ("chain", "draw")
    draws = np.stack([data["posterior"][name].values for name in fit.posterior.names], axis=-1)
    expected = fit.target.log_prior(draws.reshape(-1, draws.shape[-1]))
    np.testing.assert_allclose(total.values.ravel(), expected, rtol=1e-9)


def test_every_variable_carries_unit_symbol_meaning_and_verdict(run):
    _, summary, data = run
    for group in ("posterior", "prior"):
        assert set(data[group].data_vars) == set(summary.parameters)
        for name, row in summary.parameters.items():
            stored = data[group][name].attrs
            expected = [row.unit or "1", row.symbol, row.meaning, row.verdict]
            assert [stored[k] for k in ("units", "symbol", "long_name", "verdict")] == expected
    assert json.loads(data.attrs["noise"]) == summary.noise.as_dict()
    assert data.attrs["status"] == "reliable"


def test_derived_quantities_are_those_of_the_summary(run):
    _, summary, data = run
    variables = data["derived"].data_vars
    assert {"total_drive.inertia", "gearbox.alpha_drive"} <= set(variables) <= set(summary.derived)
    for name in variables:
        row, draws = summary.derived[name], variables[name]
        assert np.nanmedian(draws.values) == pytest.approx(row.median, rel=1e-12)
        assert draws.attrs["units"] == (row.unit or "1")
        assert draws.attrs["verdict"] == row.verdict
        assert draws.sizes["chain"] == data["posterior"].sizes["chain"]


def test_reading_and_writing_a_summary_changes_nothing_and_its_frame_has_every_number():
    for run in (knee(), every_kind()):
        summary = Summary.read(run)
        assert Summary.read(summary.as_dict()) == summary
    frame = summary.frame.set_index("name")
    assert list(frame.index) == [*summary.parameters, *summary.derived]
    line = frame.loc["motor.coulomb_positive"]
    assert (line["value"], line["low"], line["high"], line["unit"]) == (0.016, 0.002, 0.051, "N m")
