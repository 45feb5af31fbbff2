"""``bayesfric fit``, ``demo`` and ``pool``: numbers, files, repetition and interruption."""

import hashlib
import json
import os
import resource
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import xarray as xr

import bayesfric as bf
from bayesfric.base.atomic_write import run_lock
from bayesfric.base.progress import Timer
from bayesfric.commands.fit import fit
from bayesfric.inference import sampling
from bayesfric.inference.target import Target
from bayesfric.problem.config import read_config
from bayesfric.report import run_directory

from .bench import JOINT, SMALL, has, recorded, simulated, simulation, without_figures

CONFIG = f"""{SMALL}
[sampling]
min_ess = 500
seed = 3

[self_check]
recordings = 10
{simulation(encoder_counts=2**20)}"""
TRUTH = {"motor.inertia": 0.01, "motor.viscous": 0.05, "motor.coulomb": 0.2, "offset": 0.02}
KINDS = ("pdf", "png", "svg")
# Too few steps to converge: for tests of the folder, not of the numbers.
FEW = CONFIG.replace("min_ess = 500", "min_ess = 1e6\nmax_steps = 100\nwalkers = 10\nensembles = 2")
FEW = FEW.replace("recordings = 10", "recordings = 0")
FIT_FEW = ("fit", "few.toml", "-o", "run")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("small")
    simulated(folder / "small.toml", CONFIG)
    return folder


def start(folder, *words, **options):
    """Run the command the way a user does, in a separate process."""
    command = [sys.executable, "-m", "bayesfric", *words]
    options = {"stdout": subprocess.PIPE, "timeout": 600} | options
    return subprocess.run(command, cwd=folder, stderr=subprocess.PIPE, check=False, **options)


@pytest.fixture(scope="module")
def done(folder):
    return start(folder, "fit", "small.toml", "-o", "run", "--paper", "--json")


def draws(run):
    data = xr.load_datatree(run / "posterior.nc")
    return {
        f"{group} {name}": data[group][name].values
        for group in ("posterior", "log_likelihood", "posterior_predictive", "prior")
        for name in data[group].data_vars
    }


def without_seconds(summary):
    """Leave out what differs between equal runs: how long they took, and where they were."""
    sampler = {**summary["sampler"], "seconds": None}
    check = {**summary["self_check"], "seconds": None, "cpu_seconds": None}
    return {**summary, "sampler": sampler, "self_check": check, "source": None}


def test_a_fit_in_a_separate_process(done, folder):
    assert (done.returncode, done.stderr) == (0, b"")
    written = json.loads((folder / "run" / "summary.json").read_text(encoding="utf-8"))
    assert json.loads(done.stdout) == written
    assert written["sampler"]["status"] == "reliable"
    assert written["may_be_simulated"]
    figures = {path.name for path in (folder / "run" / "figures").iterdir()}
    assert {f"{stem}.{kind}" for stem in ("corner", "prediction") for kind in KINDS} <= figures
    for name, value in TRUTH.items():
        row = written["parameters"][name]
        assert abs(row["mean"] - value) < 4.5 * row["sd"], name


def test_one_seed_gives_one_posterior(done, folder, tmp_path, monkeypatch):
    without_figures(monkeypatch)
    summary = fit(read_config(folder / "small.toml"), tmp_path / "again")
    assert without_seconds(summary) == without_seconds(json.loads(done.stdout))
    first, second = draws(folder / "run"), draws(tmp_path / "again")
    assert set(second) == set(first)
    for name, values in first.items():
        np.testing.assert_array_equal(second[name], values, err_msg=name)


def test_time_is_that_of_all_processes():
    timer = Timer()
    program = "import time\nwhile time.process_time() < 0.3: pass"
    subprocess.run([sys.executable, "-c", program], check=True)
    time.sleep(0.2)
    # the system counts user's and kernel's time in ticks, each cut off to a whole one
    ticks = 2 / os.sysconf("SC_CLK_TCK")
    assert 0.3 - ticks <= timer.cpu_seconds <= timer.seconds - 0.1


@pytest.fixture
def few(bench, folder, monkeypatch):
    """A fit that ends soon, and draws and explains nothing."""
    without_figures(monkeypatch)
    (bench.folder / "few.toml").write_text(FEW, encoding="utf-8")
    (bench.folder / "small.csv").write_bytes((folder / "small.csv").read_bytes())
    return bench


@pytest.mark.usefixtures("unexplained")
def test_too_few_steps_end_with_3_and_are_marked(few):
    ended = few.run(*FIT_FEW)
    assert ended.code == 3
    sampler = few.summary()["sampler"]
    assert sampler["status"] in ("tentative", "unusable")
    assert sampler["problems"]
    names = {path.name for path in (few.folder / "run").iterdir()}
    assert names >= {"posterior.nc", "summary.json", "summary.csv", "config.toml"}


@pytest.mark.usefixtures("unexplained")
@pytest.mark.parametrize("name", ["Knie rechts, 2 kg", "a/b"])
def test_a_name_that_cannot_be_stored_is_refused_or_stored(few, name):
    """Either is fine; a traceback after all the sampling is not."""
    text = FEW.replace('file = "small.csv"', f'file = "small.csv"\nname = "{name}"')
    (few.folder / "few.toml").write_text(text, encoding="utf-8")
    ended = few.run(*FIT_FEW)
    if ended.code == 2:
        assert not (few.folder / "run").exists()
        return
    assert ended.code == 3, ended
    data = xr.load_datatree(few.folder / "run" / "posterior.nc")
    assert list(data["observed_data"].data_vars) == [name]


@pytest.mark.usefixtures("unexplained")
def test_output_error_is_estimated_only_when_requested(few):
    plain = few.record(*FIT_FEW, codes=(3,))
    more = few.record("fit", "few.toml", "-o", "more", "--output-error", codes=(3,))
    assert set(more["estimates"]) - set(plain["estimates"]) == {"output-error"}
    assert more["estimates"]["output-error"]["converged"]
    second = draws(few.folder / "more")
    for name, values in draws(few.folder / "run").items():
        np.testing.assert_array_equal(second[name], values, err_msg=name)


# -- interruptions, pipes and full disks


@pytest.fixture
def interruptible(few):
    """Hear signals: a process started in the background (nohup, ``&``) would ignore SIGINT."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    before_term = signal.getsignal(signal.SIGTERM)
    yield few
    signal.signal(signal.SIGINT, before)
    signal.signal(signal.SIGTERM, before_term)


def interrupt_likelihood(monkeypatch, stop):
    def warm_up(warm, *_):
        monkeypatch.setattr(Target, "__call__", stop)
        warm.run(10)

    monkeypatch.setattr(sampling, "_warm_up", warm_up)


def interrupt_writing(monkeypatch, stop):
    monkeypatch.setattr(run_directory, "posterior_bytes", stop)


@pytest.mark.usefixtures("unexplained")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("moment", [interrupt_likelihood, interrupt_writing])
def test_an_interrupted_fit_leaves_nothing(interruptible, monkeypatch, moment, number):
    before = interruptible.held()
    moment(monkeypatch, lambda *_: os.kill(os.getpid(), number))
    ended = interruptible.run(*FIT_FEW, "--json")
    assert (ended.code, ended.out) == (130, "")
    assert interruptible.held() == before


def test_a_run_of_another_process_is_locked(few):
    with run_lock(few.folder / "run"):
        has(few.refused(*FIT_FEW), "run: another process")


@pytest.fixture(scope="module")
def unconverged(folder):
    """Fit into a closed pipe, as ``bayesfric fit ... | head`` does: it ends like any other."""
    (folder / "few.toml").write_text(FEW, encoding="utf-8")
    read, write = os.pipe()
    os.close(read)
    ended = start(folder, *FIT_FEW[:2], "-o", "few-run", stdout=write)
    os.close(write)
    return ended


def test_a_closed_pipe_does_not_stop_a_fit(unconverged, folder):
    assert (unconverged.returncode, unconverged.stderr) == (3, b"")
    assert (folder / "few-run" / "report.html").is_file()


def test_a_terminal_without_unicode(unconverged, folder):
    assert unconverged.returncode == 3
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    ended = start(folder, "compare", "few-run", env=environment)
    assert ended.returncode == 0, ended.stderr
    ended.stdout.decode("ascii")


@pytest.mark.parametrize(
    "words",
    [
        ("fit", "few.toml", "-o", "new"),
        ("simulate", "few.toml", "-o", "new.csv"),
        ("report", "few-run", "--paper"),
    ],
    ids=lambda words: words[0],
)
def test_a_full_disk(unconverged, folder, words):
    def held():
        paths = (p for p in folder.rglob("*") if p.is_file() and "__pycache__" not in p.parts)
        return {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}

    assert unconverged.returncode == 3
    before = held()
    environment = {**os.environ, "NUMBA_DISABLE_CACHING": "1"}
    limit = (resource.RLIMIT_FSIZE, (1000, 1000))
    ended = start(folder, *words, env=environment, preexec_fn=lambda: resource.setrlimit(*limit))
    assert ended.returncode == 2, ended.stderr
    assert ended.stderr.count(b"\n") == 1
    has(ended.stderr.decode(), "bayesfric: ", "File too large")
    assert held() == before


# -- the demo


def totals_of_table_3():
    """Totals that the motor of the paper's knee feels: eqs. (11) and (13) at Table 3."""
    expected = {}
    alphas = {"drive": 0.7432, "back": 1.408}  # and a gearbox of 50
    for side, alpha in alphas.items():
        total = f"total_{side}"
        expected[f"{total}.inertia"] = 3.56e-4 + 0.206 / (alpha * 50**2)
        expected[f"{total}.viscous"] = 4.0e-3 + 3.12 / (alpha * 50**2)
        expected[f"{total}.coulomb_positive"] = 0.087 + 5.03 / (alpha * 50)
        expected[f"{total}.coulomb_negative"] = 0.091 + 5.15 / (alpha * 50)
        expected[f"{total}.gravity"] = 0.42 * 9.80665 / (alpha * 50)
    drive, back = (1 / alpha for alpha in alphas.values())
    expected["gearbox.lambda_ratio"] = (drive + back) / (drive - back)
    return expected


@pytest.mark.slow
def test_the_demo_recovers_table_3(bench):
    ended = bench.run("demo", "-o", "run", "--json")
    assert ended.code == 0, ended
    assert "simulated" in ended.err
    summary = json.loads(ended.out)
    assert summary["sampler"]["status"] == "reliable"
    assert summary["identifiability"]["null_directions"]
    for name, value in totals_of_table_3().items():
        row = summary["derived"][name]
        assert row["gauge_free"]
        assert abs(row["mean"] - value) < 4 * row["sd"], (name, value, row["mean"], row["sd"])


# -- several recordings: an offset for each, some held out, some parameters that vary

SHORT = "\n[sampling]\nwalkers = 32\nmax_steps = 400\nmin_ess = 200\n"


@pytest.mark.usefixtures("unexplained", "no_figures")
def test_each_recording_has_its_offset(bench):
    offsets = {"one": 0.08, "two": -0.05}
    for seed, (name, offset) in enumerate(offsets.items(), start=1):
        keys = {"duration": 4.0, "rate": 500, "encoder_counts": 2**20, "torque_noise": 0.01}
        motion = simulation(seed=seed, **keys) + f"parameters = {{ offset = {offset} }}\n"
        bench.simulated(JOINT + recorded(name) + motion, name)
    text = JOINT + 'offset = "per-recording"\n' + "".join(map(recorded, offsets)) + SHORT
    bench.config(text)
    for method, estimate in bench.record("estimate", "c.toml")["estimates"].items():
        rows = estimate["parameters"]
        assert "offset" not in rows
        for name, value in offsets.items():
            row = rows[f"offset.{name}"]
            assert abs(row["value"] - value) < 5 * row["sd_robust"] < 0.05, (method, name)
        row = rows["motor.coulomb"]
        assert abs(row["value"] - 0.2) < 5 * row["sd_robust"], method
    prior = '\n[priors]\noffset = {distribution = "norm", loc = 0.0, scale = 0.3}\n'
    bench.config(text + prior)
    rows = bench.record("fit", "c.toml", "-o", "run", codes=(0, 3))["parameters"]
    for name, value in offsets.items():
        row = rows[f"offset.{name}"]
        assert row["prior_sd"] == pytest.approx(0.3)
        assert abs(row["mean"] - value) < 5 * row["sd"] < 0.05
        assert row["verdict"] == "data"


NAMES = ("one", "two", "three")
THREE = JOINT + "".join(map(recorded, NAMES)) + SHORT
THREE += '\n[processing]\nlowpass = "100 Hz"\ndecimate = 1\n'
HELD_OUT = '\n[validation]\nrecordings = ["two"]\nhold_out = 0.2\n'


@pytest.fixture
def three(bench, monkeypatch):
    text = simulation(rate=400, encoder_counts=0, torque_noise=0.01)
    for seed, name in enumerate(NAMES, start=1):
        bench.simulated(JOINT + recorded(name) + text, name, seed)
    bench.config(THREE + HELD_OUT)
    without_figures(monkeypatch)
    return bench


@pytest.mark.usefixtures("unexplained")
def test_held_out_recordings_are_predicted_and_change_no_draw(three):
    def fitted(run):
        assert three.run("fit", "c.toml", "-o", run).code in (0, 3)
        posterior = xr.load_datatree(three.folder / run / "posterior.nc")["posterior"]
        return three.summary(run), {name: x.values for name, x in posterior.data_vars.items()}

    def add_torque(name, begin, size):
        three.altered(lambda table: table + size * (table[:, :1] >= begin) * [0.0, 0.0, 1.0], name)

    summary, first = fitted("run")
    parts = summary["validation"]["parts"]
    assert {name: part["held_out"] for name, part in parts.items()} == {
        "one": "last 20 %", "two": "whole recording", "three": "last 20 %",
    }  # fmt: skip
    assert set(summary["fit"]["recordings"]) == {"one", "three"}
    add_torque("two", 0.0, 0.05)
    add_torque("one", 2.41, 0.03)
    again, second = fitted("again")
    assert set(second) == set(first)
    for name, values in first.items():
        np.testing.assert_array_equal(second[name], values)
    assert again["parameters"] == summary["parameters"]
    assert again["estimates"] == summary["estimates"]
    # the torque added, beyond a noise of 0.01 N m
    for name, size in (("two", 0.05), ("one", 0.03)):
        part = again["validation"]["parts"][name]
        assert part["verdict"] == "model discrepancy"
        assert part["discrepancy"]["value"] == pytest.approx(size, rel=0.1)
    assert again["validation"]["parts"]["three"] == parts["three"]


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ('[validation]\nrecordings = ["twoo"]', ["validation.recordings", "'two'"]),
        ('[validation]\nrecordings = ["one", "two", "three"]', ["validation.recordings"]),
        ("[validation]\nhold_out = 0.001", ["validation.hold_out", "last 0.1 %"]),
        (f'{HELD_OUT}[likelihood]\nmethod = "output-error"', ["validation", "output-error"]),
        (f'{HELD_OUT}[priors]\n"offset.two" = 0.0', ["priors.offset.two"]),
    ],
)
def test_bad_validation(three, text, parts):
    joint = THREE.replace("[mechanism]\n", '[mechanism]\noffset = "per-recording"\n')
    three.config(f"{joint if 'offset.two' in text else THREE}\n{text}\n")
    has(three.refused("check", "c.toml"), "c.toml: ", *parts)


@pytest.mark.usefixtures("unexplained")
def test_pool_prints_what_python_returns(bench):
    viscous = (0.2, 0.26, 0.22)
    keys = {"duration": 5, "rate": 500, "amplitude": 1.5, "torque_noise": 0.02}
    for k, value in enumerate(viscous):
        parameters = f'"motor.inertia" = 0.05, "motor.viscous" = {value}, offset = 0.05'
        text = simulation(encoder_side="joint", **keys) + f"parameters = {{ {parameters} }}\n"
        bench.simulated(JOINT + recorded(f"day{k}") + text, f"day{k}", seed=k)
    tables = "".join(recorded(f"day{k}") for k in range(len(viscous)))
    short = '[noise]\nmodel = "white"\n[sampling]\nmin_ess = 100\nensembles = 2\nwalkers = 48\n'
    bench.config(JOINT + tables + short + '[pooling]\nvary = { "motor.viscous" = "recording" }\n')
    has(bench.refused("fit", "c.toml", "-o", "run"), "bayesfric pool")
    printed = bench.record("pool", "c.toml")
    pooled = bf.pool(bf.Model.from_config(bench.folder / "c.toml"))
    returned = json.loads(json.dumps(pooled.as_json()))
    assert returned["warnings"] == list(bf.check(bench.folder / "c.toml").warnings)
    times = {"seconds": 0, "cpu_seconds": 0}
    assert printed | times == returned | times
    # the system counts in ticks
    assert 0.1 < returned["cpu_seconds"] < returned["seconds"] * os.cpu_count() + 0.05
    (varying,) = printed["varying"]
    assert varying["jointly"]["spread"]["low"] > 0.0
    # of 3.3 sds, 100 independent draws leave a median uncertain by an eighth of one
    for value, run in zip(viscous, varying["jointly"]["runs"], strict=True):
        assert abs(run["median"] - value) < run["high"] - run["low"]
