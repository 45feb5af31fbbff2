"""What is made of a self-check: rows, doubts, and words on page and terminal."""

import numpy as np
import pytest
from scipy.stats import norm

from bayesfric.diagnostics.explanation import CalibrationCheck
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.numbers import HTML, LATEX, TEXT, finer
from bayesfric.report.page.pages import run_page
from bayesfric.report.result_row import result_rows
from bayesfric.report.summary.derived_quantities import groups
from bayesfric.report.summary.doubts import put_doubts, self_check_doubts
from bayesfric.report.summary.parts import self_check_part
from bayesfric.report.terminal import brief, fit_text
from tests.diagnostics.bench import model
from tests.report.page_reader import read_page

pytestmark = pytest.mark.usefixtures("nothing_explained")

NAME = "motor.viscous"


@pytest.fixture(scope="module")
def result():
    return model(recordings=0).fit(seed=1)


def checked(result, missed, unexplained=0.0, n=40, share=1.0):
    """Fits that miss the viscous loss by so many sds, one after the other."""
    posterior = result.fit.posterior
    truth, j = posterior.flat(n), posterior.names.index(NAME)
    sd = result.summary.parameters[NAME].sd
    near_truth, same = truth.copy(), np.ones(n)
    near_truth[:, j] += 1e-3 * np.resize(missed, n) * sd
    errors = near_truth, 1e-3 * same, unexplained * same
    return CalibrationCheck(truth, *errors, 1.0, 2.0, share=share)


def with_check(result, check):
    part = self_check_part(result.fit, result.summary, check, groups(result.fit))
    return result.summary.model_copy(update={"self_check": part})


def test_a_constant_bias_is_doubted_where_intervals_miss_by_it(result):
    summary = with_check(result, checked(result, [2.0]))
    check = summary.self_check["rows"][NAME]
    assert check["bias"] == pytest.approx(2.0)
    assert check["bias_error"] == pytest.approx(0.0, abs=1e-6)
    width = summary.parameters[NAME].reported.sd / summary.parameters[NAME].sd
    reach = 1.645 * width
    held = norm.cdf(reach - 2.0) - norm.cdf(-reach - 2.0)
    assert check["coverage"] == pytest.approx(held, abs=1e-3)
    doubted = [name for doubt in self_check_doubts(summary) for name in doubt["of"]]
    assert doubted == ([NAME] if held < 0.75 else [])


def test_what_no_shift_mends_is_doubtful_and_said_first(result):
    summary = with_check(result, checked(result, [3.0, -3.0]))
    (doubt,) = self_check_doubts(summary)
    assert doubt["of"] == [NAME]
    after = put_doubts(summary, [doubt | {"parameters": doubt.pop("of")}])
    assert after.parameters[NAME].verdict == "weak"
    assert after.sampler.status == "tentative"
    assert after.parameters[NAME].reported.status == "doubtful"


def test_what_filters_leave_of_the_torque_is_no_noise(result):
    """The noise's scale holds it: of so wide intervals more hold the truth."""
    half = with_check(result, checked(result, [0.0], unexplained=0.5)).self_check
    assert half["unexplained"] == 0.5
    row = result.summary.parameters[NAME]
    reach = 1.645 * np.sqrt(2.0) * row.reported.sd / row.sd
    assert half["rows"][NAME]["coverage"] == pytest.approx(2.0 * norm.cdf(reach) - 1.0, abs=1e-3)


def test_the_whole_scatters_less_than_its_excerpts(result):
    """By the root of the share, and of what forty of them leave unknown of the bias."""
    check = with_check(result, checked(result, [3.0, -3.0], share=0.05)).self_check["rows"][NAME]
    assert check["bias_error"] == pytest.approx(3.0 / np.sqrt(39), rel=1e-3)
    row = result.summary.parameters[NAME]
    reach, off = 1.645 * row.reported.sd / row.sd, 3.0 * np.sqrt(0.05 + 1.0 / 40.0)
    held = norm.cdf(reach - off) - norm.cdf(-reach - off)
    assert check["coverage"] == pytest.approx(held, abs=1e-3)


@pytest.mark.parametrize("wide", [0.0, 5.0, 3000.0])
@pytest.mark.parametrize("doubted", [False, True])
def test_every_view_has_the_one_value_interval_and_status(tmp_path, result, wide, doubted):
    """Room for the model's error is in the one number that all print."""
    summary = result.summary
    if wide:
        row = summary.rows[NAME]
        low, high = (row.median + wide * (end - row.median) for end in row.interval)
        wider = {"model_error_interval": [low, high], "model_error_sd": wide * row.sd}
        summary = summary.with_rows({NAME: wider}, model_error={"shown": True})
    if doubted:
        summary = summary.with_rows({NAME: {"verdict": "weak", "doubted": ["delay"]}})
    row = summary.rows[NAME]
    printed = row.reported
    assert printed.value == row.middle
    if wide:
        assert (printed.interval, printed.sd) == (row.model_error_interval, row.model_error_sd)
    assert printed.status == ("doubtful" if doubted else "identified")
    numbers = printed.value, tuple(printed.interval), printed.sd
    line = result_rows(summary)[NAME]
    column = comparison({"run": summary})[NAME].cells["posterior"]
    for shown in (line, column):
        assert (shown.value, shown.interval, shown.sd) == numbers
    frame = summary.frame.set_index("name").loc[NAME]
    assert (frame["value"], (frame["low"], frame["high"]), frame["sd"]) == numbers
    (cells,) = (line for line in brief(summary)["lines"] if line[0] == NAME)
    (terminal,) = (x for x in fit_text(summary) if x.startswith(f"{NAME} "))
    (first,) = read_page(run_page(tmp_path, summary, "run")).all("section", id="findings")
    (page,) = (tr for tr in first.all("tr") if tr.attrs.get("data-name") == NAME)
    assert all(text in terminal and text in page.text for text in cells[1:4])
    fine = finer(printed.value, *printed.interval, printed.sd)
    assert cells[3] == TEXT.interval(*printed.interval, fine)
    for medium in (TEXT, HTML, LATEX):
        assert medium.interval(*printed.interval, fine) in line.texts(medium)[1]
    assert ("doubtful" in terminal) == doubted
