"""What a fit says of itself: the bias of central differences is found, and doubted."""

import json

import pytest
from numba import get_num_threads, set_num_threads
from scipy.stats import norm

from bayesfric.diagnostics.policy import REPLICATES
from tests.diagnostics.bench import CENTRAL, TRUTH, model


@pytest.fixture(scope="module")
def exact():
    return model().fit(seed=1)


@pytest.fixture(scope="module")
def central():
    return model(processing=CENTRAL).fit(seed=1)


def test_the_bias_of_central_differences_is_found_and_doubted(central):
    row = central.summary.parameters["motor.inertia"]
    check = central.summary.self_check["rows"]["motor.inertia"]
    off = (row.mean - TRUTH["motor.inertia"]) / row.sd
    assert off > 1.5  # the gain of central differences is too small, so the inertia too large
    assert check["bias"] == pytest.approx(off, abs=1.5)
    assert check["bias"] > 10.0 * check["bias_error"]
    assert check["coverage"] < 0.75
    (doubt,) = (doubt for doubt in central.summary.doubts if doubt.kind == "self-check")
    assert "motor.inertia" in doubt.parameters
    assert row.reported.status == "doubtful"


def test_exact_derivatives_have_next_to_no_bias(exact):
    """What is left, the low-pass does at reversals: 0.02 % of the viscous loss."""
    check = exact.summary.self_check
    assert check["made"] == check["asked"] == REPLICATES
    assert check["unexplained"] < 0.2
    for name, row in check["rows"].items():
        assert abs(row["bias"]) < 0.5, name
        summary_row = exact.summary.rows[name]
        reach = norm.ppf(0.95) * summary_row.reported.sd / summary_row.sd
        assert row["coverage"] == pytest.approx(2.0 * norm.cdf(reach) - 1.0, abs=0.03), name


def test_the_same_seed_gives_the_same_numbers_whatever_the_threads(exact):
    before = get_num_threads()
    set_num_threads(1)
    try:
        again = model().fit(seed=1)
    finally:
        set_num_threads(before)
    told = [
        json.dumps(one.summary.self_check | {"seconds": 0, "cpu_seconds": 0})
        for one in (exact, again)
    ]
    assert told[0] == told[1]
