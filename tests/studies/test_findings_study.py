"""What the regression finds: what the committed result claims, and a few recordings again."""

import importlib
import json
import sys

import pytest
from scipy import stats

from bayesfric.diagnostics.policy import FALSE_ALARMS
from tests.conftest import REPOSITORY

FOLDER = REPOSITORY / "studies" / "diagnostics"


@pytest.fixture(scope="module")
def result():
    return json.loads((FOLDER / "findings.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def study():
    added = [str(FOLDER), str(FOLDER.parent / "calibration")]
    sys.path[:0] = added
    try:
        yield importlib.import_module("findings")
    finally:
        for path in added:
            sys.path.remove(path)


def asked(rows):
    return [row for row in rows if row["reason"] is None]


def test_right_models_are_called_wrong_as_seldom_as_is_promised(result):
    rows = [row for rows in result.values() for row in asked(rows) if not row["right"]]
    alarms = sum(bool(row["steps"]) for row in rows)
    # no more than chance makes of that share in 999 of 1000 studies
    assert alarms <= stats.binom.ppf(0.999, len(rows), FALSE_ALARMS)
    assert len(rows) >= 100


def test_what_is_missing_is_found_and_named(result):
    for case, rows in result.items():
        if not rows[0]["right"]:
            continue
        right, found = set(rows[0]["right"]), [row["steps"] for row in asked(rows)]
        assert sum(map(bool, found)) >= 0.9 * len(found), case
        named = sum(bool(s and right & {s[0]["kind"], *s[0]["rivals"]}) for s in found)
        assert named >= 0.8 * len(found), case


@pytest.mark.slow
def test_again(study):
    assert not [s for n in range(500, 503) for s in study.one(("plain", n))["steps"][1:]]
    steps = study.one(("torque constant sags by 5 %", 500))["steps"]
    assert steps[0]["kind"] == "saturation"
