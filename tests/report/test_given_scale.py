"""A number that is data times somebody's summary weight is neither open nor the prior's own."""

import copy
from types import SimpleNamespace

from bayesfric.export.point_estimate import open_scalings
from bayesfric.mechanism.joint import PRESETS
from bayesfric.report.numbers import TEXT
from bayesfric.report.result_row import result_rows
from bayesfric.report.summary.record import Summary

from .made_summaries import loaded, posterior_row

NAMES = ("motor.inertia", "load.first_moment", "drive.gain")


def weighed(**changes):
    """A gain that nobody knows, and a load of which one summary the weight within 7 %."""
    summary = copy.deepcopy(loaded())
    summary["derived"] = {}
    given = {"prior_default": True, "verdict": "weak", "given_by": ["load.first_moment"]}
    summary["parameters"] = {
        "motor.inertia": posterior_row("kg m²", 0.14, 0.01, **given | {"prior_sd": 0.042}),
        "load.first_moment": posterior_row(
            "kg m", 0.27, 0.0195, verdict="prior", prior_sd=0.02, prior_default=False
        ),
        "drive.gain": posterior_row("", 0.77, 0.056, **given | {"prior_sd": 0.6}),
    }
    for name, row in changes.items():
        summary["parameters"][name.replace("__", ".")] |= row
    way = {"parameters": dict.fromkeys(NAMES, 1.0), "meaning": "one factor"}
    summary["identifiability"] = {"null_directions": [way]}
    return Summary.read(summary)


def test_at_its_bound_a_number_of_a_told_scale_is_a_limit_and_no_interval():
    at_zero = {"at_bound": "lower", "bound": 0.0, "bound_physical": True, "interval": [0.0, 0.02]}
    read = weighed(motor__inertia=at_zero)
    assert weighed().rows["motor.inertia"].reported.status == "prior"
    row = result_rows(read)["motor.inertia"]
    assert (row.status, row.limit) == ("limit", 0.02)
    assert row.texts(TEXT) == ("≤ 0.02", "–")


def test_a_told_scale_is_not_evened_out_in_an_export():
    """A weight that was summary stays; where none is, the losses of both ways are made one."""
    chain = PRESETS["rabbit-knee"].chain()
    names = ("load.inertia", "load.first_moment", "gearbox.load_drive", "gearbox.load_back")
    summary = copy.deepcopy(loaded())
    summary["parameters"] = {
        name: posterior_row("", 0.2, 0.02, verdict="prior", prior_sd=0.5, prior_default=True)
        for name in names
    }
    way = [n.replace("load_", "alpha_") for n in names]
    summary["identifiability"] = {
        "null_directions": [{"parameters": dict.fromkeys(way, 1.0), "meaning": "one factor"}]
    }
    for known in (False, True):
        given = {"verdict": "weak", "given_by": ["load.inertia"]} if known else {}
        summary["parameters"]["load.first_moment"] |= given
        read = Summary.read(summary)
        assert len(open_scalings(SimpleNamespace(joint=chain, summary=read))) == (not known)
