"""The study of the knee: a smaller form of its Monte Carlo, and what its result claims."""

import json
import math

import pytest

from tests.conftest import REPOSITORY, imported

FOLDER = REPOSITORY / "studies" / "rabbit_knee"


@pytest.fixture(scope="module")
def monte_carlo():
    return imported(FOLDER / "monte_carlo.py")


@pytest.fixture(scope="module")
def committed():
    return json.loads((FOLDER / "monte_carlo.json").read_text(encoding="utf-8"))


def test_the_committed_result_is_of_two_hundred_simulated_recordings(committed):
    assert committed["simulated"] is True
    assert committed["recordings"] >= 200
    assert {m for row in committed["table"].values() for m in row["methods"]} == {
        "least-squares",
        "input-error",
        "output-error",
    }


def test_the_markdown_says_which_method_is_biased(committed, monte_carlo):
    text = monte_carlo.markdown(committed)
    rows = [c for row in committed["table"].values() for c in row["methods"].values()]
    biased = sum(abs(c["mean_error"]) > 3 * c["standard_error"] for c in rows)
    assert text.count("**biased**") == biased
    assert len(text.splitlines()) == 2 + len(rows)


@pytest.mark.slow
def test_a_few_new_recordings_agree_with_the_committed_result(committed, monte_carlo):
    """Six recordings with seeds the study did not use."""
    count = 6
    found = monte_carlo.run(count, first=10_001, workers=1)
    for name, row in committed["table"].items():
        for method, c in row["methods"].items():
            new = found["table"][name]["methods"][method]
            # two means of independent recordings; bounds make some of them far from normal
            width = c["spread"] * math.sqrt(1.0 / count + 1.0 / committed["recordings"])
            assert abs(new["mean_error"] - c["mean_error"]) < 5.0 * width, (name, method)
