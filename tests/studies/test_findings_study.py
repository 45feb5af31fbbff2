"""What the regression finds: what the committed result claims, and a few recordings again."""

import pytest
from scipy import stats

from bayesfric.diagnostics.statistics import FALSE_ALARMS

from .bench import results, scripts

result = results("diagnostics/findings.json")
study = scripts("findings", folders=["diagnostics", "calibration"])


def asked(rows):
    return [row for row in rows if row["reason"] is None]


def test_right_models_are_called_wrong_as_seldom_as_is_promised(result):
    rows = [row for rows in result.values() for row in asked(rows) if not row["right"]]
    alarms = sum(bool(row["steps"]) for row in rows)
    # no more than chance makes of that share in 999 of 1000 studies
    assert alarms <= stats.binom.ppf(0.999, len(rows), FALSE_ALARMS)
    assert len(rows) >= 100


def test_what_is_missing_is_found_and_named(result):
    rows = [row for rows in result.values() for row in asked(rows) if row["right"]]
    found = [row for row in rows if row["steps"]]
    assert len(found) >= 0.8 * len(rows)
    first = [{row["steps"][0]["kind"], *row["steps"][0]["rivals"]} for row in found]
    named = sum(bool(one & set(row["right"])) for one, row in zip(first, found, strict=True))
    assert named >= 0.9 * len(found)


@pytest.mark.slow
def test_again(study):
    assert not [s for n in range(500, 503) for s in study.run_case(("plain", n))["steps"][1:]]
    steps = study.run_case(("torque constant sags by 0.05", 500))["steps"]
    assert steps[0]["kind"] == "saturation"
