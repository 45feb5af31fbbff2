"""The Python API: the same numbers as the command line, on arrays, tables and files."""

import hashlib
import json
import re
import shutil
from dataclasses import replace
from functools import partial
from importlib.resources import files
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy import stats

import bayesfric as bf
from bayesfric.base.errors import BadInput
from bayesfric.mechanism.joint import PRESETS
from bayesfric.problem.config import config_of, mechanism_table, prior_value
from tests.axis import swing
from tests.commands.bench import Bench, without_figures
from tests.conftest import REPOSITORY, brought

# imported before fixtures take the figures away
PLOT = bf.plot
TRUTH = {"motor.inertia": 0.01, "motor.viscous": 0.05, "motor.coulomb": 0.2, "offset": 0.02}
QUICK = {"min_ess": 400, "ensembles": 2, "walkers": 24}


@pytest.fixture
def bench(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    without_figures(monkeypatch)
    return Bench(tmp_path, monkeypatch, capfd)


def axis():
    """A plain axis, not made by a preset."""
    motor = bf.Element("motor", inertia=True, coulomb="symmetric", viscous=True)
    return bf.Joint([motor], bf.Load(), offset=True)


def measured(seed=0, n=2000):
    """Exact motion of an axis, with noise of the torque."""
    t = np.arange(n) / 500.0
    q, qd, qdd = swing(t, [(0.49, 0.8), (1.7, 0.3), (3.8, 0.05)])
    noise = 0.01 * np.random.default_rng(seed).standard_normal(n)
    return t, q, axis().torque(TRUTH, q, qd, qdd) + noise


def recording_of(seed=0, **keywords):
    return bf.Recording.from_arrays(*measured(seed), **keywords)


def same_draws(first, second):
    assert set(first.data_vars) == set(second.data_vars)
    for name in first.data_vars:
        assert first[name].values.tobytes() == second[name].values.tobytes(), name


@pytest.mark.slow
def test_the_example_of_the_reference_is_the_fit(bench, monkeypatch):
    text = (REPOSITORY / "studies/reference/python.md").read_text()
    (code,) = re.findall(r"<!-- python-example -->\n```python\n(.*?)```\n<!-- end -->", text, re.S)
    # the first 1.5 s, and few draws: the two ways are the same at any length
    knee = (Path(str(files("bayesfric") / "examples")) / "knee.csv").read_text().splitlines()
    (bench.folder / "knee.csv").write_text("\n".join(knee[:1501]) + "\n")
    monkeypatch.setattr(bf, "Model", partial(bf.Model, sampling={"min_ess": 1000}))
    names = {}
    exec(compile(code, "python.md", "exec"), names)
    (bench.folder / "own.toml").write_text("""
[mechanism]
preset = "rabbit-knee"
[[recordings]]
file = "knee.csv"
time = { column = "time", unit = "s" }
position = { column = "position", unit = "rad", side = "motor" }
torque = { column = "torque", unit = "N m" }
[priors]
"motor.inertia" = { distribution = "norm", loc = 3.6e-4, scale = 2e-5 }
[sampling]
min_ess = 1000
""")
    ended = bench.run("fit", "own.toml", "-o", "own-run", "--seed", "1")
    assert ended.code == 0, ended
    written = xr.load_datatree(bench.folder / "own-run" / "posterior.nc")
    same_draws(written["posterior"], names["post"]["posterior"])
    same_draws(written["derived"], names["post"]["derived"])
    inertia = names["post"].posterior["motor.inertia"]
    assert inertia.attrs["units"] == "kg m²"
    assert inertia.attrs["verdict"] in ("data", "weak", "prior")


@pytest.mark.usefixtures("unexplained")
def test_a_run_of_arrays_and_tables_recovers_the_truth_and_can_be_moved(bench):
    t, q, tau = measured(seed=2)
    table = pd.DataFrame({"stamp": 1e3 * t, "angle": np.degrees(q), "tau": tau})
    columns = {"time": "stamp", "position": "angle", "torque": "tau"}
    units = {"time": "ms", "position": "deg"}
    second = bf.Recording.from_dataframe(table, **columns, units=units, name="two")
    recordings = [recording_of(1), second]
    model = bf.Model(axis(), recordings, sampling=QUICK, references={"offset": 0.02})
    posterior = model.sample(seed=3)
    for name, value in TRUTH.items():
        draws = posterior.posterior[name].values
        assert abs(draws.mean() - value) < 5 * draws.std() + 0.02 * value, name
    run = bench.folder / "run"
    assert bf.report(posterior, run) == run / "report.html"
    source = json.loads((run / "summary.json").read_text())["source"]["recordings"]
    assert set(source) == {"recording-1", "two"}
    for row in source.values():
        assert hashlib.sha256(Path(row["file"]).read_bytes()).hexdigest() == row["sha256"]
    shutil.move(run, bench.folder / "elsewhere")
    again = bf.Model.from_config(bench.folder / "elsewhere" / "config.toml")
    assert all(not o.warnings for o in again.observations)
    same_draws(again.sample(seed=3)["posterior"], posterior["posterior"])
    assert bf.summary(bench.folder / "elsewhere").parameters == bf.summary(posterior).parameters


@pytest.mark.usefixtures("unexplained")
def test_log_density_is_the_posterior_that_is_sampled():
    model = bf.Model(axis(), recording_of(), noise="white", priors={"motor.viscous": (0.0, 1.0)})
    posterior = model.sample(seed=1)
    rows = np.stack([posterior.posterior[name].values[0, :5] for name in model.names], axis=1)
    target = model.white_target()
    expected = target.log_prior(rows) + target.log_likelihood(rows)
    np.testing.assert_allclose(model.log_density(rows), expected)
    values = dict(zip(model.names, rows[0], strict=True))
    assert model.log_density(values) == pytest.approx(expected[0])
    assert model.log_density(values | {"motor.viscous": 2.0}) == -np.inf
    assert model.log_density(values | {"motor.inertia": -1.0}) == -np.inf
    with pytest.raises(BadInput, match="names other parameters"):
        model.log_density({"motor.inertia": 1.0})
    with pytest.raises(BadInput, match="5 numbers"):
        model.log_density([1.0, 2.0])


def test_estimates_and_identifiability_are_tables():
    model = bf.Model(axis(), [recording_of()])
    estimate = model.estimate("input-error")
    assert estimate.loc["motor.inertia", "value"] == pytest.approx(0.01, rel=0.02)
    assert list(estimate.index.names) == ["name"]
    assert list(estimate.columns[:2]) == ["value", "sd"]
    both = model.estimate("least-squares", "input-error")
    assert set(both.index.get_level_values("method")) == {"least-squares", "input-error"}
    assert model.identify().loc["motor.inertia", "status"] == "identified"


def test_check_is_what_the_command_prints(bench):
    pd.DataFrame(dict(zip("tqu", measured(), strict=True))).to_csv(bench.folder / "one.csv")
    columns = {"time": "t", "position": "q", "torque": "u"}
    model = bf.Model(axis(), bf.Recording.from_file(bench.folder / "one.csv", **columns))
    (bench.folder / "c.toml").write_text(model.config.text)
    checked = bf.check("c.toml")
    assert bench.run("check", "c.toml").out.splitlines() == checked.text().splitlines()
    assert bench.record("check", "c.toml") == checked.as_json()
    # nothing is wrong, and the friction is that of the motion
    assert bf.check(model).warnings == ()
    row = checked.as_json()["least_squares"]["parameters"]["motor.coulomb"]
    assert row["value"] == pytest.approx(TRUTH["motor.coulomb"], rel=0.02)


def test_the_torque_of_a_motion_is_the_sum_of_its_terms():
    speed, acceleration = np.array([0.5, -2.0, 0.0]), np.array([1.0, 0.0, 3.0])
    expected = 0.01 * acceleration + 0.05 * speed + 0.2 * np.sign(speed) + 0.02
    for values in (TRUTH, TRUTH | {"noise.sigma": 0.1}):  # a posterior has the noise's, too
        torque = axis().torque(values, 0.3, speed, acceleration)
        np.testing.assert_allclose(torque, expected, rtol=1e-12)
    # draws of some, with others known
    draws = axis().torque(TRUTH | {"offset": np.array([0.02, 0.52])}, 0.3, speed, acceleration)
    np.testing.assert_allclose(draws, [expected, expected + 0.5], rtol=1e-12)
    # as the drive would report it; a motion that is given has no delay
    values = TRUTH | {"drive.gain": 0.8, "drive.delay": 0.01}
    late = replace(axis(), gain=True, delay=True).torque(values, 0.3, speed, acceleration)
    np.testing.assert_allclose(late, expected / 0.8, rtol=1e-12)
    with pytest.raises(KeyError, match=r"missing: \['offset'\]"):
        axis().torque({n: x for n, x in TRUTH.items() if n != "offset"}, 0.3, speed, acceleration)


@pytest.mark.usefixtures("unexplained")
def test_figures_of_a_posterior():
    posterior = bf.Model(axis(), recording_of(), noise="white", sampling=QUICK).sample()
    assert "friction" in dir(PLOT)
    assert bf.plot.friction(posterior).axes
    with pytest.raises(AttributeError, match="friction"):
        bf.plot.frictoin(posterior)
    with pytest.raises(BadInput, match=r"Model\.sample"):
        bf.report(posterior.sel(draw=[0, 1]), "run")


@pytest.mark.parametrize(
    ("keywords", "match"),
    [
        ({"samplin": {}}, "samplin: .* 'sampling'"),
        ({"sampling": 3}, "sampling: got 3"),
        ({"likelihood": {"method": object()}}, "likelihood.method: got object"),
        ({"priors": {"motor.inertia": stats.norm}}, "priors.motor.inertia: got norm_gen"),
        ({"priors": {"motor.inertia": np.float64(-1)}}, "motor.inertia: -1"),
        ({"recordings": []}, "no recording"),
        ({"recordings": [recording_of(name="one")] * 2}, "'one'"),
        ({"recordings": ["knee.csv"]}, "Recording"),
    ],
)
def test_bad_keywords_are_named(keywords, match):
    with pytest.raises(BadInput, match=match):
        bf.Model(axis(), **{"recordings": recording_of()} | keywords)
    with pytest.raises(BadInput, match="'rabbit-knee'"):
        bf.Joint.preset("rabit-knee")


@pytest.mark.parametrize(
    ("viscous", "reference", "name"),
    [
        ("by-direction", "motor.viscous", "total.viscous"),
        ("by-direction", "total.viscous", "total.viscous"),
        (True, "total.viscous", "motor.viscous"),
        (True, "motor.viscous", "motor.viscous"),
    ],
)
def test_a_reference_is_of_the_same_loss_by_direction_or_not(viscous, reference, name):
    """What ``explain`` advises to add does not break what a configuration compares with."""
    motor = bf.Element("motor", inertia=True, coulomb="symmetric", viscous=viscous)
    joint = bf.Joint([motor], bf.Load(), offset=True)
    references = bf.Model(joint, recording_of(), references={reference: 0.05}).references
    assert set(references) == {name}
    assert references[name]["value"] == 0.05
    with pytest.raises(BadInput, match="no result of this mechanism"):
        bf.Model(joint, recording_of(), references={"total.viscous": 0.05, "motor.viscous": 0.05})


@pytest.mark.parametrize(
    "prior",
    [stats.norm(3.3e-4, 2e-5), stats.gamma(2.0, scale=1e-4), stats.truncnorm(a=0, b=2, loc=1)],
)
def test_a_frozen_distribution_is_its_text(prior):
    text = prior_value(prior)
    again = getattr(stats, text.pop("distribution"))(**text)
    x = prior.ppf([0.1, 0.5, 0.9])
    np.testing.assert_array_equal(again.logpdf(x), prior.logpdf(x))


@pytest.mark.parametrize("name", PRESETS)
def test_a_joint_is_its_text(name):
    preset = PRESETS[name].chain()
    joint = bf.Joint.preset(name)
    for same in (joint, bf.Joint(joint.elements, joint.load, offset=joint.offset)):
        chain = config_of({"mechanism": mechanism_table(same)}).tables.mechanism.joint()
        assert (chain.elements, chain.load) == (preset.elements, preset.load)
        assert (chain.offset, chain.made_from) == (preset.offset, same.made_from)


def test_importing_the_package_does_not_import_numpy():
    assert brought("bayesfric, bayesfric.commands.cli", "numpy") == "[]"


def test_a_fit_imports_no_library_of_figures_and_tables():
    """LaTeX tables imported Matplotlib, 0.4 s, before the first number of a fit."""
    heavy = ("matplotlib", "pandas", "arviz", "xarray")
    assert brought("bayesfric.commands.fit, bayesfric.fit.model", *heavy) == "[]"


def test_an_element_without_friction_stays_in_the_chain():
    joint = bf.Joint([bf.Element("motor", inertia=True), bf.Element("gearbox")])
    assert mechanism_table(joint)["elements"]["gearbox"] == {}
    config = config_of({"mechanism": mechanism_table(joint)})
    assert config.tables.mechanism.joint().elements == joint.elements
