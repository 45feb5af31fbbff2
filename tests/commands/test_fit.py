"""``bayesfric fit`` and ``demo``: as a user runs them, and the same again."""

import json
import os
import subprocess
import sys
import time

import numpy as np
import pytest
import xarray as xr

from bayesfric.base.progress import Timer
from bayesfric.commands.fit import fit
from bayesfric.problem.config import read_config

from .bench import SMALL, simulated, simulation, without_figures

CONFIG = f"""{SMALL}
[sampling]
min_ess = 500
seed = 3

[self_check]
recordings = 10
{simulation(encoder_counts=2**20)}"""
TRUTH = {"motor.inertia": 0.01, "motor.viscous": 0.05, "motor.coulomb": 0.2, "offset": 0.02}
KINDS = ("pdf", "png", "svg")
# Table 3 of the 2005 paper: gearbox 50, alpha_1, alpha_2
ALPHA = {"drive": 0.7432, "back": 1.408}


# Too few steps to converge: for tests of the folder, not of the numbers.
FEW = CONFIG.replace("min_ess = 500", "min_ess = 1e6\nmax_steps = 100\nwalkers = 10\nensembles = 2")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("small")
    simulated(folder / "small.toml", CONFIG)
    return folder


@pytest.fixture(scope="module")
def done(folder):
    """The command, the way a user runs it: in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "bayesfric", "fit", "small.toml", "-o", "run", "--paper", "--json"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


@pytest.fixture
def again(folder, tmp_path, monkeypatch):
    """Fit once more in this process, without drawing; give summary and draws."""
    without_figures(monkeypatch)

    def run(**options):
        summary = fit(read_config(folder / "small.toml"), tmp_path / "again", **options)
        return summary, draws(tmp_path / "again")

    return run


def draws(run):
    data = xr.load_datatree(run / "posterior.nc")
    return {
        f"{group} {name}": data[group][name].values
        for group in ("posterior", "log_likelihood", "posterior_predictive", "prior")
        for name in data[group].data_vars
    }


def without_seconds(summary):
    """Without what differs between equal runs: how long they took, and where they were."""
    sampler = {**summary["sampler"], "seconds": None}
    check = {**summary["self_check"], "seconds": None, "cpu_seconds": None}
    return {**summary, "sampler": sampler, "self_check": check, "source": None}


def test_a_process_of_its_own_ends_well(done, folder):
    assert done.returncode == 0
    assert done.stderr == ""
    written = json.loads((folder / "run" / "summary.json").read_text(encoding="utf-8"))
    assert json.loads(done.stdout) == written
    assert written["sampler"]["status"] == "reliable"
    assert written["may_be_simulated"]
    drawn = {path.name for path in (folder / "run" / "figures").iterdir()}
    assert {f"{stem}.{kind}" for stem in ("corner", "prediction") for kind in KINDS} <= drawn
    for name, value in TRUTH.items():
        row = written["parameters"][name]
        assert abs(row["mean"] - value) < 4.5 * row["sd"], name


def test_who_reads_only_the_first_lines_has_the_run(folder):
    """As ``bayesfric fit ... | head`` does: numbers are printed before anything is written."""
    read, write = os.pipe()
    os.close(read)
    undrawn = (
        "from bayesfric.commands import cli; from bayesfric.diagnostics import explanation; "
        "from bayesfric.report import run_directory; "
        "explanation.LEAST_OUTPUTS = 10**9; run_directory.FIGURES = {}; cli.main()"
    )
    command = [sys.executable, "-c", undrawn, "fit", "few.toml", "-o", "piped"]
    (folder / "few.toml").write_text(FEW, encoding="utf-8")
    done = subprocess.run(
        command, cwd=folder, stdout=write, stderr=subprocess.PIPE, text=True, check=False
    )
    os.close(write)
    assert done.stderr == ""
    assert done.returncode == 3
    assert (folder / "piped" / "report.html").is_file()


def test_time_is_that_of_all_processes():
    spent = Timer()
    program = "import time\nwhile time.process_time() < 0.3: pass"
    subprocess.run([sys.executable, "-c", program], check=True)
    time.sleep(0.2)
    # the system counts user's and kernel's time in ticks, each cut off to a whole one
    ticks = 2 / os.sysconf("SC_CLK_TCK")
    # what waits takes the clock's time, and none of a processor's
    assert 0.3 - ticks <= spent.cpu_seconds <= spent.seconds - 0.1


def test_one_seed_gives_one_posterior(done, folder, again):
    assert done.returncode == 0
    summary, found = again()
    assert without_seconds(summary) == without_seconds(json.loads(done.stdout))
    first = draws(folder / "run")
    assert set(found) == set(first)
    for name, values in first.items():
        np.testing.assert_array_equal(found[name], values, err_msg=name)


def few(bench, folder, text=FEW):
    (bench.folder / "few.toml").write_text(text, encoding="utf-8")
    (bench.folder / "small.csv").write_bytes((folder / "small.csv").read_bytes())


@pytest.mark.usefixtures("no_figures", "unexplained")
def test_too_few_steps_end_with_3_and_are_marked(bench, folder):
    few(bench, folder)
    ended = bench.run("fit", "few.toml", "-o", "run")
    assert ended.code == 3
    assert "Traceback" not in ended.err
    written = bench.summary()
    status = written["sampler"]["status"]
    assert status in ("tentative", "unusable")
    assert written["sampler"]["problems"]
    kept = {path.name for path in (bench.folder / "run").iterdir()}
    assert kept >= {"posterior.nc", "summary.json", "summary.csv", "config.toml"}


@pytest.mark.usefixtures("no_figures", "unexplained")
@pytest.mark.parametrize("name", ["Knie rechts, 2 kg", "posterior", "a/b", "offset"])
def test_a_name_that_cannot_be_stored_is_refused_or_stored(bench, folder, name):
    """Either is fine; a traceback after all the sampling is not."""
    few(bench, folder, FEW.replace('file = "small.csv"', f'file = "small.csv"\nname = "{name}"'))
    ended = bench.run("fit", "few.toml", "-o", "run", "--json")
    assert "Traceback" not in ended.err
    if ended.code == 2:
        assert not (bench.folder / "run").exists()
        return
    assert ended.code == 3, ended
    data = xr.load_datatree(bench.folder / "run" / "posterior.nc")
    assert list(data["observed_data"].data_vars) == [name]


# -- the demo


def totals_of_table_3():
    """What the motor of the paper's knee feels: eqs. (11) and (13) at Table 3."""
    expected = {}
    for side, alpha in ALPHA.items():
        total = f"total_{side}"
        expected[f"{total}.inertia"] = 3.56e-4 + 0.206 / (alpha * 50**2)
        expected[f"{total}.viscous"] = 4.0e-3 + 3.12 / (alpha * 50**2)
        expected[f"{total}.coulomb_positive"] = 0.087 + 5.03 / (alpha * 50)
        expected[f"{total}.coulomb_negative"] = 0.091 + 5.15 / (alpha * 50)
        expected[f"{total}.gravity"] = 0.42 * 9.80665 / (alpha * 50)
    one, two = (1 / alpha for alpha in ALPHA.values())
    expected["gearbox.lambda_ratio"] = (one + two) / (one - two)
    return expected


@pytest.mark.slow
def test_the_demo_finds_the_truth(bench):
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


def estimated(bench, folder, *options):
    few(bench, folder)
    run = f"run {len(list(bench.folder.iterdir()))}"
    told = bench.told("fit", "few.toml", "-o", run, *options, codes=(3,))
    return told, draws(bench.folder / run)


@pytest.mark.usefixtures("no_figures", "unexplained")
def test_fit_simulates_for_an_estimate_only_when_asked_and_the_posterior_is_the_same(bench, folder):
    (plain, first), (summary, found) = (
        estimated(bench, folder),
        estimated(bench, folder, "--output-error"),
    )
    assert set(plain["estimates"]) == {"least-squares", "input-error"}
    assert set(summary["estimates"]) == {"least-squares", "input-error", "output-error"}
    assert summary["estimates"]["output-error"]["converged"]
    for name, values in first.items():
        np.testing.assert_array_equal(found[name], values, err_msg=name)
