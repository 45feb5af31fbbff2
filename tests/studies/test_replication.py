"""What the committed replication study claims, its counting, and a small form of it again."""

import numpy as np
import pytest

from .bench import committed, scripts

replication, lacking, fleets = (
    scripts(name, folders=["replication"]) for name in ("replication", "lacking", "fleets")
)

# Five standard errors of the difference of two medians of a thousand independent draws, in sds.
FAR = 5.0 * np.sqrt(np.pi / 2.0) * np.sqrt(2.0 / 1000.0)


def test_sums_are_of_the_fits_beside_them(replication):
    result = committed("replication/replication.json")
    assert {fit["case"] for fit in result["fits"]} == set(result["cases"]) - {"all"}
    again = replication.summed(result["fits"])
    for case, row in result["cases"].items():
        for kind, sums in row.items():
            for key, value in sums.items():
                wanted = np.nan if value is None else value
                assert again["cases"][case][kind][key] == pytest.approx(wanted, nan_ok=True), (
                    case,
                    kind,
                )


def test_every_case_that_lacks_something_is_there(lacking):
    cases = committed("replication/lacking.json")
    assert set(cases) == {case for effect in lacking.EFFECTS.values() for case in effect}


def test_fleets_hold_what_they_say():
    for name, row in committed("replication/fleets.json").items():
        error = np.sqrt(0.09 / row["fleets"])
        for key in ("mean", "spread", "next", "run"):
            assert row[key] > 0.9 - 3.0 * error, (name, key)
            # of runs that hardly know themselves the spread may be larger than it is
            assert "rough" in name or row[key] < 0.9 + 3.0 * error, (name, key)


def invented(case, value, sd, **more):
    kinds = "posterior", "HAC", "reported"
    row = {"value": dict.fromkeys(kinds, value), "prior": 100.0, "class": "friction"}
    row |= {"determined": True, "status": "identified"} | dict.fromkeys(kinds, sd) | more
    return {"case": case, "rows": {"motor.viscous": row}}


def test_differences_are_over_both_sds_and_of_what_both_determine(replication):
    runs = [invented("a", 1.0, 0.3), invented("a", 2.0, 0.4), invented("a", 5.0, 0.1, prior=0.1)]
    assert replication.differences(runs, "reported") == pytest.approx([-2.0])
    assert replication.differences(runs, "reported", "constants") == []
    runs[1]["rows"]["motor.viscous"]["status"] = "doubtful"
    assert replication.differences(runs, "reported", doubted=False) == []
    judged = replication.judged([3.0, -4.0, 0.0, 0.0])
    assert judged["rms"] == pytest.approx(2.5)
    assert judged["held"] == 0.5
    assert judged["most"] == pytest.approx(1.54, abs=0.01)  # sqrt of 9.49 over four


def test_a_regression_has_its_exact_posterior(fleets):
    """Its spread over many is that of the draws: they are flat-prior posteriors."""
    z = []
    for k in range(300):
        draws = fleets.regression(0.1, np.random.default_rng(k))
        z.append((draws.mean() - 0.1) / draws.std())
    # four standard errors of a sd of 300
    assert np.std(z) == pytest.approx(1.0, abs=4.0 / np.sqrt(600.0))


@pytest.mark.slow
@pytest.mark.parametrize("run", ["ddp", "dircol"])
def test_a_measured_fit_again(real_data, replication, run):  # noqa: ARG001
    """By the same seed: what is committed is of today's code."""
    case = "pendulum, controllers"
    folder, text = replication.cases()[case][run]
    again = replication.one((case, run, folder, text))
    fits = committed("replication/replication.json")["fits"]
    (before,) = [fit for fit in fits if (fit["case"], fit["run"]) == (case, run)]
    assert again["noise"] == before["noise"]
    assert again["findings"] == before["findings"]
    assert again["rows"].keys() == before["rows"].keys()
    for name, row in again["rows"].items():
        old = before["rows"][name]
        for kind in ("posterior", "reported"):
            apart = abs(row["value"][kind] - old["value"][kind])
            assert apart < FAR * max(row[kind], old[kind]), (name, kind)
        # of a skewed one, too, sds of a thousand draws are within 20 %
        assert row["posterior"] == pytest.approx(old["posterior"], rel=0.2), name
        assert row["reported"] == pytest.approx(old["reported"], rel=0.2), name


@pytest.mark.slow
def test_a_model_that_lacks_a_term_again(lacking):
    case = lacking.EFFECTS["load loss"][1]
    for number, before in enumerate(committed("replication/lacking.json")[case][:3]):
        again = lacking.one((case, number))
        assert again["findings"] == before["findings"]
        assert again["outcome"] == before["outcome"]
        for new, old in zip(again["rows"], before["rows"], strict=True):
            assert (new["name"], new["status"]) == (old["name"], old["status"])
            for key in ("posterior", "reported"):
                (value, sd, *_), (before_value, before_sd, *_) = new[key], old[key]
                apart = abs(value - before_value)
                assert apart < FAR * max(sd, before_sd), (number, new["name"], key)
