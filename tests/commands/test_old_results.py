"""Results of every released version stay readable; ``tests/data`` keeps a small one of each.

They are packed, as most of a small ``posterior.nc`` is empty space in HDF5's tables; of the
2000 draws of the prior, which nothing here reads, every fiftieth was kept.
"""

import json
import zipfile

import numpy as np
import pytest

from bayesfric.inference.archive import read_archive
from tests.conftest import REPOSITORY

OLD = sorted((REPOSITORY / "tests" / "data").glob("*.*.*.zip"))


@pytest.fixture(scope="module", params=OLD, ids=lambda path: path.stem)
def run(request, tmp_path_factory):
    """Unpack a run directory; its name is the version that wrote it."""
    folder = tmp_path_factory.mktemp("old")
    with zipfile.ZipFile(request.param) as packed:
        packed.extractall(folder)
    return folder / request.param.stem


def test_there_is_one_of_this_version():
    assert OLD[0].stem == "0.1.0"
    assert OLD[0].stat().st_size < 60_000


def test_compare_reads_it(bench, run):
    ended = bench.run("compare", run, "--json")
    assert ended.code == 0, ended
    summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    assert summary["bayesfric"] == run.name
    assert "motor.inertia" in ended.out


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
