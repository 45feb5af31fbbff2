"""What several runs say together, and what is never pooled."""

import copy
import csv
import io
from itertools import combinations

import numpy as np

from bayesfric.report.comparison.between_runs import RunDraws, between_runs, between_runs_csv
from bayesfric.report.page.pages import Provenance, shared_recordings
from bayesfric.report.summary.record import Summary

from .made_summaries import LEG, knee, loaded


def checked(**summaries):
    return {name: Summary.read(summary, name) for name, summary in summaries.items()}


def beside(**changes):
    """Pool two runs, of which the second says something else of the viscous loss."""
    runs = checked(a=knee(), b=loaded())
    runs["b"] = runs["b"].with_rows({"motor.viscous": changes})
    return {pooled.name: pooled for pooled in between_runs(runs)}


def test_only_what_the_data_of_two_runs_determine_is_pooled():
    other = copy.deepcopy(loaded())
    other["parameters"]["motor.viscous"]["verdict"] = "weak"
    del other["derived"]["total.offset"]
    found = {pooled.name: pooled for pooled in between_runs(checked(a=knee(), b=other))}
    assert "motor.inertia" in found
    assert {"motor.viscous", "total.offset", "noise.sigma", *LEG}.isdisjoint(found)
    assert found["total.inertia"].runs["b"].mean == other["derived"]["total.inertia"]["mean"]
    assert between_runs(checked(a=knee())) == []
    rows = list(csv.DictReader(io.StringIO(between_runs_csv(list(found.values())))))
    assert {row["name"] for row in rows} == set(found)
    for row in rows:
        assert float(row["mean"]) == found[row["name"]].pool.mean.median
        assert float(row["following_high"]) == found[row["name"]].pool.following.high
        assert row["agree"] == str(found[row["name"]].pool.agree)


def test_what_another_motion_changes_is_not_pooled():
    other = loaded()
    other["derived"]["total.inertia"]["of_motion"] = True
    found = {pooled.name for pooled in between_runs(checked(a=knee(), b=other))}
    assert "total.inertia" not in found
    assert "total.viscous" in found


def weak_in_c():
    other = copy.deepcopy(loaded())
    other["parameters"]["motor.viscous"] |= {"verdict": "weak", "prior_sd": 1.0}
    return checked(a=knee(), b=loaded(), c=other)


def test_a_run_whose_prior_has_a_say_counts_by_its_draws_only():
    runs = weak_in_c()
    found = {pooled.name: pooled for pooled in between_runs(runs)}
    assert set(found["motor.viscous"].runs) == {"a", "b"}
    row, rng = runs["c"].parameters["motor.viscous"], np.random.default_rng(1)
    drawn = row.mean + row.sd * rng.standard_normal(4000)
    prior = {"motor.viscous": row.mean + rng.standard_normal(2000)}
    with_draws = between_runs(runs, {"c": RunDraws({"motor.viscous": drawn}, prior)})
    (viscous,) = (pooled for pooled in with_draws if pooled.name == "motor.viscous")
    assert set(viscous.runs) == {"a", "b", "c"}


def test_what_is_doubted_is_pooled_and_said_to_be():
    doubted = {"verdict": "weak", "doubted": ["delay"]}
    assert beside(**doubted, undoubted="data")["motor.viscous"].doubted == 1
    # what a prior helped to settle is not the data's because somebody pushed, too
    assert "motor.viscous" not in beside(**doubted, undoubted="weak")


def test_room_for_the_models_error_is_pooled_too():
    sd = 10.0 * loaded()["parameters"]["motor.viscous"]["sd"]
    room = {"model_error_sd": sd, "model_error_interval": [0, 1]}
    plain, wide = (pooled["motor.viscous"].pool.runs[1] for pooled in (beside(), beside(**room)))
    assert wide.high - wide.low > 1.2 * (plain.high - plain.low)


def test_a_limit_is_no_value_to_pool():
    assert "motor.viscous" not in beside(at_bound="lower", bound=0.0)


def test_a_population_ends_where_its_quantity_does():
    """Two runs far apart leave a normal population room below zero, where no loss is."""
    far = 9.0 * loaded()["parameters"]["motor.viscous"]["mean"]
    pool = beside(mean=far, median=far)["motor.viscous"].pool
    assert (pool.mean.low, pool.following.low) == (0.0, 0.0)
    assert pool.following.high > far


def test_a_run_whose_ensembles_disagree_is_not_averaged_in():
    failed = copy.deepcopy(loaded())
    for row in failed["derived"].values():
        row["mean"] *= 100.0
    failed["sampler"] = {"status": "unusable", "problems": ["the ensembles disagree"]}
    both = checked(a=knee(), b=loaded())
    alone, three = between_runs(both), between_runs(both | checked(c=failed))
    assert [pooled.pool for pooled in three] == [pooled.pool for pooled in alone]
    assert all(set(pooled.runs) == {"a", "b"} for pooled in three)
    assert between_runs(checked(a=knee(), c=failed)) == []


def test_runs_of_one_recording_are_found():
    one, two = Provenance(recordings={"r": "ab"}), Provenance(recordings={"x": "ab", "y": "cd"})
    other, unknown = Provenance(recordings={"z": "ef"}), Provenance(recordings={"q": ""})
    runs = {"a": one, "b": two, "c": other, "d": unknown, "e": None, "f": unknown}
    assert shared_recordings(runs) == [("a", "b")]


def test_parts_of_one_recording_that_do_not_overlap_are_two():
    """Older runs do not tell which part they saw: then it may be the same."""
    first, second, both, old = (
        Provenance(recordings={"r": "ab"}, spans=spans)
        for spans in ({"r": [8.0, 34.0]}, {"r": [34.1, 60.0]}, {"r": [8.0, 60.0]}, {})
    )
    runs = {"first": first, "second": second, "both": both, "old": old}
    pairs = {frozenset(pair) for pair in shared_recordings(runs)}
    apart = frozenset(("first", "second"))
    assert pairs == {frozenset(pair) for pair in combinations(runs, 2)} - {apart}
