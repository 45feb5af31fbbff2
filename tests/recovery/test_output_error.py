"""The posterior by simulation: the truth, both noises, and figures a user gets."""

import numpy as np
import pytest
import xarray as xr

from bayesfric.base.errors import BadInput
from bayesfric.commands.fit import fit
from bayesfric.problem.config import read_config
from tests.commands.bench import SMALL, simulated, simulation

pytestmark = pytest.mark.usefixtures("nothing_explained")

CONFIG = f"""{SMALL}
[likelihood]
method = "output-error"

[sampling]
min_ess = 800
walkers = 16
seed = 4
{simulation(rate=250, amplitude=3.0, encoder_counts=65536, torque_noise=0.02)}"""
TRUTH = {"motor.inertia": 0.01, "motor.viscous": 0.05, "motor.coulomb": 0.2, "offset": 0.02}


def test_the_truth_and_both_noises_are_recovered(tmp_path):
    simulated(tmp_path / "axis.toml", CONFIG)
    summary = fit(read_config(tmp_path / "axis.toml"), tmp_path / "run")
    assert summary["sampler"]["status"] == "reliable"
    rows = summary["parameters"]
    count = 2.0 * np.pi / 65536
    truth = TRUTH | {"noise.torque": 0.02, "noise.position": count / np.sqrt(12.0)}
    for name, value in truth.items():
        assert abs(rows[name]["mean"] - value) < 4.0 * rows[name]["sd"], name
        assert rows[name]["verdict"] == "data", name
    assert (rows["noise.torque"]["unit"], rows["noise.position"]["unit"]) == ("N m", "rad")
    # an axis that hardly sticks can be linearised
    assert summary["likelihood"]["linearisation"] < 0.5
    assert not any("linearised" in text for text in summary["warnings"])
    # the archive holds positions
    data = xr.load_datatree(tmp_path / "run" / "posterior.nc")
    (name,) = data["observed_data"].data_vars
    outputs = data["observed_data"][name].size
    assert data["posterior_predictive"][name].shape[-1] == outputs
    (terms,) = data["log_likelihood"].data_vars
    # two states in each of six segments of 0.5 s
    assert data["log_likelihood"][terms].shape[-1] == outputs - 12


def test_an_axis_that_often_sticks_is_refused_before_sampling(tmp_path):
    """No linearisation describes an axis between sticking and moving."""
    simulated(tmp_path / "axis.toml", CONFIG.replace("amplitude = 3.0", "amplitude = 1.0"))
    config = read_config(tmp_path / "axis.toml")
    phases = []
    with pytest.raises(BadInput, match="cannot be linearised") as caught:
        fit(config, tmp_path / "run", progress=lambda p: phases.append(p.phase))
    assert caught.value.where == f'{config.path}: likelihood.method = "output-error"'
    assert "input-error" in caught.value.hint
    assert "warm-up" not in phases
    assert not (tmp_path / "run").exists()
