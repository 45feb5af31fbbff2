"""The study of the scaling: what its committed result claims."""

import pytest

from .bench import STUDIES, committed


def test_predicted_sds_are_sampled_and_the_advised_experiment_is_among_the_best():
    result = committed("scaling/result.json")
    assert result["simulated"] is True
    assert {path.stem for path in (STUDIES / "scaling").glob("*.toml")} == set(result["cases"])
    assert {case["status"] for case in result["cases"].values()} == {"reliable"}
    # within 15 % for all that the data determine, where the scale is lifted
    rows = result["predicted"]["known-mass"]["parameters"]
    assert {row["verdict"] for row in rows.values()} == {"data"}
    assert len(rows) == 11
    for name, row in rows.items():
        assert abs(row["ratio"] - 1.0) < 0.15, name
    # where bounds cut the posterior, too wide and not too narrow, as the README says
    for row in result["predicted"]["common-mu"]["parameters"].values():
        assert row["verdict"] != "data" or 0.95 < row["ratio"] < 1.25
    sampled = [row["sampled"] for row in result["advice"]["candidates"]]
    assert len(sampled) >= 8
    assert sampled[0] < 1.2 * min(sampled)
    assert result["advice"]["chosen_over_best"] == pytest.approx(sampled[0] / min(sampled))
