"""A run whose draws are damaged is refused in one line that names the file."""

import os
import shutil

import h5py
import pytest

from bayesfric.commands.fit import fit
from bayesfric.problem.config import read_config

from .bench import SAMPLED, has, simulated, without_figures

pytestmark = pytest.mark.usefixtures("nothing_explained")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    simulated(folder / "small.toml", SAMPLED)
    with pytest.MonkeyPatch.context() as patch:
        without_figures(patch)
        patch.setattr("bayesfric.diagnostics.explanation.LEAST_OUTPUTS", 10**9)
        fit(read_config(folder / "small.toml"), folder / "run")
    return folder


@pytest.fixture
def run(bench, made):
    shutil.copytree(made, bench.folder, dirs_exist_ok=True)
    return bench.folder / "run"


def changed(change):
    def damage(path):
        with h5py.File(path, "r+") as file:
            change(file["posterior"])

    return damage


def shorter(group):
    values = group["motor.inertia"][:, :-1]
    del group["motor.inertia"]
    group["motor.inertia"] = values


def not_finite(group):
    group["motor.inertia"][0, 0] = float("nan")


DAMAGED = {
    "missing": os.unlink,
    "empty": lambda path: os.truncate(path, 0),
    "cut off": lambda path: os.truncate(path, 5000),
    "one parameter less": changed(lambda group: group.__delitem__("motor.inertia")),
    "other shapes": changed(shorter),
    "nan": changed(not_finite),
}


@pytest.mark.parametrize("damage", DAMAGED.values(), ids=DAMAGED)
@pytest.mark.parametrize("words", [("rollout", "run"), ("export", "run", "--to", "csv")])
def test_damaged_draws(bench, run, damage, words):
    damage(run / "posterior.nc")
    has(bench.refused(*words), "run/posterior.nc")


@pytest.mark.parametrize("damage", [DAMAGED["missing"], DAMAGED["empty"]])
def test_the_page_and_the_table_need_no_draws(bench, run, damage):
    damage(run / "posterior.nc")
    assert bench.run("report", "run").code == 0
    assert bench.run("compare", "run").code == 0
