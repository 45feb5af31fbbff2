"""Calibration: what its committed result claims, and a smaller form of it run again."""

import importlib

import numpy as np
import pytest
from scipy import stats

from .bench import results, scripts

CONTROLS = ("control: white noise on AR(1) data", "control: snooker move")


result = results("calibration/result.json")
study = scripts("calibrate", folders=["calibration"])


@pytest.mark.parametrize("case", ["white", "AR(1)", "AR(2)", "output error"])
def test_ranks_stay_inside_their_band_and_coverage_near_its_level(result, case):
    found = result[case]
    assert found["recordings"] >= (200 if case == "output error" else 500)
    assert [name for name, row in found["quantities"].items() if not row["inside"]] == []
    # 87 to 93 %, or what chance alone leaves of it among this many quantities and recordings
    n, k = found["recordings"], len(found["quantities"])
    low, high = stats.binom.ppf([0.005 / k, 1.0 - 0.005 / k], n, 0.9) / n
    for name, row in found["quantities"].items():
        assert min(low, 0.87) <= row["coverage"] <= max(high, 0.93), name


@pytest.mark.parametrize("case", CONTROLS)
def test_what_is_wrong_on_purpose_is_caught_by_the_same_check(result, case):
    assert any(not row["inside"] for row in result[case]["quantities"].values())


def test_the_band_holds_uniform_ranks_as_often_as_it_says(study):
    ranks_of = importlib.import_module("ranks", package=study.__package__)
    n, ranked, level, trials = 200, 99, 0.9, 2000
    probability = ranks_of.simultaneous(n, ranked, level)
    _, low, high = ranks_of.band(n, ranked, probability)
    rng = np.random.default_rng(7)
    inside = 0
    for _ in range(trials):
        ranks = rng.integers(0, ranked + 1, size=n)
        below = np.array([(ranks < k).mean() for k in range(1, ranked + 1)])
        inside += bool(np.all((below >= low - 1e-12) & (below <= high + 1e-12)))
    # the level itself is from 4000 trials; five errors of both together
    error = np.sqrt(level * (1 - level) * (1 / trials + 1 / 4000))
    assert abs(inside / trials - level) < 5.0 * error


def test_every_case_makes_recordings_that_its_truth_explains(study):
    for case in study.CASES.values():
        target, truth = study.recording(case, np.random.default_rng(11))
        assert np.isfinite(target.log_likelihood(truth[None])).all()


@pytest.mark.slow
@pytest.mark.parametrize(("case", "honest"), [("AR(1)", True), (CONTROLS[0], False)])
def test_a_few_recordings_again(study, case, honest):
    n = 24
    rows = [study.run_case((case, i)) for i in range(n)]
    j = rows[0]["names"].index("total_drive.inertia" if honest else "noise.sigma")
    covered = sum(row["covered"][j] for row in rows)
    if honest:
        # a right interval is missed this often once in a hundred thousand times
        assert covered >= stats.binom.ppf(1e-5, n, 0.9)
    else:
        # the marginal scale of AR(1) noise by white noise: far more certain than it is
        assert covered <= stats.binom.ppf(1e-3, n, 0.9)
