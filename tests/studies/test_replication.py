"""What the committed replication study claims, its counting, and a small form of it again."""

import numpy as np
import pytest

from .bench import committed, scripts

replication, lacking, fleets = (
    scripts(name, folders=["replication"]) for name in ("replication", "lacking", "fleets")
)


def test_measured_pairs_scatter_by_about_one():
    every = committed("replication/replication.json")["cases"]["all"]
    assert every["told"]["n"] > 40
    assert 0.7 < every["told"]["rms"] < 1.4
    assert 0.8 < every["told"]["held"] < 0.97
    assert every["auto"]["rms"] > 3.0


def test_intervals_hold_where_a_model_lacks_something(lacking):
    cases = committed("replication/lacking.json")
    assert set(cases) == {case for effect in lacking.EFFECTS.values() for case in effect}
    of = dict.fromkeys(cases, "wrong") | dict.fromkeys(lacking.NOT_LISTED, "unlisted")
    of |= dict.fromkeys(lacking.CORRECT, "right")
    right, wrong, unlisted = (
        [r for n in cases if of[n] == kind for one in cases[n] for r in one["rows"]]
        for kind in ("right", "wrong", "unlisted")
    )
    assert np.mean([row["plain"] for row in wrong]) < 0.7
    assert np.mean([row["held"] for row in wrong]) > 0.9
    assert np.mean([row["held"] for row in unlisted]) > 0.7
    # what is right stays as it is
    assert np.median([row["wider"] for row in right]) == pytest.approx(1.0, abs=0.01)
    assert abs(np.mean([row["held"] for row in right]) - 0.9) < 3.0 * np.sqrt(0.09 / len(right))


def test_fleets_hold_what_they_say():
    for name, row in committed("replication/fleets.json").items():
        error = np.sqrt(0.09 / row["fleets"])
        for key in ("mean", "spread", "next", "run"):
            assert row[key] > 0.9 - 3.0 * error, (name, key)
            # of runs that hardly know themselves the spread may be larger than it is
            assert "rough" in name or row[key] < 0.9 + 3.0 * error, (name, key)


def invented(case, value, sd, **more):
    kinds = "auto", "HAC", "told"
    row = {"value": dict.fromkeys(kinds, value), "prior": 100.0}
    row |= {"determined": True, "doubted": False} | dict.fromkeys(kinds, sd) | more
    return {"case": case, "rows": {"motor.viscous": row}}


def test_differences_are_over_both_sds_and_of_what_both_determine(replication):
    runs = [invented("a", 1.0, 0.3), invented("a", 2.0, 0.4), invented("a", 5.0, 0.1, prior=0.1)]
    assert replication.differences(runs, "told", doubted=True) == pytest.approx([-2.0])
    runs[1]["rows"]["motor.viscous"]["doubted"] = True
    assert replication.differences(runs, "told", doubted=False) == []
    judged = replication.judged([3.0, -4.0, 0.0, 0.0])
    assert judged["rms"] == pytest.approx(2.5)
    assert judged["held"] == 0.5


def test_a_regression_has_its_exact_posterior(fleets):
    """Its spread over many is that of the draws: they are flat-prior posteriors."""
    z = []
    for k in range(300):
        draws = fleets.regression(0.1, np.random.default_rng(k))
        z.append((draws.mean() - 0.1) / draws.std())
    # four standard errors of a sd of 300
    assert np.std(z) == pytest.approx(1.0, abs=4.0 / np.sqrt(600.0))


@pytest.mark.slow
def test_a_model_that_lacks_a_term_again(lacking):
    case = lacking.EFFECTS["load loss"][1]
    rows = [row for k in range(3) for row in lacking.one((case, k))["rows"]]
    held, plain = (np.mean([row[name] for row in rows]) for name in ("held", "plain"))
    assert held > max(plain, 0.8)
    assert np.median([row["wider"] for row in rows]) > 1.5
