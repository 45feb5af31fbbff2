"""References far from what was found: named at once; and told priors."""

import copy

import numpy as np
import pytest

from bayesfric.report.summary.doubts import _against_prior, references_off
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
    near = told(**{INERTIA: lambda row: row.middle - 2.9 * row.told.sd})
    assert not references_off(Summary.read(near))
    far = told(**{INERTIA: lambda row: row.middle - 3.2 * row.told.sd})
    assert references_off(Summary.read(far)) == pytest.approx({INERTIA: 3.2})
    # a reference that is not known that well itself contradicts nothing
    sd = Summary.read(far).rows[INERTIA].told.sd
    far["references"][INERTIA]["sd"] = sd
    assert not references_off(Summary.read(far))
    del far["references"][INERTIA]["sd"]
    far["parameters"][INERTIA]["verdict"] = "prior"
    assert not references_off(Summary.read(far))


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


def times(made):
    """Sds between told priors and what the data say without them, of those too far apart."""
    return next(_against_prior(Summary.read(made)), {"priors": {}})["priors"]


def test_a_prior_that_the_data_contradict_is_told_like_a_reference():
    made = with_prior(0.37, 0.004, 0.304, 0.01)
    assert times(made) == pytest.approx({INERTIA: (0.37 - 0.304) / np.hypot(0.004, 0.01)})
    # near, known by default only, or hardly known
    assert not times(with_prior(0.33, 0.004, 0.304, 0.01))
    made["parameters"][INERTIA]["prior_default"] = True
    assert not times(made)
    assert not times(with_prior(1.0, 0.004, 0.304, 0.1))
