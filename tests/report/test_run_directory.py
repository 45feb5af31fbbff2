"""A run directory: what it holds, that its numbers are right, that it is whole or absent."""

import hashlib
import json
import platform
import shutil
from dataclasses import replace
from importlib.metadata import version

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
        made = parse_config(CONFIG + SIMULATION, folder / "made.toml")
        simulate(made, folder / f"{name}.csv", seed=seed)
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


def test_the_files_of_the_design(run):
    found = {path.name for path in run.iterdir()}
    tables = {"summary.csv", "methods.csv"}
    folders = {"figures", "tables", "text"}
    files = {"posterior.nc", "summary.json", "config.toml", "report.html"}
    assert found == files | folders | tables
    drawn = {path.name for path in (run / "figures").iterdir()}
    stems = ("corner", "prediction", "methods", "friction", "residual")
    assert drawn == {f"{stem}.{kind}" for stem in stems for kind in ("pdf", "png", "svg")}
    assert all(path.stat().st_size for path in run.rglob("*"))


def test_what_a_paper_wants_can_be_had_later(run, tmp_path, monkeypatch):
    """Of a run made without it, from draws and recordings: to the byte what --paper gives."""
    some = {stem: run_directory.FIGURES[stem] for stem in DRAWN}
    monkeypatch.setattr(run_directory, "FIGURES", some)
    again = shutil.copytree(run, tmp_path / "run")
    wanted = [f"figures/{stem}.{kind}" for stem in DRAWN for kind in ("pdf", "png")]
    wanted += [f"tables/{name}.tex" for name in ("parameters", "estimates")]
    wanted += ["text/references.bib"]
    for name in wanted:
        (again / name).unlink()
    report(again)
    assert not any((again / name).exists() for name in wanted)
    assert set(report(again, paper=True)["written"]) >= set(wanted)
    for name in wanted:
        assert (again / name).read_bytes() == (run / name).read_bytes(), name
    assert {path.name for path in again.iterdir()} == {path.name for path in run.iterdir()}


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


def ensembles(archive, names):
    """All kept draws of each ensemble, ``(ensembles, draws, d)``."""
    number = archive["sample_stats"]["ensemble"].values
    stacked = np.stack([archive["posterior"][name].values for name in names], axis=-1)
    return np.stack([stacked[number == e] for e in range(number.max() + 1)])


def test_pointwise_log_likelihood_adds_up(archive, problem):
    """Each stored row is one kept draw of its ensemble; its sum is the likelihood there."""
    target = problem.target(choice=NoiseChoice(1, ()))
    kept = ensembles(archive, target.names)
    sums = sum(archive["log_likelihood"][name].values.sum(axis=-1) for name in NAMES)
    assert sums.shape[0] == kept.shape[0]
    for row, draws in zip(sums, kept, strict=True):
        expected = target.log_likelihood(draws)
        away = np.abs(row[:, None] - expected[None]).min(axis=1)
        # neighbouring draws differ by some 1e-3
        assert away.max() < 1e-7
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


def test_walkers_of_an_ensemble_are_named(summary, archive):
    sampler = summary["sampler"]
    number = archive["sample_stats"]["ensemble"].values
    assert (np.ptp(number, axis=1) == 0).all()
    assert np.bincount(number[:, 0]).tolist() == [sampler["walkers"]] * sampler["ensembles"]


def test_root_attributes_tell_where_it_came_from(folder, archive):
    attrs = archive.attrs
    versions = json.loads(attrs["versions"])
    assert attrs["bayesfric"] == bayesfric.__version__
    assert versions["python"] == platform.python_version()
    for name in ("numpy", "scipy", "emcee", "numba", "xarray"):
        assert versions[name] == version(name)
    assert attrs["seed"] == "12"
    assert attrs["config"] == CONFIG
    assert json.loads(attrs["recordings"]) == {
        name: hashlib.sha256((folder / f"{name}.csv").read_bytes()).hexdigest() for name in NAMES
    }


# -- whole or absent; made-up fits, for these are of the folder alone


@pytest.fixture(scope="module")
def made(make_fit):
    made = make_fit(samples=400, ensembles=2)
    return made, summarise(made).as_dict()


@pytest.fixture
def undrawn(monkeypatch):
    monkeypatch.setattr(run_directory, "FIGURES", {})


def write(folder, made, config="# one\n"):
    write_run(folder, *made, config, [])


def held(folder):
    return {
        path.relative_to(folder): path.is_file() and path.read_bytes() for path in folder.rglob("*")
    }


@pytest.fixture
def broken(monkeypatch):
    """The second figure fails."""

    def fail(*_):
        raise RuntimeError("no ink")

    both = {"corner": blank, "prediction": fail}
    both = {stem: drawn_by(stem, draw) for stem, draw in both.items()}
    monkeypatch.setattr(run_directory, "FIGURES", both)


@pytest.mark.usefixtures("broken")
@pytest.mark.parametrize("old", [False, True])
def test_a_figure_that_fails_leaves_what_was_there(tmp_path, made, old):
    if old:
        (tmp_path / "run").mkdir()
        (tmp_path / "run" / "summary.json").write_text("{}")
    before = held(tmp_path)
    with pytest.raises(RuntimeError, match="no ink"):
        write(tmp_path / "run", made)
    assert held(tmp_path) == before


@pytest.mark.usefixtures("undrawn")
def test_a_full_disk_is_told_and_leaves_nothing(tmp_path, made, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(run_directory.Path, "write_bytes", full)
    with pytest.raises(BadInput, match="No space left on device"):
        write(tmp_path / "run", made)
    assert held(tmp_path) == {}


@pytest.mark.usefixtures("undrawn")
def test_force_replaces_a_run(tmp_path, made):
    folder = tmp_path / "run"
    for text in ("# one\n", "# two\n"):
        check_output_folder(folder, force=True)
        write(folder, made, text)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    assert (folder / "config.toml").read_text() == "# two\n"
    with pytest.raises(BadInput, match=r"is not empty.*--force"):
        check_output_folder(folder, force=False)


def test_force_does_not_replace_what_is_not_a_run(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "thesis.tex").write_text("dear reader")
    with pytest.raises(BadInput, match=r"holds no .summary\.json"):
        check_output_folder(tmp_path / "run", force=True)
    assert set(map(str, held(tmp_path))) == {"run", "run/thesis.tex"}
