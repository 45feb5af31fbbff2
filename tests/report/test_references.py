"""References far from what was found: named at once, with the factor they are off by."""

import copy

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


def test_only_what_is_beyond_four_sds_is_told():
    near = told(**{INERTIA: lambda row: row.middle - 3.9 * row.told_sd})
    assert references_off(Summary.read(near)) is None
    far = told(**{INERTIA: lambda row: row.middle - 4.2 * row.told_sd})
    (one,) = references_off(Summary.read(far))["off"]
    assert abs(one["times"] - 4.2) < 1e-9
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
    assert "the torque may be told 2.5 times too large" in alert.text
    apart = told(**{INERTIA: lambda row: row.middle / 2.5, VISCOUS: lambda row: row.middle})
    (alert,) = (one for one in alerts_of(apart) if one.kind == "references")
    assert "the torque may" not in alert.text
    assert VISCOUS not in alert.text


def test_a_loss_per_torque_says_nothing_of_its_scale():
    made = told(**{LOAD: lambda row: row.middle / 2.5})
    found = references_off(Summary.read(made))
    assert found["factor"] is None
