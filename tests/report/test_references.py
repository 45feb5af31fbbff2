"""References far from what was found: named at once."""

import copy

import pytest

from bayesfric.report.summary.doubts import references_off
from bayesfric.report.summary.record import Summary

from .made_summaries import loaded

INERTIA = "motor.inertia"


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
    near = told(**{INERTIA: lambda row: row.middle - 2.9 * row.reported.sd})
    assert not references_off(Summary.read(near))
    far = told(**{INERTIA: lambda row: row.middle - 3.2 * row.reported.sd})
    assert references_off(Summary.read(far)) == pytest.approx({INERTIA: 3.2})
    # a reference that is not known that well itself contradicts nothing
    sd = Summary.read(far).rows[INERTIA].reported.sd
    far["references"][INERTIA]["sd"] = sd
    assert not references_off(Summary.read(far))
    del far["references"][INERTIA]["sd"]
    far["parameters"][INERTIA]["verdict"] = "prior"
    assert not references_off(Summary.read(far))
