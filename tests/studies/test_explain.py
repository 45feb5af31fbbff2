"""What is missing and what is not: what the committed result claims, and a few joints again."""

import importlib
import json
import sys

import pytest
from scipy import stats

from tests.conftest import REPOSITORY

FOLDER = REPOSITORY / "studies" / "explain"


@pytest.fixture(scope="module")
def result():
    return json.loads((FOLDER / "explain.json").read_text(encoding="utf-8"))["judged"]


@pytest.fixture(scope="module")
def study():
    sys.path.insert(0, str(FOLDER))
    try:
        yield importlib.import_module("explain")
    finally:
        sys.path.remove(str(FOLDER))


def test_what_is_not_there_is_found_in_less_than_one_of_twenty(result):
    n, k = result["nothing_missing"], result["false_finds"]
    assert n >= 100
    # the upper end of a 95 % interval (Clopper and Pearson)
    assert stats.beta.ppf(0.95, k + 1, n - k) < 0.05


def test_what_is_there_is_found_or_said_to_be_one_of_several(result):
    named = result["found"] + result["one_of_several"]
    assert named > 0.8 * result["terms"]
    for name, row in result["confusion"].items():
        if name not in ("nothing", "with others"):
            assert sum(row.values()) >= 5, name


@pytest.mark.slow
def test_a_few_joints_again(study):
    found = study.judged([study.one(number) for number in range(5000, 5024)])
    # one of twenty at most: three of twelve have a chance of 2 %
    assert found["false_finds"] <= 2
    assert found["found"] + found["one_of_several"] > 0.6 * found["terms"]
