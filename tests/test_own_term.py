"""A user's term is fitted and reported like any other, from arrays to the page."""

import json

import numpy as np
import pandas as pd
import pytest

import bayesfric as bf
from bayesfric.base.errors import BadInput
from tests.axis import recording_of

pytestmark = pytest.mark.usefixtures("nothing_explained")

COGGING = bf.Term(
    "motor.cogging",
    lambda m: np.sin(6.0 * m.position),
    unit="N m",
    symbol="k_6",
    meaning="cogging six times a turn",
)
JOINT = bf.Joint(
    [bf.Element("motor", inertia=True, coulomb="symmetric", viscous=True, subscript="m")],
    offset=True,
)
TRUE = {
    "motor.inertia": 0.01,
    "motor.viscous": 0.05,
    "motor.coulomb": 0.2,
    "motor.cogging": 0.15,
    "offset": 0.02,
}


SIMULATION = {
    "duration": 10, "rate": 500, "excitation": "multisine", "amplitude": 1.5,
    "torque_noise": 0.02, "encoder_counts": 0,
}  # fmt: skip


@pytest.fixture(scope="module")
def recording():
    table = bf.simulate(JOINT.with_term(COGGING), TRUE, **SIMULATION, seed=3)
    return recording_of(table, name="bench")


@pytest.fixture(scope="module")
def model(recording):
    return bf.Model(JOINT.with_term(COGGING), recording)


@pytest.fixture(scope="module")
def run(model, tmp_path_factory):
    posterior = model.sample(seed=1)
    folder = tmp_path_factory.mktemp("own") / "run"
    bf.report(posterior, folder, paper=True)
    return posterior, folder


@pytest.mark.parametrize("method", ["least-squares", "input-error", "output-error"])
def test_every_method_estimates_it(model, method):
    row = model.estimate(method).loc["motor.cogging"]
    assert row["unit"] == "N m"
    # five sds of what is estimated from 5000 samples, by the sd that accounts for correlation
    assert abs(row["value"] - 0.15) < 5.0 * row["sd_robust"]
    assert row["sd_robust"] < 0.01


def test_the_posterior_holds_it(run):
    posterior, _ = run
    row = bf.summary(posterior).parameters["motor.cogging"]
    low, high = row.interval
    # an interval of 90 % would miss now and then; twice as wide it does not
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    assert abs(middle - TRUE["motor.cogging"]) < 2.0 * half
    assert half < 0.01
    assert (row.verdict, row.unit) == ("data", "N m")
    assert posterior.posterior["motor.cogging"].attrs["units"] == "N m"


def test_without_it_the_residuals_are_larger(recording, model):
    bare = bf.Model(JOINT, recording)
    rms = [m.estimates(["input-error"])[0].residual_rms for m in (bare, model)]
    assert rms[0] > 3.0 * rms[1]


def test_tables_and_page_contain_it(run):
    _, folder = run
    parameters = json.loads((folder / "summary.json").read_text())["parameters"]
    assert parameters["motor.cogging"]["symbol"] == "k_6"
    assert "motor.cogging" in set(pd.read_csv(folder / "summary.csv")["name"])
    assert "motor.cogging" in (folder / "report.html").read_text(encoding="utf-8")
    assert "k_6" in (folder / "tables" / "parameters.tex").read_text(encoding="utf-8")
    assert any((folder / "figures").glob("friction.*"))


def test_a_run_is_read_again_only_with_its_term(run, model):
    posterior, folder = run
    with pytest.raises(BadInput, match=r"motor\.cogging"):
        bf.Model.from_config(folder / "config.toml")
    again = bf.Model.from_config(folder / "config.toml", terms=[COGGING])
    assert again.chain.names == model.chain.names
    draws = again.sample(seed=1).posterior["motor.cogging"].to_numpy()
    np.testing.assert_array_equal(draws, posterior.posterior["motor.cogging"].to_numpy())


def test_a_term_of_time_at_the_load():
    drift = bf.Term("load.drift", lambda m: np.exp(-0.3 * m.time), unit="N m")
    true = {name: value for name, value in TRUE.items() if name != "motor.cogging"}
    table = bf.simulate(JOINT.with_term(drift), true | {"load.drift": 0.3}, **SIMULATION, seed=4)
    model = bf.Model(JOINT.with_term(drift), recording_of(table))
    row = model.estimate("input-error").loc["load.drift"]
    assert abs(row["value"] - 0.3) < 5.0 * row["sd_robust"]


def test_an_element_that_does_not_exist():
    with pytest.raises(ValueError, match="did you mean 'motor'"):
        JOINT.with_term(bf.Term("moter.cogging", lambda m: np.sin(m.position)))
