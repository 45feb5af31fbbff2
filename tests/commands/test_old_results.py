"""Results of every released version stay readable; ``tests/data`` keeps a small one of each."""

import json

import numpy as np
import pytest

from bayesfric.inference.archive import read_archive
from tests.conftest import REPOSITORY

OLD = sorted((REPOSITORY / "tests" / "data").glob("*.*.*"))


def test_there_is_one_of_this_version():
    assert OLD[0].name == "0.1.0"
    assert sum(path.stat().st_size for path in OLD[0].iterdir()) < 250_000


@pytest.mark.parametrize("run", OLD, ids=lambda path: path.name)
def test_compare_reads_it(bench, run):
    ended = bench.run("compare", run, "--json")
    assert ended.code == 0, ended
    summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    assert summary["bayesfric"] == run.name
    assert "motor.inertia" in ended.out


@pytest.mark.parametrize("run", OLD, ids=lambda path: path.name)
def test_its_draws_are_those_of_its_summary(run):
    """The mean and the sd of the stored draws are the printed ones, up to rounding of sums."""
    data = read_archive(run / "posterior.nc")
    assert data.attrs["bayesfric"] == run.name
    summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    for name, row in summary["parameters"].items():
        draws = data["posterior"][name].values
        assert np.isclose(draws.mean(), row["mean"], rtol=1e-12, atol=1e-12 * row["sd"])
        assert np.isclose(draws.std(), row["sd"], rtol=1e-9)
    for group in ("log_likelihood", "posterior_predictive", "observed_data", "prior"):
        assert data[group].data_vars
