"""Doubts of a summary: noise that is not white, references that are far off."""

import pytest

from bayesfric.report.summary import summary
from bayesfric.report.summary.doubts import correlated, references_off
from bayesfric.report.summary.record import Summary

from .made_summaries import knee as knee_summary
from .made_summaries import loaded


@pytest.mark.parametrize(("p_value", "white"), [(0.011, False), (0.038, False), (0.06, True)])
def test_what_one_in_twenty_would_be_is_not_said_to_pass(knee, monkeypatch, p_value, white):
    monkeypatch.setattr(summary, "ljung_box", lambda *_: p_value)
    assert summary.summarise(knee).noise.innovation_whiteness["white"] == white


@pytest.mark.parametrize(("lag", "times"), [(0.8, 3.0), (0.02, None)])
def test_intervals_are_too_narrow_by_the_factor_of_first_order_noise(lag, times):
    """That of a constant: sqrt(1.8/0.2) = 3."""
    noise = {"model": "white", "innovation_lag1": lag}
    summary = Summary.read(knee_summary() | {"noise": noise})
    doubts = list(correlated(summary, ["motor.inertia"]))
    assert [doubt["times"] for doubt in doubts] == ([] if times is None else [pytest.approx(times)])


@pytest.mark.parametrize(
    ("sds", "reference_sd", "verdict", "off"),
    [
        (-2.9, None, "data", False),
        (-3.2, None, "data", True),
        # a reference that is not known that well itself contradicts nothing
        (-3.2, 1.0, "data", False),
        (-3.2, None, "prior", False),
    ],
)
def test_references_beyond_three_sds_are_off(sds, reference_sd, verdict, off):
    summary, name = loaded(), "motor.inertia"
    summary["parameters"][name]["verdict"] = verdict
    row = Summary.read(summary).rows[name]
    reference = {"value": row.middle + sds * row.reported.sd, "unit": row.unit}
    reference["sd"] = reference_sd and reference_sd * row.reported.sd
    summary["references"] = {name: reference}
    expected = {name: pytest.approx(abs(sds))} if off else {}
    assert references_off(Summary.read(summary)) == expected
