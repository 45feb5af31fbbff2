"""The page's first screen: the seconds that tell most, and words."""

import copy
import re
from dataclasses import replace

import numpy as np
import pytest

from bayesfric.recordings.measurement import LeftOut
from bayesfric.report.answers.record import Answers
from bayesfric.report.answers.stretch import _gaps, stretch
from bayesfric.report.page.run_page import run_page
from bayesfric.report.page.stretch import stretch_drawing
from bayesfric.report.summary.summary import summarise

from .conftest import build
from .made_summaries import FOUND, knee
from .page_reader import read_page


def test_words_come_before_raw_names(tmp_path):
    page = read_page(run_page(tmp_path, knee(), "run"))
    (first,) = page.all("section", id="why")
    names = [p for p in first.all("p") if p.attrs.get("class") == "names"]
    assert names
    for p in names:
        assert all(re.fullmatch(r"made up \w+\.\w+(; )?", s.text) for s in p.all("span"))


@pytest.mark.parametrize("number", [4, 5])
def test_dozens_of_remarks_stand_behind_one_line(tmp_path, number):
    told = knee() | {"warnings": [f"remark {k}" for k in range(number)], "may_be_simulated": True}
    told["findings"] = [FOUND | {"severity": "note"}]
    (first,) = read_page(run_page(tmp_path, told, "run")).all("section", id="why")
    flags = [p.attrs["data-kind"] for p in first.all("p") if p.attrs.get("class") == "flag"]
    assert flags == ["missing", *["warning"] * number, "simulated"]
    folds = [one for one in first.all("details") if one.attrs.get("class") == "flags"]
    behind = [p.attrs["data-kind"] for one in folds for p in one.all("p")]
    assert behind == (["warning"] * number if number > 4 else [])


def test_prior_intervals_are_of_the_priors():
    fit = build(samples=400, ensembles=2)
    found = summarise(fit).rows
    for prior, name in zip(fit.posterior.priors, fit.posterior.names, strict=True):
        low, high = found[name].prior_interval
        inside = prior.distribution.cdf([low, high]) - prior.distribution.cdf(prior.lower)
        assert inside / prior.mass == pytest.approx([0.05, 0.95], abs=1e-9)
    # of a total, by a large sample of its own
    rng = np.random.default_rng(1)
    draws = {
        name: prior.draw(20_000, rng)
        for name, prior in zip(fit.posterior.names, fit.posterior.priors, strict=True)
    }
    mine = (
        draws["motor.viscous"] + draws["joint.viscous"] * (1 + draws["gearbox.load_drive"]) / 2500
    )
    ends = np.quantile(mine, [0.05, 0.95])
    assert found["total_drive.viscous"].prior_interval == pytest.approx(ends, rel=0.15)


@pytest.fixture
def long():
    """A fit of 13 s in two halves, whose residuals are nothing but a burst at 9 s."""
    fit = build(samples=6000)
    residual = np.zeros_like(fit.target.likelihood.outputs[0].measured)
    time = fit.target.likelihood.outputs[0].time
    residual[(time > 5.9) & (time < 6.1)] = 0.3
    changed = copy.copy(fit)
    changed.__dict__["residuals"] = [residual]
    return changed


def test_the_worst_seconds_are_chosen_by_the_rule(long):
    (o,), (residual,) = long.target.likelihood.outputs, long.residuals
    found = stretch(long)
    begin, end = found.span
    assert 4.5 < end - begin <= 5.0
    assert begin < 5.9
    assert end > 6.1
    inside = (o.time >= begin) & (o.time <= end)
    assert found.residual_rms == pytest.approx(np.sqrt(np.mean(residual[inside] ** 2)))
    # no other window of 5 s is worse
    for first in o.time[:: o.time.size // 50]:
        other = (o.time >= first) & (o.time <= first + 5.0)
        if o.time[-1] >= first + 5.0:
            assert np.mean(residual[other] ** 2) <= found.residual_rms**2 * (1 + 1e-9)
    # the gap of a second between the halves is none of the drawing
    assert len(found.pieces) >= 2
    for time, measured, mean, _ in map(np.asarray, found.pieces):
        at = np.searchsorted(o.time, time - 1e-4)
        assert measured == pytest.approx(o.measured[at], rel=1e-5)
        assert measured - mean == pytest.approx(residual[at], abs=1e-5)


def test_every_gap_says_why_nothing_is_compared_there(long):
    """The gap between the halves has no samples; the others are where the joint turns round."""
    (o,), (of,) = long.target.likelihood.outputs, long.observations
    told = stretch(long)
    (missing,) = [gap for gap in told.gaps if gap.why == "missing"]
    stamps = of.stamps
    assert not ((stamps > missing.span[0] + 0.2) & (stamps < missing.span[1] - 0.2)).any()
    assert len(told.gaps) == len(told.pieces) - 1
    for gap in told.gaps:
        assert not ((o.time > gap.span[0]) & (o.time < gap.span[1])).any()
        if gap.why == "rest":
            inside = (stamps >= gap.span[0]) & (stamps <= gap.span[1])
            assert np.abs(of.qd[inside]).min() < of.settings["dead_zone"]
    drawing = stretch_drawing(told)
    assert set(drawing.gaps) == {gap.why for gap in told.gaps}
    assert str(drawing.markup).count('class="gap') == len(told.gaps)


def test_what_the_configuration_leaves_out_is_told_from_rest():
    fit = build(samples=2000)
    (o,), (outputs,) = fit.observations, fit.target.likelihood.outputs
    # in the middle of the longest piece nothing rests
    ends = np.flatnonzero(np.concatenate([[True], ~outputs.follows, [True]]))
    longest = int(np.argmax(np.diff(ends)))
    middle = o.time[ends[longest : longest + 2].sum() // 2]
    kept = np.abs(o.time - middle) > 5.0 * outputs.period
    named = {k: getattr(outputs, k)[kept] for k in ("time", "measured", "segment_of")}
    cut = replace(outputs, **named, follows=np.diff(named["time"]) < 1.5 * outputs.period)
    found = list(_gaps(cut, o, 0, cut.time.size))
    (out,) = [gap for gap in found if gap.span[0] < middle < gap.span[1]]
    assert out.why == "left-out"
    assert [gap for gap in found if gap is not out] == list(_gaps(outputs, o, 0, o.time.size))


def test_one_gap_may_be_rest_and_left_out():
    """Beside a rest of the made-up swing some motion is excluded: two blocks, told apart."""
    fit = build(samples=2000)
    (o,), (outputs,) = fit.observations, fit.target.likelihood.outputs
    gaps = list(_gaps(outputs, o, 0, o.time.size))
    rests = [gap for gap in gaps if gap.why == "rest"]
    rest = max(rests, key=lambda gap: gap.span[1] - gap.span[0])
    # it begins where the longest rest ends
    span = LeftOut(rest.span[1], rest.span[1] + 0.1, "exclude")
    kept = (o.time < span.start) | (o.time > span.stop)
    named = {k: getattr(outputs, k)[kept] for k in ("time", "measured", "segment_of")}
    cut = replace(outputs, **named, follows=np.diff(named["time"]) < 1.5 * outputs.period)
    seen = replace(o, left_out=(LeftOut(0.0, 0.01, "cut"), span))
    first, second = (
        g for g in _gaps(cut, seen, 0, cut.time.size) if rest.span[0] <= g.span[0] < span.stop
    )
    assert (first.why, second.why) == ("rest", "left-out")
    # the trim beside what is excluded is left out, too
    trim = o.settings["trim_samples"] * o.settings["sampling_rate"] ** -1
    assert first.span == [rest.span[0], pytest.approx(span.start - trim, abs=2 * outputs.period)]
    assert second.span[0] == first.span[1]
    assert second.span[1] >= span.stop


def test_the_drawing_is_of_the_numbers(long):
    told = stretch(long)
    drawing = stretch_drawing(told)
    assert told.recording in drawing.markup
    assert str(drawing.markup).count("M") > len(told.pieces)
    paths = " ".join(re.findall(r' d="([^"]*)"', str(drawing.markup)))
    numbers = [float(x) for x in re.findall(r"-?\d+\.\d", paths)]
    assert min(numbers) >= 0.0
    assert max(numbers) <= 1000.0
    empty = told.model_copy(update={"pieces": []})
    assert stretch_drawing(empty) is None
    ragged = told.model_copy(update={"pieces": [[[0.0], [1.0, 2.0], [1.0], [1.0]]]})
    assert stretch_drawing(ragged) is None


def test_what_is_no_page_json_is_left_out(tmp_path):
    for text in ("", "[]", '{"stretch": {"unit": 3}}', "\x00"):
        (tmp_path / "page.json").write_text(text, encoding="utf-8")
        page = read_page(run_page(tmp_path, knee(), "run"))
        (section,) = page.all("section", id="calculator")
        assert "holds no page.json" in section.text
    assert Answers.model_validate_json("{}").calculator is None
