"""The Python face: the same numbers as the command line, on arrays, tables and files."""

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


def arrays(seed=0, **options):
    return bf.Recording.from_arrays(*measured(seed), **options)


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
    example = {}
    exec(compile(code, "python.md", "exec"), example)
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
    tree = xr.load_datatree(bench.folder / "own-run" / "posterior.nc")
    same_draws(tree["posterior"], example["post"]["posterior"])
    same_draws(tree["derived"], example["post"]["derived"])
    inertia = example["post"].posterior["motor.inertia"]
    assert inertia.attrs["units"] == "kg m²"
    assert inertia.attrs["verdict"] in ("data", "weak", "prior")


@pytest.mark.usefixtures("unexplained")
def test_arrays_and_tables_find_the_truth_and_make_a_run_of_their_own(bench):
    t, q, tau = measured(seed=2)
    table = pd.DataFrame({"stamp": 1e3 * t, "angle": np.degrees(q), "tau": tau})
    columns = {"time": "stamp", "position": "angle", "torque": "tau"}
    units = {"time": "ms", "position": "deg"}
    two = bf.Recording.from_dataframe(table, **columns, units=units, name="two")
    model = bf.Model(axis(), [arrays(1), two], sampling=QUICK, references={"offset": 0.02})
    posterior = model.sample(seed=3)
    for name, value in TRUTH.items():
        draws = posterior.posterior[name].values
        assert abs(draws.mean() - value) < 5 * draws.std() + 0.02 * value, name
    run = bench.folder / "run"
    assert bf.report(posterior, run) == run / "report.html"
    source = json.loads((run / "summary.json").read_text())["source"]["recordings"]
    assert set(source) == {"recording-1", "two"}
    for file in source.values():
        assert hashlib.sha256(Path(file["file"]).read_bytes()).hexdigest() == file["sha256"]
    # also in another folder
    shutil.move(run, bench.folder / "elsewhere")
    again = bf.Model.from_config(bench.folder / "elsewhere" / "config.toml")
    assert all(not o.warnings for o in again.observations)
    same_draws(again.sample(seed=3)["posterior"], posterior["posterior"])
    assert bf.summary(bench.folder / "elsewhere").parameters == bf.summary(posterior).parameters


@pytest.mark.usefixtures("unexplained")
def test_log_density_is_the_posterior_that_is_sampled():
    model = bf.Model(axis(), arrays(), noise="white", priors={"motor.viscous": (0.0, 1.0)})
    posterior = model.sample(seed=1)
    rows = np.stack([posterior.posterior[name].values[0, :5] for name in model.names], axis=1)
    target = model.white_target()
    expected = target.log_prior(rows) + target.log_likelihood(rows)
    np.testing.assert_allclose(model.log_density(rows), expected)
    theta = dict(zip(model.names, rows[0], strict=True))
    assert model.log_density(theta) == pytest.approx(expected[0])
    assert model.log_density(theta | {"motor.viscous": 2.0}) == -np.inf
    assert model.log_density(theta | {"motor.inertia": -1.0}) == -np.inf
    with pytest.raises(BadInput, match="names other parameters"):
        model.log_density({"motor.inertia": 1.0})
    with pytest.raises(BadInput, match="5 numbers"):
        model.log_density([1.0, 2.0])


def test_point_estimates_and_identifiability_are_tables():
    model = bf.Model(axis(), [arrays()])
    frame = model.estimate("input-error")
    assert frame.loc["motor.inertia", "value"] == pytest.approx(0.01, rel=0.02)
    assert list(frame.index.names) == ["name"]
    assert list(frame.columns[:2]) == ["value", "sd"]
    assert {"least-squares", "input-error"} == set(
        model.estimate("least-squares", "input-error").index.get_level_values("method")
    )
    assert model.identify().loc["motor.inertia", "status"] == "identified"


def test_check_is_what_the_command_prints(bench):
    pd.DataFrame(dict(zip("tqu", measured(), strict=True))).to_csv(bench.folder / "one.csv")
    file = bf.Recording.from_file(bench.folder / "one.csv", time="t", position="q", torque="u")
    model = bf.Model(axis(), file)
    (bench.folder / "c.toml").write_text(model.config.text)
    report = bf.check("c.toml")
    assert bench.run("check", "c.toml").out.splitlines() == report.text().splitlines()
    assert json.loads(bench.run("check", "c.toml", "--json").out) == report.as_json()
    # nothing is wrong, and the friction is that of the motion
    report = bf.check(model)
    assert report.warnings == ()
    row = report.as_json()["least_squares"]["parameters"]["motor.coulomb"]
    assert row["value"] == pytest.approx(TRUTH["motor.coulomb"], rel=0.02)


def test_the_torque_that_a_motion_takes_is_the_sum_of_its_terms():
    speed, acceleration = np.array([0.5, -2.0, 0.0]), np.array([1.0, 0.0, 3.0])
    expected = 0.01 * acceleration + 0.05 * speed + 0.2 * np.sign(speed) + 0.02
    # a posterior's draws hold the noise's, too
    for values in (TRUTH, TRUTH | {"noise.sigma": 0.1}):
        torque = axis().torque(values, 0.3, speed, acceleration)
        np.testing.assert_allclose(torque, expected, rtol=1e-12)
    # draws of some, with others known
    draws = axis().torque(TRUTH | {"offset": np.array([0.02, 0.52])}, 0.3, speed, acceleration)
    np.testing.assert_allclose(draws, [expected, expected + 0.5], rtol=1e-12)
    # as the drive would measure it; a delay of the position does not change a given motion
    values = TRUTH | {"drive.gain": 0.8, "drive.delay": 0.01}
    late = replace(axis(), gain=True, delay=True).torque(values, 0.3, speed, acceleration)
    np.testing.assert_allclose(late, expected / 0.8, rtol=1e-12)
    with pytest.raises(KeyError, match=r"missing: \['offset'\]"):
        axis().torque({n: x for n, x in TRUTH.items() if n != "offset"}, 0.3, speed, acceleration)


@pytest.mark.usefixtures("unexplained")
def test_figures_and_reports_take_a_sampled_posterior():
    posterior = bf.Model(axis(), arrays(), noise="white", sampling=QUICK).sample()
    assert "friction" in dir(PLOT)
    assert len(dir(PLOT)) == len(set(dir(PLOT)))
    assert bf.plot.friction(posterior).axes
    with pytest.raises(AttributeError, match="friction"):
        bf.plot.frictoin(posterior)
    with pytest.raises(BadInput, match=r"Model\.sample"):
        bf.report(posterior.sel(draw=[0, 1]), "run")


def test_objects_show_themselves():
    model = bf.Model(axis(), arrays(name="one"))
    assert re.match(r"one: \d+ outputs\n", repr(model))
    assert "\nmotor.inertia ~ " in repr(model)
    assert "motor.inertia (kg m²): " in repr(model.chain)
    shown = repr(arrays(name="one", added_mass="2 kg", radius=0.3))
    assert {"name: one", "radius: 0.3"} < set(shown.splitlines())


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"samplin": {}}, "samplin: unknown key; did you mean 'sampling'"),
        ({"sampling": 3}, "sampling: got 3; it should be a table"),
        ({"likelihood": {"method": object()}}, "likelihood.method: got object"),
        ({"priors": {"motor.inertia": stats.norm}}, "priors.motor.inertia: got norm_gen"),
        ({"priors": {"motor.inertia": np.float64(-1)}}, "motor.inertia: -1 is not possible"),
    ],
)
def test_bad_keywords_are_named(keywords, message):
    with pytest.raises(BadInput, match=message):
        bf.Model(axis(), arrays(), **keywords)


@pytest.mark.parametrize(
    ("viscous", "key", "name"),
    [
        ("by-direction", "motor.viscous", "total.viscous"),
        ("by-direction", "total.viscous", "total.viscous"),
        (True, "total.viscous", "motor.viscous"),
        (True, "motor.viscous", "motor.viscous"),
    ],
)
def test_a_reference_is_of_the_same_loss_by_direction_or_not(viscous, key, name):
    """What ``explain`` advises to add does not break what a configuration compares with."""
    motor = bf.Element("motor", inertia=True, coulomb="symmetric", viscous=viscous)
    joint = bf.Joint([motor], bf.Load(), offset=True)
    references = bf.Model(joint, arrays(), references={key: 0.05}).references
    assert {key: row["value"] for key, row in references.items()} == {name: 0.05}
    with pytest.raises(BadInput, match="no result of this mechanism"):
        bf.Model(joint, arrays(), references={"total.viscous": 0.05, "motor.viscous": 0.05})


def test_bad_recordings_and_joints_are_named():
    with pytest.raises(BadInput, match="names no recording"):
        bf.Model(axis(), [])
    with pytest.raises(BadInput, match="2 are called 'one'"):
        bf.Model(axis(), [arrays(name="one"), arrays(name="one")])
    with pytest.raises(BadInput, match="give objects of Recording"):
        bf.Model(axis(), ["knee.csv"])
    with pytest.raises(BadInput, match="did you mean 'rabbit-knee'"):
        bf.Joint.preset("rabit-knee")


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


def test_importing_it_imports_nothing_heavy():
    assert brought("bayesfric, bayesfric.commands.cli", "numpy") == "[]"


def test_a_fit_imports_no_library_of_figures_and_tables():
    """Matplotlib takes 0.4 s, before the first number of a fit."""
    heavy = ("matplotlib", "pandas", "arviz", "xarray")
    assert brought("bayesfric.commands.fit, bayesfric.fit.model", *heavy) == "[]"


def test_an_element_without_parameters_stays_in_the_chain():
    joint = bf.Joint([bf.Element("motor", inertia=True), bf.Element("gearbox")])
    assert mechanism_table(joint)["elements"]["gearbox"] == {}
    config = config_of({"mechanism": mechanism_table(joint)})
    assert config.tables.mechanism.joint().elements == joint.elements
