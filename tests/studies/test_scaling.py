"""The study of the scaling: what its committed result claims."""

import pytest

from .bench import STUDIES, results

result = results("scaling/result.json")


def test_it_is_simulated_and_every_case_was_sampled_to_the_end(result):
    assert result["simulated"] is True
    assert {path.stem for path in (STUDIES / "scaling").glob("*.toml")} == set(result["cases"])
    assert {case["status"] for case in result["cases"].values()} == {"reliable"}


def test_predicted_sds_are_the_sampled_ones(result):
    """Within 15 % for all that the data determine, where the scale is lifted."""
    rows = result["predicted"]["known-mass"]["parameters"]
    assert {row["verdict"] for row in rows.values()} == {"data"}
    assert len(rows) == 11
    for name, row in rows.items():
        assert abs(row["ratio"] - 1.0) < 0.15, name


def test_where_bounds_cut_the_posterior_predicted_sds_are_too_wide_not_too_narrow(result):
    """The README tells this one: with one mu, what the data determine is 17 % off at most."""
    for row in result["predicted"]["common-mu"]["parameters"].values():
        if row["verdict"] == "data":
            assert 0.95 < row["ratio"] < 1.25


def test_the_advised_experiment_is_within_a_fifth_of_the_best(result):
    advice = result["advice"]
    sampled = [row["sampled"] for row in advice["candidates"]]
    assert len(sampled) >= 8
    assert sampled[0] < 1.2 * min(sampled)
    assert advice["chosen_over_best"] == pytest.approx(sampled[0] / min(sampled))
