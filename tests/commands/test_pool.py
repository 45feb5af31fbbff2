"""`pool` on the command line, on SIMULATED recordings whose viscous loss differs."""

import json
import os

import pytest

import bayesfric as bf

from .bench import JOINT, recorded
from .test_explain import SIMULATION

pytestmark = pytest.mark.usefixtures("nothing_explained")

VISCOUS = (0.2, 0.26, 0.22)
ASKED = '[pooling]\nvary = { "motor.viscous" = "recording" }\n'
QUICK = '[noise]\nmodel = "white"\n[sampling]\nmin_ess = 100\nensembles = 2\nwalkers = 48\n'


def days(bench):
    """Simulate a recording for each day, and name all in one configuration."""
    whole = SIMULATION.replace('"motor.viscous_positive" = 0.2\n', "").replace(
        "duration = 12", "duration = 5"
    )
    for k, viscous in enumerate(VISCOUS):
        told = whole.replace('"motor.viscous_negative" = 0.3', f'"motor.viscous" = {viscous}')
        bench.simulated(JOINT + told, f"day{k}", seed=k)
    tables = "".join(recorded(f"day{k}") for k in range(len(VISCOUS)))
    bench.config(JOINT + tables + QUICK + ASKED)


def test_it_prints_what_python_returns(bench):
    days(bench)
    found = bench.told("pool", "c.toml")
    pooled = bf.pool(bf.Model.from_config(bench.folder / "c.toml"))
    again = json.loads(json.dumps(pooled.as_json()))
    # nothing is kept silent that is known before
    assert again["warnings"] == list(bf.check(bench.folder / "c.toml").warnings)
    took = {"seconds": 0, "cpu_seconds": 0}
    assert found | took == again | took
    # the system counts in ticks
    assert 0.1 < again["cpu_seconds"] < again["seconds"] * os.cpu_count() + 0.05
    (viscous,) = found["varying"]
    assert viscous["jointly"]["spread"]["low"] > 0.0
    # of 3.3 sds, 100 independent draws leave a median uncertain by an eighth of one
    for true, run in zip(VISCOUS, viscous["jointly"]["runs"], strict=True):
        assert abs(run["median"] - true) < run["high"] - run["low"]


def test_fit_refuses_what_varies(bench):
    days(bench)
    told = bench.run("fit", "c.toml", "-o", "run")
    assert told.code == 2
    assert "bayesfric pool" in told.err
