"""Pooling: closed forms, a published meta-analysis, and what is never pooled."""

import copy
import csv
import io
import math

import numpy as np
import pytest
from scipy import stats

from bayesfric.report.comparison.between_runs import between_runs, between_runs_csv, pool
from bayesfric.report.page.compare_page import shared_recordings
from bayesfric.report.page.provenance import Provenance
from bayesfric.report.summary.record import Summary

from .made_summaries import LEG, knee, loaded

# Thirteen trials of the BCG vaccine, tuberculosis yes and no of vaccinated and controls
# (Colditz et al. 1994, the example of most texts on meta-analysis).
BCG = (
    (4, 119, 11, 128), (6, 300, 29, 274), (3, 228, 11, 209), (62, 13536, 248, 12619),
    (33, 5036, 47, 5761), (180, 1361, 372, 1079), (8, 2537, 10, 619), (505, 87886, 499, 87892),
    (29, 7470, 45, 7232), (17, 1699, 65, 1600), (186, 50448, 141, 27197), (5, 2493, 3, 2338),
    (27, 16886, 29, 17825),
)  # fmt: skip


def test_a_published_meta_analysis():
    """Paule-Mandel of the BCG trials as published with metafor: tau² 0.3181, Q 152.2330."""
    a, b, c, d = np.array(BCG, dtype=float).T
    log_ratio = np.log(a / (a + b)) - np.log(c / (c + d))
    variance = 1 / a - 1 / (a + b) + 1 / c - 1 / (c + d)
    found = pool(log_ratio, np.sqrt(variance), 0.95)
    assert found.between_sd**2 == pytest.approx(0.3181, abs=5e-5)
    assert found.q == pytest.approx(152.2330, abs=5e-5)
    assert found.mean == pytest.approx(-0.715, abs=1e-3)
    assert not found.agree


@pytest.mark.parametrize("scale", [1.0, 1e-7, 1e6])
def test_equal_sds_have_a_closed_form(scale):
    """With equal sds the mean is plain and tau² the sample variance less s²."""
    y = scale * np.array([3.0, 5.0, 8.5, 4.0])
    found = pool(y, np.full(4, 0.7 * scale), 0.9)
    assert found.mean == pytest.approx(y.mean(), rel=1e-12)
    between = math.sqrt(y.var(ddof=1) - (0.7 * scale) ** 2)
    assert found.between_sd == pytest.approx(between, rel=1e-9)
    half = stats.t.ppf(0.95, 3) * y.std(ddof=1) / 2.0
    assert [found.low, found.high] == pytest.approx([y.mean() - half, y.mean() + half], rel=1e-9)


def test_runs_that_agree_have_no_spread_between_them():
    found = pool([1.0, 1.1, 0.95], [0.2, 0.1, 0.4], 0.9)
    weights = np.array([25.0, 100.0, 6.25])
    assert found.between_sd == 0.0
    assert found.agree
    assert found.mean == pytest.approx(np.average([1.0, 1.1, 0.95], weights=weights), rel=1e-12)
    assert found.sd == pytest.approx(1 / math.sqrt(weights.sum()), rel=1e-12)


def test_a_far_value_without_precision_moves_nothing():
    near = pool([1.0, 1.2], [0.1, 0.1], 0.9)
    far = pool([1.0, 1.2, 50.0], [0.1, 0.1, 1e9], 0.9)
    assert far.mean == pytest.approx(near.mean, rel=1e-6)


def test_intervals_hold_what_they_say():
    """The mean of ten runs of unequal precision lies inside in about 90 % of 400 worlds."""
    rng = np.random.default_rng(4)
    inside = 0
    for _ in range(400):
        sds = rng.uniform(0.2, 1.5, 10)
        y = 2.0 + 0.8 * rng.standard_normal(10) + sds * rng.standard_normal(10)
        found = pool(y, sds, 0.9)
        inside += found.low < 2.0 < found.high
    # binomial: three sds of 400 trials
    assert abs(inside / 400 - 0.9) < 3 * math.sqrt(0.09 / 400) + 0.01


@pytest.mark.parametrize(("y", "s"), [([1.0], [1.0]), ([1.0, 2.0], [1.0, 0.0]), ([1, 2], [1])])
def test_what_cannot_be_pooled(y, s):
    with pytest.raises(ValueError, match="two measurements"):
        pool(y, s, 0.9)


def checked(**summaries):
    return {name: Summary.read(summary, name) for name, summary in summaries.items()}


def test_only_what_every_runs_data_determine_is_pooled():
    other = copy.deepcopy(loaded())
    other["parameters"]["motor.viscous"]["verdict"] = "weak"
    del other["derived"]["total.offset"]
    found = {one.name: one for one in between_runs(checked(a=knee(), b=other))}
    assert "motor.inertia" in found
    assert {"motor.viscous", "total.offset", "noise.sigma", *LEG}.isdisjoint(found)
    assert found["total.inertia"].runs["b"].mean == other["derived"]["total.inertia"]["mean"]
    assert between_runs(checked(a=knee())) == []
    rows = list(csv.DictReader(io.StringIO(between_runs_csv(list(found.values())))))
    assert {row["name"] for row in rows} == set(found)
    for row in rows:
        assert float(row["mean"]) == found[row["name"]].pool.mean
        assert row["agree"] == str(found[row["name"]].pool.agree)


def test_a_run_whose_ensembles_disagree_is_not_averaged_in():
    failed = copy.deepcopy(loaded())
    for row in failed["derived"].values():
        row["mean"] *= 100.0
    failed["sampler"] = {"status": "unusable", "problems": ["the ensembles disagree"]}
    both = checked(a=knee(), b=loaded())
    alone, three = between_runs(both), between_runs(both | checked(c=failed))
    assert [one.pool for one in three] == [one.pool for one in alone]
    assert all(set(one.runs) == {"a", "b"} for one in three)
    assert between_runs(checked(a=knee(), c=failed)) == []


def test_runs_of_one_recording_are_found():
    one, two = Provenance(recordings={"r": "ab"}), Provenance(recordings={"x": "ab", "y": "cd"})
    other, unknown = Provenance(recordings={"z": "ef"}), Provenance(recordings={"q": ""})
    runs = {"a": one, "b": two, "c": other, "d": unknown, "e": None, "f": unknown}
    assert shared_recordings(runs) == [("a", "b")]
