"""References far from what was found: named at once, with the factor they are off by."""

import copy

import numpy as np
import pytest

from bayesfric.report.alerts import alerts_of
from bayesfric.report.summary.record import Summary
from bayesfric.report.summary.reference_check import references_off

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


def test_only_what_is_beyond_three_sds_is_told():
    near = told(**{INERTIA: lambda row: row.middle - 2.9 * row.told_sd})
    assert references_off(Summary.read(near)) is None
    far = told(**{INERTIA: lambda row: row.middle - 3.2 * row.told_sd})
    (one,) = references_off(Summary.read(far))["off"]
    assert abs(one["times"] - 3.2) < 1e-9
    # a reference that is not known that well itself contradicts nothing
    sd = Summary.read(far).rows[INERTIA].told_sd
    far["references"][INERTIA]["sd"] = sd
    assert references_off(Summary.read(far)) is None
    del far["references"][INERTIA]["sd"]
    far["parameters"][INERTIA]["verdict"] = "prior"
    assert references_off(Summary.read(far)) is None


def test_one_factor_of_all_is_the_torques():
    alike = told(**dict.fromkeys((INERTIA, VISCOUS), lambda row: row.middle / 2.5))
    (alert,) = (one for one in alerts_of(alike) if one.kind == "references")
    assert alert.first
    assert f"{INERTIA} is" in alert.text
    assert "the torque may be told 2.5 times as large as it is" in alert.text
    apart = told(**{INERTIA: lambda row: row.middle / 2.5, VISCOUS: lambda row: row.middle})
    (alert,) = (one for one in alerts_of(apart) if one.kind == "references")
    assert "the torque may" not in alert.text
    assert VISCOUS not in alert.text


def test_one_loss_for_both_ways_looks_like_such_a_factor():
    """Measured, XL330: 0.79 of a weighed load; two losses fit as well, and with its weight."""
    made = told(**{INERTIA: lambda row: row.middle / 2.5})
    assert "load_loss" not in references_text(made)
    made["parameters"]["gearbox.load"] = made["parameters"].pop(LOAD)
    assert 'load_loss = "two" in [mechanism.elements.gearbox]' in references_text(made)


def test_a_law_without_load_losses_is_what_a_loss_may_be_of():
    """Measured, UR10e: 13.3 N m published without load losses, 11.4 beside them."""
    made = told(**{VISCOUS: lambda row: row.middle / 2.5, INERTIA: lambda row: row.middle / 2.5})
    assert f"a law without load losses, which counts them as {VISCOUS}" in references_text(made)
    # with no factor common to all, as where one is off the other way, it is one all the more
    apart = told(**{VISCOUS: lambda row: row.middle / 2.5, INERTIA: lambda row: row.middle * 2.5})
    assert "the torque may" not in references_text(apart)
    assert f"a law without load losses, which counts them as {VISCOUS}" in references_text(apart)
    del made["parameters"][LOAD]
    assert "a law without" not in references_text(made)


def test_a_loss_per_torque_says_nothing_of_its_scale():
    made = told(**{LOAD: lambda row: row.middle / 2.5})
    found = references_off(Summary.read(made))
    assert found["factor"] is None


def test_a_factor_of_all_says_how_to_have_it_fitted():
    made = told(**{INERTIA: lambda row: row.middle / 2.5})
    value = made["references"][INERTIA]["value"]
    (alert,) = (one for one in alerts_of(made) if one.kind == "references")
    assert "gain = true under [mechanism]" in alert.text
    assert (
        f'"{INERTIA}" = {{ distribution = "norm", loc = {value:.4g}, scale = its sd' in alert.text
    )
    made["references"][INERTIA]["sd"] = 0.01 * value
    assert f"scale = {0.01 * value:.2g} }}" in references_text(made)
    # what is fitted already is not advised, nor what cannot be a prior, nor without a factor
    fitted = copy.deepcopy(made)
    fitted["parameters"]["drive.gain"] = copy.deepcopy(fitted["parameters"][LOAD])
    assert "gain = true" not in references_text(fitted)
    apart = told(**{INERTIA: lambda row: row.middle / 2.5, VISCOUS: lambda row: row.middle})
    assert "gain = true" not in references_text(apart)


def references_text(made):
    (alert,) = (one for one in alerts_of(made) if one.kind == "references")
    return alert.text


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
    found = references_off(Summary.read(made))
    (one,) = found["off"]
    assert one["by"] == "prior"
    assert one["found"] == pytest.approx(0.37)
    assert one["factor"] == pytest.approx(0.37 / 0.304)
    assert one["times"] == pytest.approx((0.37 - 0.304) / np.hypot(0.004, 0.01))
    text = references_text(made)
    assert "by the data alone where the prior says 0.304" in text
    assert "the torque may be told 1.22 times as large as it is" in text
    assert "gain = true under [mechanism], and leave its prior" in text
    # near, known by default only, or hardly known
    assert references_off(Summary.read(with_prior(0.33, 0.004, 0.304, 0.01))) is None
    made["parameters"][INERTIA]["prior_default"] = True
    assert references_off(Summary.read(made)) is None
    assert references_off(Summary.read(with_prior(1.0, 0.004, 0.304, 0.1))) is None
