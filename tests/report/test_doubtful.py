"""What is doubtful is said to be so right beside its interval, wherever that is printed."""

import csv
import io

import pytest

from bayesfric.report.paper.tables import summary_texts

from .made_summaries import loaded

NAME, LIMIT, FINE = "motor.inertia", "load.inertia", "motor.viscous"


@pytest.fixture
def told():
    """A run that is right but for two numbers, one of them known as a limit only."""
    found = loaded()
    found["sampler"] |= {"status": "tentative", "min_ess": 5e3, "max_rhat": 1.0, "seconds": 1.0}
    found["doubts"] = [{"kind": "some", "parameters": [NAME, LIMIT]}]
    doubted = {"verdict": "weak", "doubted": ["some"]}
    found["parameters"][NAME] |= doubted | {
        "model_error_interval": [2.7e-4, 4.1e-4], "model_error_sd": 4e-5,
    }  # fmt: skip
    bound = {"at_bound": "lower", "bound": 0.0, "data_sd": 1e-3, "prior_sd": 1.0}
    found["parameters"][LIMIT] |= doubted | bound
    found["model_error"] = {"shown": True}
    return found


def test_a_table_that_is_filtered_by_status_does_not_pass_it(told):
    rows = list(csv.DictReader(io.StringIO(summary_texts(told, "run")["methods.csv"])))
    status = {row["name"]: row["status"] for row in rows if row["column"] == "posterior"}
    assert (status[NAME], status[LIMIT]) == ("doubtful", "doubtful")
    assert status[FINE] == "determined"
