"""What several runs say together, and what is never pooled."""

import copy
from itertools import combinations

from bayesfric.report.comparison.between_runs import between_runs
from bayesfric.report.page.pages import shared_recordings
from bayesfric.report.summary.record import Summary

from .made_summaries import LEG, knee, loaded


def pooled(**summaries):
    runs = {name: Summary.read(summary, name) for name, summary in summaries.items()}
    return {line["name"]: line for line in between_runs(runs)}


def changed(**changes):
    """Pool two runs, of which the second says something else of the viscous loss."""
    other = Summary.read(loaded()).with_rows({"motor.viscous": changes})
    return pooled(a=knee(), b=other)


def test_only_what_the_data_of_two_runs_determine_is_pooled():
    other = copy.deepcopy(loaded())
    other["parameters"]["motor.viscous"]["verdict"] = "weak"
    other["derived"]["total.inertia"]["of_motion"] = True
    del other["derived"]["total.offset"]
    table = pooled(a=knee(), b=other)
    assert "motor.inertia" in table
    assert {"motor.viscous", "total.offset", "total.inertia", "noise.sigma", *LEG}.isdisjoint(table)
    assert pooled(a=knee()) == {}


def test_what_is_doubted_is_pooled_and_said_to_be():
    doubted = {"verdict": "weak", "doubted": ["delay"]}
    assert changed(**doubted, undoubted="data")["motor.viscous"]["doubted"] == 1
    # neither what a prior helped to settle nor a limit is the data's value
    assert "motor.viscous" not in changed(**doubted, undoubted="weak")
    assert "motor.viscous" not in changed(at_bound="lower", bound=0.0)


def test_intervals_with_model_discrepancy_are_pooled():
    sd = 10.0 * loaded()["parameters"]["motor.viscous"]["sd"]
    far = 1.1 * loaded()["parameters"]["motor.viscous"]["mean"]
    plain, wide = (
        changed(mean=far, median=far, **wider)["motor.viscous"]["q"]
        for wider in ({}, {"model_error_sd": sd, "model_error_interval": [0, 1]})
    )
    assert 0.0 < wide < 0.1 * plain


def test_a_population_ends_where_its_quantity_does():
    far = 9.0 * loaded()["parameters"]["motor.viscous"]["mean"]
    line = changed(mean=far, median=far)["motor.viscous"]
    assert (line["mean_low"], line["following_low"]) == (0.0, 0.0)
    assert line["following_high"] > far


def test_a_run_whose_ensembles_disagree_is_not_averaged_in():
    failed = copy.deepcopy(loaded())
    failed["sampler"] = {"status": "unusable", "problems": ["the ensembles disagree"]}
    assert pooled(a=knee(), b=loaded(), c=failed) == pooled(a=knee(), b=loaded())
    assert pooled(a=knee(), c=failed) == {}


def test_runs_of_the_same_seconds_of_a_recording_are_named():
    spans = {"first": [8.0, 34.0], "second": [34.1, 60.0], "both": [8.0, 60.0], "old": None}
    runs = {
        name: {"recordings": {"r": "ab"}, "spans": {"r": span} if span else {}}
        for name, span in spans.items()
    }
    apart = ("first", "second")
    assert {*shared_recordings(runs)} == {*combinations(runs, 2)} - {apart}
    # without a hash, or of a run that tells nothing, there is no saying
    other = {"x": {"recordings": {"r": ""}, "spans": {}}, "y": None}
    assert {*shared_recordings(runs | other)} == {*shared_recordings(runs)}
