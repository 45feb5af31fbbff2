"""What is written is read again, by ArviZ of either generation."""

import lzma

import h5py
import numpy as np
import pytest

from bayesfric.inference.archive import read_archive, write_archive
from tests.conftest import REPOSITORY

# posterior "motor.inertia" of two chains and two draws, root attribute seed = "7", as
# write_archive made it with each ArviZ; the one installed is always the other for one of them.
WRITTEN_BY = sorted((REPOSITORY / "tests" / "data").glob("arviz-*.nc.xz"))

RNG = np.random.default_rng(3)
# names as this package makes them: dotted parameters, recordings called after their files
GROUPS = {
    "posterior": {
        "motor.coulomb_positive": RNG.random((4, 5)),
        "noise.sigma.run-2.left": RNG.random((4, 5)),
    },
    "log_likelihood": {"run-2.left": RNG.random((2, 3, 6)), "rest": RNG.random((2, 3, 7))},
    "sample_stats": {"lp": RNG.random((4, 5)), "ensemble": np.arange(20).reshape(4, 5) // 10},
    "posterior_predictive": {"run-2.left": RNG.random((2, 3, 6)), "rest": RNG.random((2, 3, 7))},
    "observed_data": {"run-2.left": RNG.random(6), "rest": RNG.random(7)},
    "prior": {"motor.coulomb_positive": RNG.random((1, 9))},
}
TIMES = {"time_run-2.left": 0.1 * np.arange(6), "time_rest": 0.3 * np.arange(7)}
ATTRS = {"seed": "7", "config": 'a = "ä"\n[b]\n', "versions": '{"numpy": "2"}'}


def write(path):
    dims = {"run-2.left": ["time_run-2.left"], "rest": ["time_rest"]}
    write_archive(path, GROUPS, dims=dims, coords=TIMES, attrs=ATTRS)
    return path


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write(tmp_path_factory.mktemp("archive") / "posterior.nc")


@pytest.mark.parametrize("group", GROUPS)
def test_every_number_comes_back(path, group):
    found = read_archive(path)[group]
    assert set(found.data_vars) == set(GROUPS[group])
    for name, values in GROUPS[group].items():
        np.testing.assert_array_equal(found[name].values, values)
        assert found[name].dtype.kind == values.dtype.kind


def test_dimensions_have_names_and_labels(path):
    data = read_archive(path)
    assert data["posterior"]["motor.coulomb_positive"].dims == ("chain", "draw")
    assert data["prior"]["motor.coulomb_positive"].dims == ("chain", "draw")
    for group in ("log_likelihood", "posterior_predictive"):
        for name in ("run-2.left", "rest"):
            assert data[group][name].dims == ("chain", "draw", f"time_{name}")
    for name in ("run-2.left", "rest"):
        found = data["observed_data"][name]
        assert found.dims == (f"time_{name}",)
        np.testing.assert_array_equal(found[f"time_{name}"].values, TIMES[f"time_{name}"])


def test_root_attributes_are_those_given_and_no_others(path):
    assert dict(read_archive(path).attrs) == ATTRS


def content(path):
    """Every value and attribute of the file, whatever library wrote it."""
    found = {}

    def visit(name, item):
        # HDF5's own bookkeeping of dimensions holds addresses in the file
        inner = {"REFERENCE_LIST", "DIMENSION_LIST"}
        attrs = {k: str(v) for k, v in item.attrs.items() if k not in inner}
        found[name] = (attrs, item[()].tobytes() if isinstance(item, h5py.Dataset) else None)

    with h5py.File(path) as file:
        found[""] = ({k: str(v) for k, v in file.attrs.items()}, None)
        file.visititems(visit)
    return found


def test_two_writes_are_the_same_and_tell_no_time(path, tmp_path):
    first, second = content(path), content(write(tmp_path / "again.nc"))
    assert first == second
    assert {name.partition("/")[0] for name in first} - {""} == set(GROUPS)
    assert not [name for name, (attrs, _) in first.items() if "created_at" in attrs]


@pytest.mark.parametrize("packed", WRITTEN_BY, ids=lambda path: path.name)
def test_files_of_both_arviz_generations_are_readable(packed, tmp_path):
    path = tmp_path / "other.nc"
    path.write_bytes(lzma.decompress(packed.read_bytes()))
    data = read_archive(path)
    found = data["posterior"]["motor.inertia"]
    assert found.dims == ("chain", "draw")
    np.testing.assert_array_equal(found.values, [[0.25, 0.5], [0.75, 1.0]])
    assert data.attrs["seed"] == "7"


def test_more_walkers_than_draws_is_nothing_to_warn_of(tmp_path):
    write_archive(
        tmp_path / "wide.nc", {"posterior": {"x": np.ones((9, 5))}}, dims={}, coords={}, attrs={}
    )
    assert read_archive(tmp_path / "wide.nc")["posterior"]["x"].shape == (9, 5)
