"""References far from what was found: named at once, with the factor they are off by."""

import copy

import numpy as np
import pytest

from bayesfric.report.alerts import alerts_of
from bayesfric.report.summary.doubts import references_off
from bayesfric.report.summary.record import Summary

from .made_summaries import loaded

INERTIA, VISCOUS, LOAD = "motor.inertia", "motor.viscous", "gearbox.load_drive"


def told(**values):
    """Give references in units of what was found, or as many of its sds from it."""
    made = copy.deepcopy(loaded())
    rows = made["parameters"]
    made["references"] = {
        name: {"value": call(Summary.read(made).rows[name]), "unit": rows[name]["unit"]}
        for name, call in values.items()
    }
    return made


def alert(made):
    (found,) = (one for one in alerts_of(made) if one.kind == "references")
    return found


def test_only_what_is_beyond_three_sds_is_told():
    near = told(**{INERTIA: lambda row: row.middle - 2.9 * row.told.sd})
    assert references_off(Summary.read(near)) is None
    far = told(**{INERTIA: lambda row: row.middle - 3.2 * row.told.sd})
    assert references_off(Summary.read(far))["off"] == pytest.approx({INERTIA: 3.2})
    # a reference that is not known that well itself contradicts nothing
    sd = Summary.read(far).rows[INERTIA].told.sd
    far["references"][INERTIA]["sd"] = sd
    assert references_off(Summary.read(far)) is None
    del far["references"][INERTIA]["sd"]
    far["parameters"][INERTIA]["verdict"] = "prior"
    assert references_off(Summary.read(far)) is None


def test_one_factor_of_all_is_the_torques():
    alike = told(**dict.fromkeys((INERTIA, VISCOUS), lambda row: row.middle / 2.5))
    assert alert(alike).first
    assert INERTIA in alert(alike).text
    assert "the torque told 2.5 times" in alert(alike).text
    apart = told(**{INERTIA: lambda row: row.middle / 2.5, VISCOUS: lambda row: row.middle})
    assert "torque told" not in alert(apart).text
    assert VISCOUS not in alert(apart).text


def test_not_every_reference_tells_a_factor_of_the_torque():
    made = told(**{INERTIA: lambda row: row.middle / 2.5})
    assert references_off(Summary.read(made))["factor"] == pytest.approx(2.5)
    # a loss per torque says nothing of its scale
    lossy = told(**{LOAD: lambda row: row.middle / 2.5})
    assert references_off(Summary.read(lossy))["factor"] is None
    # a gain that is fitted is that factor already
    made["parameters"]["drive.gain"] = copy.deepcopy(made["parameters"][LOAD])
    assert references_off(Summary.read(made))["factor"] is None


def with_prior(data, data_sd, prior, prior_sd):
    """Give a run whose inertia has a told normal prior: two normals, multiplied."""
    made = copy.deepcopy(loaded())
    made["references"] = {}
    row = made["parameters"][INERTIA]
    weights = data_sd**-2 + prior_sd**-2
    middle = (data * data_sd**-2 + prior * prior_sd**-2) / weights
    row |= {"mean": middle, "median": middle, "sd": weights**-0.5, "prior_sd": prior_sd}
    row |= {"prior_interval": [prior - 1.645 * prior_sd, prior + 1.645 * prior_sd]}
    row |= {"prior_default": False, "verdict": "data", "prior": "norm"}
    return made


def test_a_prior_that_the_data_contradict_is_told_like_a_reference():
    made = with_prior(0.37, 0.004, 0.304, 0.01)
    (one,) = references_off(Summary.read(made))["compared"]
    assert one["by"] == "prior"
    assert one["factor"] == pytest.approx(0.37 / 0.304)
    assert one["times"] == pytest.approx((0.37 - 0.304) / np.hypot(0.004, 0.01))
    assert "the torque told 1.22 times" in alert(made).text
    # near, known by default only, or hardly known
    assert references_off(Summary.read(with_prior(0.33, 0.004, 0.304, 0.01))) is None
    made["parameters"][INERTIA]["prior_default"] = True
    assert references_off(Summary.read(made)) is None
    assert references_off(Summary.read(with_prior(1.0, 0.004, 0.304, 0.1))) is None
