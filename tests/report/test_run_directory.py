"""A run directory: what it holds, that its numbers are right, that it is whole or absent."""

import hashlib
import json
import platform
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import bayesfric
from bayesfric.base.atomic_write import check_output_folder
from bayesfric.base.errors import BadInput
from bayesfric.commands.fit import fit
from bayesfric.commands.runs import report
from bayesfric.commands.simulate import simulate
from bayesfric.fit.model import Model
from bayesfric.inference.noise import NoiseChoice
from bayesfric.problem.config import parse_config, read_config
from bayesfric.report import run_directory
from bayesfric.report.run_directory import write_run
from bayesfric.report.summary.summary import summarise
from tests.commands.bench import JOINT, recorded, simulation

# Two recordings, one with dots and a dash in its name, each with a noise scale of its own.
NAMES = ("plain", "run-2.left")
CONFIG = f"# ein Kommentar mit ä\n{JOINT}{''.join(map(recorded, NAMES))}"
CONFIG += "\n[sampling]\nmin_ess = 500\nseed = 12\n"
SIMULATION = simulation(torque_noise=0.05)
OF_OUTPUTS = ("log_likelihood", "posterior_predictive", "observed_data")
FILES = ("posterior.nc", "summary.json", "summary.csv", "methods.csv", "config.toml", "report.html")
SAMPLED = {
    "motor.inertia",
    "motor.viscous",
    "motor.coulomb",
    "offset",
    "noise.pacf_1",
    *(f"noise.sigma.{name}" for name in NAMES),
}


# Figures that are really drawn here; the others are in tests/commands/test_fit.py.
DRAWN = ("corner", "residual")


def blank(*_):
    return Figure(figsize=(0.1, 0.1))


def drawn_by(stem, draw):
    return replace(run_directory.FIGURES[stem], draw=draw)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with configuration and recordings, and in it the finished run."""
    folder = tmp_path_factory.mktemp("bench")
    for seed, name in enumerate(NAMES):
        config = parse_config(CONFIG + SIMULATION, folder / "made.toml")
        simulate(config, folder / f"{name}.csv", seed=seed)
    (folder / "axis.toml").write_text(CONFIG, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        for stem in run_directory.FIGURES:
            # an axis has no ridge and no load, nothing is held out, nobody asked what it lacks
            if stem not in ("ridge", *DRAWN):
                patch.setitem(run_directory.FIGURES, stem, drawn_by(stem, blank))
        fit(read_config(folder / "axis.toml"), folder / "run", paper=True)
    return folder


@pytest.fixture(scope="module")
def run(folder):
    return folder / "run"


@pytest.fixture(scope="module")
def summary(run):
    return json.loads((run / "summary.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def archive(run):
    return xr.load_datatree(run / "posterior.nc")


@pytest.fixture(scope="module")
def problem(folder):
    return Model.from_config(read_config(folder / "axis.toml"))


def test_what_a_paper_wants_can_be_had_later(run, tmp_path, monkeypatch):
    """Of a run made without it, from draws and recordings: to the byte what --paper gives."""
    drawn = {stem: run_directory.FIGURES[stem] for stem in DRAWN}
    monkeypatch.setattr(run_directory, "FIGURES", drawn)
    again = shutil.copytree(run, tmp_path / "run")
    wanted = [f"figures/{stem}.{kind}" for stem in DRAWN for kind in ("pdf", "png")]
    wanted += [f"tables/{name}.tex" for name in ("parameters", "estimates")]
    wanted += ["text/references.bib"]
    whole = {path.relative_to(again) for path in again.rglob("*")}
    assert {*map(Path, wanted), *map(Path, FILES)} <= whole
    for name in wanted:
        (again / name).unlink()
    report(again)
    assert not any((again / name).exists() for name in wanted)
    assert set(report(again, paper=True)["written"]) >= set(wanted)
    for name in wanted:
        assert (again / name).read_bytes() == (run / name).read_bytes(), name
    assert {path.relative_to(again) for path in again.rglob("*")} == whole


def test_groups_and_dimensions_have_the_names_of_the_design(archive, problem):
    assert set(archive.children) == {"posterior", "sample_stats", "prior", "log_prior", *OF_OUTPUTS}
    assert set(archive["posterior"].data_vars) == set(archive["prior"].data_vars) == SAMPLED
    assert {"lp", "ensemble"} <= set(archive["sample_stats"].data_vars)
    assert all(archive["posterior"][name].dims == ("chain", "draw") for name in SAMPLED)
    for group in OF_OUTPUTS:
        assert set(archive[group].data_vars) == set(NAMES), group
    for o in problem.observations:
        time = f"time_{o.name}"
        assert archive["observed_data"][o.name].dims == (time,)
        for group in ("log_likelihood", "posterior_predictive"):
            assert archive[group][o.name].dims == ("chain", "draw", time)
        np.testing.assert_array_equal(archive["observed_data"][time].values, o.time)
        # the filtered torque
        np.testing.assert_array_equal(archive["observed_data"][o.name].values, o.measured)


def test_pointwise_log_likelihood_adds_up(summary, archive, problem):
    """Each stored row is one kept draw of its ensemble; its sum is the likelihood there."""
    target = problem.target(choice=NoiseChoice(1, ()))
    number = archive["sample_stats"]["ensemble"].values
    assert (np.ptp(number, axis=1) == 0).all()
    sampler = summary["sampler"]
    assert np.bincount(number[:, 0]).tolist() == [sampler["walkers"]] * sampler["ensembles"]
    draws = np.stack([archive["posterior"][name].values for name in target.names], axis=-1)
    stored = [archive["log_likelihood"][name].values.astype(np.float64) for name in NAMES]
    sums, sizes = (sum(x.sum(axis=-1) for x in part) for part in (stored, map(np.abs, stored)))
    assert len(sums) == sampler["ensembles"]
    for e, row in enumerate(sums):
        expected = target.log_likelihood(draws[number == e])
        away = np.abs(row[:, None] - expected[None]).min(axis=1)
        # single precision; neighbouring draws differ by some 1e-3
        assert away.max() < 2.0**-24 * sizes.max() + 1e-7
        # and not one draw over and over
        assert np.unique(row).size > row.size / 2


def test_predictions_spread_like_the_noise(archive, problem):
    for o in problem.observations:
        sigma = archive["posterior"][f"noise.sigma.{o.name}"].values
        predicted = archive["posterior_predictive"][o.name].values
        flat = predicted.reshape(-1, predicted.shape[-1])
        spread = np.sqrt(flat.var(axis=0).mean())
        # the noise and a little of the parameters' own uncertainty
        assert np.sqrt(np.mean(sigma**2)) * 0.95 < spread < np.sqrt(np.mean(sigma**2)) * 1.3
        z = (o.measured - flat.mean(axis=0)) / spread
        assert 0.6 < z.std() < 1.4
        # draws of different outputs do not know of each other
        assert not np.array_equal(predicted[0, 0], predicted[0, 1])


def test_prior_draws_are_of_the_priors(archive, problem):
    for name in ("motor.inertia", "motor.viscous", "motor.coulomb", "offset"):
        drawn = archive["prior"][name].values.ravel()
        prior = problem.priors[name]
        assert drawn.min() >= prior.lower
        assert drawn.std() == pytest.approx(prior.sd(), rel=0.15), name


def test_root_attributes_tell_where_it_came_from(folder, archive):
    attrs = archive.attrs
    assert json.loads(attrs["versions"])["python"] == platform.python_version()
    stored = [attrs[key] for key in ("bayesfric", "seed", "config")]
    assert stored == [bayesfric.__version__, "12", CONFIG]
    assert json.loads(attrs["recordings"]) == {
        name: hashlib.sha256((folder / f"{name}.csv").read_bytes()).hexdigest() for name in NAMES
    }


# -- whole or absent; made-up fits, for these are of the folder alone


@pytest.fixture(scope="module")
def made_fit(make_fit):
    fit = make_fit(samples=400, ensembles=2)
    return fit, summarise(fit).as_dict()


def held(folder):
    return {
        path.relative_to(folder): path.is_file() and path.read_bytes() for path in folder.rglob("*")
    }


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize(
    ("error", "raised"),
    [(RuntimeError("no ink"), RuntimeError), (OSError(28, "No space left on device"), BadInput)],
)
def test_a_figure_that_fails_or_a_full_disk_leaves_what_was_there(
    tmp_path, made_fit, monkeypatch, old, error, raised
):
    def fail(*_):
        raise error

    monkeypatch.setattr(run_directory, "FIGURES", {"corner": drawn_by("corner", fail)})
    if old:
        (tmp_path / "run").mkdir()
        (tmp_path / "run" / "summary.json").write_text("{}")
    before = held(tmp_path)
    with pytest.raises(raised, match=error.args[-1]):
        write_run(tmp_path / "run", *made_fit, "# one\n", [])
    assert held(tmp_path) == before


def test_force_replaces_a_run(tmp_path, made_fit, monkeypatch):
    monkeypatch.setattr(run_directory, "FIGURES", {})
    folder = tmp_path / "run"
    for text in ("# one\n", "# two\n"):
        check_output_folder(folder, force=True)
        write_run(folder, *made_fit, text, [])
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    assert (folder / "config.toml").read_text() == "# two\n"
    with pytest.raises(BadInput, match=r"is not empty.*--force"):
        check_output_folder(folder, force=False)
    (folder / "summary.json").rename(folder / "thesis.tex")  # then it is no run
    with pytest.raises(BadInput, match=r"holds no .summary\.json"):
        check_output_folder(folder, force=True)
