"""The study of the knee: a smaller form of its Monte Carlo, and what its result claims."""

import math

import pytest

from tests.conftest import imported

from .bench import STUDIES, committed


@pytest.fixture(scope="module")
def monte_carlo():
    return imported(STUDIES / "rabbit_knee" / "monte_carlo.py")


@pytest.fixture(scope="module")
def result():
    return committed("rabbit_knee/monte_carlo.json")


def test_the_committed_result_is_of_two_hundred_simulated_recordings(result):
    assert result["simulated"] is True
    assert result["recordings"] >= 200
    methods = {m for row in result["table"].values() for m in row["methods"]}
    assert methods == {"least-squares", "input-error", "output-error"}


@pytest.mark.slow
def test_a_few_new_recordings_agree_with_the_committed_result(result, monte_carlo):
    """Six recordings with seeds the study did not use."""
    count = 6
    found = monte_carlo.run(count, first=10_001, workers=1)
    for name, row in result["table"].items():
        for method, c in row["methods"].items():
            new = found["table"][name]["methods"][method]
            # two means of independent recordings; bounds make some of them far from normal
            width = c["spread"] * math.sqrt(1.0 / count + 1.0 / result["recordings"])
            assert abs(new["mean_error"] - c["mean_error"]) < 5.0 * width, (name, method)
