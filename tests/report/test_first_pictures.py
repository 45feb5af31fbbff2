"""Pictures of the page's first screens: strips, and the seconds that tell most."""

import copy
import re
from dataclasses import replace

import numpy as np
import pytest

from bayesfric.recordings.measurement import LeftOut
from bayesfric.report.answers.record import Answers
from bayesfric.report.answers.stretch import _gaps, stretch
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.page.run_page import run_page
from bayesfric.report.page.stretch import stretch_drawing
from bayesfric.report.page.strip import strips
from bayesfric.report.paper.tables import parameter_table
from bayesfric.report.summary.record import Summary
from bayesfric.report.summary.summary import summarise

from .conftest import build
from .made_summaries import FOUND, LEG, every_kind, knee
from .page_reader import read_page


def made_strips(told):
    read = Summary.read(told)
    return strips(parameter_table(read).rows, comparison({"run": read}))


def test_strips_put_everything_on_one_axis():
    told = knee()
    told["parameters"]["motor.inertia"]["prior_interval"] = [0.0, 2e-3]
    strip = made_strips(told)["motor.inertia"]
    unit = lambda at: strip.low + at / 100.0 * (strip.high - strip.low)  # noqa: E731
    marks = {m.label: m for m in strip.marks}
    assert [m.kind for m in strip.marks].count("estimate") == 2  # least squares has none of it
    interval = marks["posterior"]
    assert [unit(interval.low), unit(interval.high)] == pytest.approx(
        told["parameters"]["motor.inertia"]["interval"]
    )
    assert unit(interval.at) == pytest.approx(3.40e-4)
    value, sd = 3.40e-4 - 0.6 * 2.6e-5, 2.6e-5
    estimate = marks["input-error"]
    assert unit(estimate.at) == pytest.approx(value)
    assert unit(estimate.high) == pytest.approx(value + 1.645 * sd, rel=1e-6)
    assert unit(marks["data sheet"].at) == pytest.approx(3.32e-4)
    # wider than the axis on both sides, and cut there
    assert (marks["prior"].low, marks["prior"].high) == (0.0, 100.0)
    for word in ("prior 0 to 0.002", "data sheet", "input-error", "kg m²"):
        assert word in strip.words


def test_what_is_far_off_is_at_the_end_and_says_where():
    told = knee()
    told["references"]["motor.inertia"]["value"] = 1.0
    strip = made_strips(told)["motor.inertia"]
    (far,) = [m for m in strip.marks if m.kind == "reference"]
    assert (far.at, far.beyond) == (100.0, "high")
    low, high = told["parameters"]["motor.inertia"]["interval"]
    assert strip.high - strip.low < 20.0 * (high - low)


@pytest.mark.parametrize(("side", "bound"), [("lower", 0.0), ("upper", 0.06)])
def test_a_limit_reaches_from_its_bound_and_nothing_beyond(side, bound):
    told = every_kind()
    name = "motor.coulomb_negative"
    row = told["parameters"][name]
    row |= {"at_bound": side, "bound": bound, "interval": [0.003, 0.05]}
    strip = made_strips(told)[name]
    (mark,) = strip.marks
    assert mark.at is None  # it has no value
    unit = [strip.low + at / 100.0 * (strip.high - strip.low) for at in (mark.low, mark.high)]
    assert unit == pytest.approx([0.0, 0.05] if side == "lower" else [0.003, 0.06])
    assert bound in (strip.low, strip.high)


def test_nothing_open_has_a_strip(tmp_path):
    told = knee()
    for row in told["parameters"].values():
        row["prior_interval"] = [0.0, 1.0]
    assert not set(made_strips(told)) & set(LEG)
    page = read_page(run_page(tmp_path, told, "run"))
    drawn = [d for d in page.all("div") if d.attrs.get("class") == "strip"]
    (known,) = [d for d in page.all("dl") if d.attrs.get("class") == "known"]
    assert len(drawn) == len(list(known.all("dt")))
    for one in drawn:
        assert one.attrs["role"] == "img"
        assert "posterior" in one.attrs["aria-label"]


def test_words_come_before_raw_names(tmp_path):
    page = read_page(run_page(tmp_path, knee(), "run"))
    (first,) = page.all("section", id="findings")
    for dt in first.all("dt"):
        assert re.search(r"made up total[_.\w]*|made up \w+\.\w+", dt.text)
    names = [p for p in first.all("p") if p.attrs.get("class") == "names"]
    assert names
    for p in names:
        assert all(re.fullmatch(r"made up \w+\.\w+(; )?", s.text) for s in p.all("span"))


@pytest.mark.parametrize("number", [4, 5])
def test_dozens_of_remarks_stand_behind_one_line(tmp_path, number):
    told = knee() | {"warnings": [f"remark {k}" for k in range(number)], "may_be_simulated": True}
    told["findings"] = [FOUND | {"severity": "note"}]
    (first,) = read_page(run_page(tmp_path, told, "run")).all("section", id="findings")
    flags = [p.attrs["data-kind"] for p in first.all("p") if p.attrs.get("class") == "flag"]
    assert flags == ["missing", *["warning"] * number, "simulated"]
    behind = [p.attrs["data-kind"] for one in first.all("details") for p in one.all("p")]
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
