"""Predictions of what was held out of real recordings, through the studies' own configurations."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bayesfric.fit.model import Model
from bayesfric.inference.posterior import predict_held_out
from bayesfric.problem.config import read_config
from bayesfric.report.summary.parts import validation_record
from tests.conftest import DATA, REPOSITORY

from .bench import committed
from .test_real_recordings import run

pytestmark = pytest.mark.usefixtures("real_data")


def predicted(name):
    problem, result = run(name)
    found = predict_held_out(result.target, result.posterior, problem.held_out)
    return problem, result, validation_record(replace(result, held_out=found))


def test_the_gain_that_is_held_out():
    """The files themselves tell which runs have position gain 400."""
    problem = Model.from_config(read_config(REPOSITORY / "studies/xl330/xl330-held-out.toml"))
    gains = {
        path.stem: json.loads(path.read_text())["kp"]
        for path in (DATA / "xl330-pendulum").glob("*.json")
    }
    assert {one.name for one in problem.held_out} == {n for n, kp in gains.items() if kp == 400}
    assert len(problem.recordings) == 12


@pytest.mark.slow
def test_xl330_predicts_the_runs_of_another_gain_as_it_did():
    """With a quarter of the draws, as the committed result says."""
    problem, result, record = predicted("xl330/xl330-held-out.toml")
    pooled = record["pooled"]
    before = committed("xl330/held_out.json")["white, one scale"]["400"]
    assert pooled["outputs"] == before["outputs"]
    assert pooled["verdict"] == before["verdict"]
    # Torque of 400 draws scatters by less than the noise, so means are off by a twentieth of that
    # at most; about two sds of it pass each end of the interval where the density is 0.103.
    for key in ("residual_rms", "predictive_sd"):
        assert pooled[key] == pytest.approx(before[key], rel=0.05), key
    share, old = (one["coverage"]["0.9"]["share"] for one in (pooled, before))
    assert share == pytest.approx(old, abs=2.0 * 2.0 * 0.103 / 20.0)
    # once more by hand: the mean draw's torque, and plain quantiles of the noise
    sigma = result.posterior["noise.sigma"].mean()
    inside = np.concatenate(
        [
            np.abs(p.measured - p.mean) < 1.6449 * sigma
            for p in predict_held_out(result.target, result.posterior, problem.held_out)
        ]
    )
    assert inside.mean() == pytest.approx(share, abs=0.01)


@pytest.mark.slow
def test_emps_predicts_its_last_fifth():
    problem, _, record = predicted("emps/emps-held-out.toml")
    (held,) = problem.held_out
    whole = problem.recordings[0].time.size + held.recording.time.size
    # a gap of a window of 81 samples and ten outputs of ten
    assert whole == 24841 - 181
    pooled = record["pooled"]
    assert pooled["verdict"] == "covered"
    # forces remember: as many independent ones are far fewer
    cover = pooled["coverage"]["0.9"]
    assert cover["effective_outputs"] < 0.6 * pooled["outputs"]
