"""Findings: what the committed results claim, and a few recordings again."""

import pytest
from scipy import stats

from bayesfric.diagnostics.statistics import FALSE_ALARMS

from .bench import committed, results, scripts

# No candidate describes what these lack.
UNLISTED = (
    "a spring that stiffens", "viscous by angle", "a wandering offset", "damping that saturates",
)  # fmt: skip

result = results("diagnostics/findings.json")
findings = scripts("findings", folders=["diagnostics", "calibration"])
random_joints = scripts("random_joints", folders=["diagnostics"])


def rows_of(result, *, right):
    """Rows of right models, or of those that lack what a candidate describes."""
    listed = [rows for case, rows in result.items() if not case.endswith(UNLISTED)]
    rows = [row for rows in listed for row in rows if row["reason"] is None]
    return [row for row in rows if right == (not row["right"])]


def test_right_models_are_called_wrong_as_seldom_as_is_promised(result):
    rows = rows_of(result, right=True)
    alarms = sum(bool(row["steps"]) for row in rows)
    # no more than chance makes of that share in 999 of 1000 studies
    assert alarms <= stats.binom.ppf(0.999, len(rows), FALSE_ALARMS)
    assert len(rows) >= 100


def test_a_missing_effect_is_found_and_named(result):
    rows = rows_of(result, right=False)
    detected = [row for row in rows if row["steps"]]
    assert len(detected) >= 0.8 * len(rows)
    firsts = [row["steps"][0] for row in detected]
    named = sum(
        bool({first["kind"], *first["rivals"]} & set(row["right"]))
        for first, row in zip(firsts, detected, strict=True)
    )
    assert named >= 0.9 * len(detected)


@pytest.mark.slow
def test_a_few_recordings(findings):
    assert not [s for n in range(500, 503) for s in findings.run_case(("plain", n))["steps"][1:]]
    steps = findings.run_case(("torque constant sags by 0.05", 500))["steps"]
    assert steps[0]["kind"] == "saturation"


def test_terms_of_random_joints_are_included_if_they_are_missing():
    result = committed("diagnostics/random_joints.json")["judged"]
    n, k = result["nothing_missing"], result["false_finds"]
    assert n >= 50
    # the upper end of a 95 % interval (Clopper and Pearson)
    assert stats.beta.ppf(0.95, k + 1, n - k) < 0.1
    named = result["found"] + result["by_another_choice"] + result["named_beside_another"]
    assert named > 0.75 * result["terms"]
    assert result["not_there"] < 0.1 * result["put_in"]


@pytest.mark.slow
def test_a_few_random_joints(random_joints):
    result = random_joints.judged([random_joints.run_case(n) for n in range(5000, 5012)])
    # one of twenty at most: three of six have a chance of 0.2 %
    assert result["false_finds"] <= 2
    assert result["found"] > 0.6 * result["terms"]
