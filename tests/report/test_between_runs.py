"""What several runs say together, and what is never pooled."""

import copy
import csv
import io
from itertools import combinations

import numpy as np

from bayesfric.report.comparison.between_runs import between_runs, between_runs_csv
from bayesfric.report.page.pages import shared_recordings
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
    other["derived"]["total.inertia"]["of_motion"] = True
    del other["derived"]["total.offset"]
    pooled = {pooled.name: pooled for pooled in between_runs(checked(a=knee(), b=other))}
    assert "motor.inertia" in pooled
    assert {"motor.viscous", "total.offset", "total.inertia", "noise.sigma", *LEG}.isdisjoint(
        pooled
    )
    assert pooled["total.viscous"].runs["b"].mean == other["derived"]["total.viscous"]["mean"]
    assert between_runs(checked(a=knee())) == []
    rows = list(csv.DictReader(io.StringIO(between_runs_csv(list(pooled.values())))))
    assert {row["name"] for row in rows} == set(pooled)
    for row in rows:
        assert float(row["mean"]) == pooled[row["name"]].pool.mean.median
        assert float(row["following_high"]) == pooled[row["name"]].pool.following.high
        assert row["agree"] == str(pooled[row["name"]].pool.agree)


def test_a_run_whose_prior_has_a_say_counts_by_its_draws_only():
    other = copy.deepcopy(loaded())
    other["parameters"]["motor.viscous"] |= {"verdict": "weak", "prior_sd": 1.0}
    runs = checked(a=knee(), b=loaded(), c=other)
    row, rng = runs["c"].parameters["motor.viscous"], np.random.default_rng(1)
    drawn = {"motor.viscous": row.mean + row.sd * rng.standard_normal(4000)}
    prior = {"motor.viscous": row.mean + rng.standard_normal(2000)}
    for draws, expected in ((None, {"a", "b"}), ({"c": (drawn, prior)}, {"a", "b", "c"})):
        pooled = {quantity.name: quantity for quantity in between_runs(runs, draws)}
        assert set(pooled["motor.viscous"].runs) == expected


def test_what_is_doubted_is_pooled_and_said_to_be():
    doubted = {"verdict": "weak", "doubted": ["delay"]}
    assert beside(**doubted, undoubted="data")["motor.viscous"].doubted == 1
    # neither what a prior helped to settle nor a limit is the data's value
    assert "motor.viscous" not in beside(**doubted, undoubted="weak")
    assert "motor.viscous" not in beside(at_bound="lower", bound=0.0)


def test_room_for_the_models_error_is_pooled_too():
    sd = 10.0 * loaded()["parameters"]["motor.viscous"]["sd"]
    wider = {"model_error_sd": sd, "model_error_interval": [0, 1]}
    plain, wide = (of["motor.viscous"].pool.runs[1] for of in (beside(), beside(**wider)))
    assert wide.high - wide.low > 1.2 * (plain.high - plain.low)


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


def test_runs_of_the_same_seconds_of_a_recording_are_found():
    """Older runs do not tell which part they saw: then it may be the same."""
    recordings = {"a": {"r": "ab"}, "b": {"x": "ab", "y": "cd"}, "c": {"z": "ef"}, "d": {"q": ""}}
    runs = {name: {"recordings": hashes, "spans": {}} for name, hashes in recordings.items()}
    assert shared_recordings(runs | {"e": None, "f": runs["d"]}) == [("a", "b")]
    spans = {"first": [8.0, 34.0], "second": [34.1, 60.0], "both": [8.0, 60.0], "old": None}
    runs = {
        name: {"recordings": {"r": "ab"}, "spans": {"r": span} if span else {}}
        for name, span in spans.items()
    }
    apart = ("first", "second")
    assert {*shared_recordings(runs)} == {*combinations(runs, 2)} - {apart}
