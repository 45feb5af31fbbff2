"""The study of the knee: a smaller form of its Monte Carlo, and what its result claims."""

import math

import pytest

from tests.conftest import imported

from .bench import STUDIES, results


@pytest.fixture(scope="module")
def monte_carlo():
    return imported(STUDIES / "rabbit_knee" / "monte_carlo.py")


result = results("rabbit_knee/monte_carlo.json")


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
