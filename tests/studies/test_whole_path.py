"""The whole path from a file of counts: what its committed result claims, and a few files again."""

import numpy as np
import pytest
from scipy import stats

from .bench import committed, scripts


@pytest.fixture(scope="module")
def result():
    return committed("calibration/whole_path.json")


study = scripts("whole_path", folders=["calibration"])


@pytest.mark.parametrize(
    "case",
    ["plain", "geared", "plain, 100 Hz", "sticking", "knee", "knee, loaded pair",
     "late by 0.3 samples", "late by 2 samples", "current", "plain, 1 kHz",
     "geared, encoder at the joint", "ripple, 100 a turn"],
)  # fmt: skip
def test_intervals_of_a_case_hold_the_truth_as_often_as_the_readme_says(result, case):
    found = result[case]
    assert found["recordings"] >= 200
    rows = dict(found["verdicts"]["data"])
    whole = rows.pop("all")
    assert 0.85 < whole["coverage"] < 0.95
    # nor does one quantity fall out beyond what chance does among so many
    for name, row in rows.items():
        n, k = row["intervals"], len(rows)
        low = stats.binom.ppf(0.005 / k, n, 0.85) / n
        assert row["coverage"] >= low, name
        assert abs(row["z"]) < 0.4 + 4.0 * row["z_sd"] / np.sqrt(n), name


def test_what_a_ripple_once_a_turn_spoils_is_never_called_data(result):
    found = result["ripple, once a turn"]
    assert found["reliable"] == 0
    assert "load.first_moment" not in found["verdicts"]["data"]
    assert found["verdicts"]["data"]["all"]["coverage"] > 0.8


@pytest.mark.parametrize("case", ["geared, central differences", "geared, as 0.1.0"])
def test_self_checks_foretell_what_filters_do_and_correct_it(result, case):
    row = result[case]["verdicts"]["data"]["motor.inertia"]
    told = row["foretold"]
    error = row["z_sd"] / np.sqrt(row["intervals"])
    assert row["z"] > 0.9
    assert abs(row["z"] - told["z"]) < 3.0 * error
    assert told["corrected_coverage"] > 0.85 > row["coverage"]


@pytest.mark.slow
@pytest.mark.parametrize("case", ["geared", "knee"])
def test_a_few_files_again(study, case):
    found = study.judged([study.one((case, number)) for number in range(1000, 1008)])
    assert found["refused"] == []
    assert found["reliable"] >= 7
    rows = dict(found["verdicts"]["data"])
    rows.pop("all")
    # five sds of one number of some sixty; today's worst is 2.9
    assert max(row["z_largest"] for row in rows.values()) < 5.0
    # with all quantities of a recording erring together, eight are as few as eight intervals
    holding = np.mean([row["coverage"] for row in rows.values()])
    assert holding >= stats.binom.ppf(1e-3, 8, 0.9) / 8
