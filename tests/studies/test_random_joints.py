"""What is missing and what is not: what the committed result claims, and a few joints again."""

import pytest
from scipy import stats

from .bench import committed, scripts


@pytest.fixture(scope="module")
def result():
    return committed("diagnostics/random_joints.json")["judged"]


study = scripts("random_joints", folders=["diagnostics"])


def test_where_nothing_is_missing_little_is_found(result):
    n, k = result["nothing_missing"], result["false_finds"]
    assert n >= 50
    # the upper end of a 95 % interval (Clopper and Pearson)
    assert stats.beta.ppf(0.95, k + 1, n - k) < 0.1


def test_what_is_missing_is_put_in_and_little_else(result):
    named = result["found"] + result["by_another_choice"] + result["named_beside_another"]
    assert named > 0.75 * result["terms"]
    assert result["not_there"] < 0.1 * result["put_in"]


@pytest.mark.slow
def test_a_few_joints_again(study):
    found = study.judged([study.run_case(number) for number in range(5000, 5012)])
    # one of twenty at most: three of six have a chance of 0.2 %
    assert found["false_finds"] <= 2
    assert found["found"] > 0.6 * found["terms"]
