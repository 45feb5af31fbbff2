"""The whole path from a file of counts: what its committed result claims, and a few files again."""

import numpy as np
import pytest
from scipy import stats

from .bench import results, scripts

result = results("calibration/whole_path.json")
study = scripts("whole_path", folders=["calibration"])


RIGHT = (
    "plain", "slow", "geared", "plain, 100 Hz", "plain, 1 kHz", "geared, encoder at the joint",
    "sticking", "current", "knee",
)  # fmt: skip


@pytest.mark.parametrize("case", RIGHT)
def test_printed_intervals_hold_the_truth_as_often_as_they_say(result, case):
    found = result[case]
    rows = dict(found["statuses"]["identified"])
    whole = rows.pop("all")
    # quantities of one recording err together; so far off chance is once in four thousand cases
    assert 0.9 - 3.5 * whole["error"] < whole["coverage"] < 0.98
    # nor does one quantity fall out beyond what chance does among so many
    for name, row in rows.items():
        n, k = row["intervals"], len(rows)
        assert row["coverage"] >= stats.binom.ppf(0.005 / k, n, 0.85) / n, name
    # where the model is right there is no room for its error
    assert whole["wider"][0] < 1.15
    assert whole["wider"][1] < 1.4


def test_few_right_models_have_a_finding(result):
    asked = sum(result[case]["recordings"] for case in RIGHT)
    found = sum(result[case]["findings"] for case in RIGHT)
    assert found <= stats.binom.ppf(0.99, asked, 0.05)


def test_calibration_checks_predict_what_filters_do_and_doubt_it(result):
    found = result["geared, central differences"]
    row = found["statuses"]["doubtful"]["motor.inertia"]
    assert row["intervals"] == found["recordings"]
    assert row["coverage"] < 0.8
    assert abs(row["posterior_z"] - row["foretold"]) < 3.0 / np.sqrt(row["intervals"])


@pytest.mark.slow
@pytest.mark.parametrize("case", ["geared", "knee"])
def test_a_few_files_again(study, case):
    found = study.judged([study.one((study.SEED, case, number)) for number in range(1000, 1008)])
    assert found["refused"] == []
    assert found["reliable"] >= 7
    rows = dict(found["statuses"]["identified"])
    rows.pop("all")
    # five sds of one number of some sixty; today's worst is 2.9
    assert max(row["z_largest"] for row in rows.values()) < 5.0
    # with all quantities of a recording erring together, eight are as few as eight intervals
    holding = np.mean([row["coverage"] for row in rows.values()])
    assert holding >= stats.binom.ppf(1e-3, 8, 0.9) / 8
