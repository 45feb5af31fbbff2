"""What is made of a self-check: rows, corrections, doubts, and words on page and terminal."""

import csv
import io
import re
from dataclasses import replace

import numpy as np
import pytest

from bayesfric.diagnostics.quick_fit import QuickFit
from bayesfric.diagnostics.self_check import Checked
from bayesfric.report.alerts import alerts_of
from bayesfric.report.numbers import HTML, LATEX, TEXT, text_rounded
from bayesfric.report.page.run_page import run_page
from bayesfric.report.paper.methods_text import methods_text
from bayesfric.report.paper.tables import latex_texts, parameter_table, parameters_csv
from bayesfric.report.summary.derived_quantities import groups
from bayesfric.report.summary.doubts import put_doubts
from bayesfric.report.summary.record import ModelError
from bayesfric.report.summary.self_check import (
    cite_sentence,
    self_check_doubts,
    self_check_lines,
    self_check_part,
    to_cite,
)
from bayesfric.report.terminal import fit_text
from tests.diagnostics.bench import model
from tests.report.page_reader import read_page

NAME = "motor.viscous"


@pytest.fixture(scope="module")
def result():
    return model(recordings=0).fit(seed=1)


def checked(result, missed, unexplained=0.0, n=40):
    """Fits that miss the viscous loss by so many sds, one after the other."""
    posterior = result.fit.posterior
    truth, j = posterior.flat(n), posterior.names.index(NAME)
    sd = result.summary.parameters[NAME].sd
    fits = []
    for one, z in zip(truth, np.resize(missed, n), strict=True):
        nearby = one.copy()
        nearby[j] += 1e-3 * z * sd
        fits.append(QuickFit(nearby, 1e-3, unexplained))
    return Checked(n, truth, tuple(fits), 1.0, 2.0)


def told(result, found):
    part = self_check_part(result.fit, result.summary, found, groups(result.fit))
    return result.summary.model_copy(update={"self_check": part})


def test_a_constant_bias_is_taken_off_whole(result):
    summary = told(result, checked(result, [2.0]))
    row, check = summary.parameters[NAME], summary.self_check.rows[NAME]
    assert check.bias == pytest.approx(2.0)
    assert check.bias_error == pytest.approx(0.0, abs=1e-6)
    assert check.coverage == pytest.approx(0.361, abs=1e-3)  # P(|Z + 2| < 1.645)
    assert check.corrected_coverage == pytest.approx(0.9)
    assert check.corrected == pytest.approx(row.median - 2.0 * row.sd, rel=0.02)
    assert self_check_doubts(summary) == []


@pytest.mark.parametrize("missed", [[0.29], [0.6, -0.6], [4.0, -3.0]])
def test_what_is_small_or_no_surer_than_its_error_is_not_corrected(result, missed):
    check = told(result, checked(result, missed)).self_check.rows[NAME]
    assert check.corrected_interval is None


def test_what_first_order_says_nothing_of_is_not_corrected_but_doubtful(result):
    row = result.summary.parameters[NAME]
    summary = told(result, checked(result, [1.5 * row.median / row.sd]))
    assert summary.self_check.rows[NAME].corrected_interval is None
    (doubt,) = self_check_doubts(summary)
    assert doubt["parameters"] == [NAME]


def test_what_no_shift_mends_is_doubtful_and_said_first(result):
    summary = told(result, checked(result, [3.0, -3.0]))
    (doubt,) = self_check_doubts(summary)
    assert doubt["parameters"] == [NAME]
    after = put_doubts(summary, [doubt])
    assert after.parameters[NAME].verdict == "weak"
    assert after.sampler.status == "tentative"
    text = "\n".join(fit_text(after))
    assert f"the 90 % interval of {NAME} holds it in 9 %" in text
    assert re.search(rf"{NAME} +bias \+0.00 sd, 90 % intervals hold 9 %", text)


def test_what_is_seldom_held_stands_under_table_and_in_the_methods(result):
    """A limit of 95 % that simulations hold in 61 % went to print without a word."""
    seldom, often = (told(result, checked(result, missed)) for missed in ([3.0, -3.0], [0.1]))
    words = "holds the truth in 9 % only, in place of 90 %"
    for medium in (
        lambda summary: "\n".join(parameter_table(summary).notes),
        lambda summary: latex_texts(summary, "run")["tables/parameters.tex"].replace("\\%", "%"),
        lambda summary: methods_text(result.fit, summary).plain,
    ):
        assert words in medium(seldom).replace("\\,", " ")
        assert "holds the truth in" not in medium(often)


def test_what_filters_leave_of_the_torque_is_no_noise(result):
    """The noise's scale holds it: of so wide intervals more hold the truth."""
    half = told(result, checked(result, [0.0], unexplained=0.5)).self_check
    assert half.unexplained == 0.5
    assert half.rows[NAME].coverage == pytest.approx(0.980, abs=1e-3)  # P(|Z| < 1.645 sqrt(2))


def test_the_page_says_what_it_found_and_cannot_see(result, tmp_path):
    page = run_page(tmp_path, told(result, checked(result, [2.0])), "run")
    section = page[page.index('id="self-check"') :]
    section = section[: section.index("</section>")]
    assert "cannot see a wrong model" in section
    assert "second order" in section
    assert re.search(rf'data-name="{NAME}".*?2.00 ± 0.00.*?36.1 ± 0.0', section, re.S)
    assert 'data-kind="corrected"' in page


def test_the_page_says_why_there_is_none(result, tmp_path):
    none = replace(checked(result, [0.0]), fits=(), reason="simulation", said="it has no inertia")
    page = run_page(tmp_path, told(result, none), "run")
    assert "None could be made: the joint cannot be simulated: it has no inertia." in page
    assert 'id="self-check"' not in run_page(tmp_path, result.summary, "run")


def test_the_terminal_says_of_which_interval_a_correction_is(result):
    summary = told(result, checked(result, [2.0]))
    assert "were the model right" not in "".join(self_check_lines(summary))
    error = ModelError(shown=True)
    lines = self_check_lines(summary.model_copy(update={"model_error": error}))
    (line,) = (one for one in lines if one.strip().startswith(NAME))
    assert "corrected, were the model right: " in line


def test_the_methods_say_it_in_one_sentence(result):
    summary = told(result, checked(result, [2.0]))
    said = methods_text(result.fit, summary).plain
    assert "In 40 recordings simulated at draws of the posterior" in said
    assert f"{NAME} was biased by more than 0.3 posterior sds" in said
    row = summary.self_check.rows[NAME]
    before, after = (
        text_rounded(x, summary.rows[NAME].sd) for x in (summary.rows[NAME].middle, row.corrected)
    )
    assert f"{NAME} is {after} in place of {before}; such simulations" in said
    assert "simulated at draws" not in methods_text(result.fit, result.summary).plain


@pytest.mark.parametrize(
    ("wide", "doubted", "rule"),
    [
        (
            0.0,
            False,
            "the corrected ones where there are any: the tables of parameters print these",
        ),
        (10.0, False, "those of the tables of parameters, uncorrected"),
        (10.0, True, "none of it is to be cited, corrected or not"),
        # a bias of two sds is large beside an interval five times as wide, too
        (5.0, False, "the tables of parameters print these, with intervals that have room"),
    ],
)
def test_one_rule_says_what_to_cite_everywhere(tmp_path, result, wide, doubted, rule):
    """And the tables hold what is to be cited."""
    summary = told(result, checked(result, [2.0]))
    if wide:
        row = summary.rows[NAME]
        low, high = (row.median + wide * (end - row.median) for end in row.interval)
        wider = {"model_error_interval": [low, high], "model_error_sd": wide * row.sd}
        summary = summary.with_rows({NAME: wider}, model_error=ModelError(shown=True))
    if doubted:
        summary = summary.with_rows({NAME: {"verdict": "weak", "doubted": ["delay"]}})
    table = parameter_table(summary)
    page = read_page(run_page(tmp_path, summary, "run"))
    (section,) = page.all("section", id="self-check")
    (beside,) = (s.text for s in page.all("span") if "by the self-check:" in s.text)
    (alert,) = (a.text for a in alerts_of(summary) if a.kind == "corrected")
    texts = ["\n".join(table.notes), methods_text(result.fit, summary).plain, section.text, alert,
             "\n".join(self_check_lines(summary))]  # fmt: skip
    assert [rule in text for text in texts] == [True] * 5
    # what is doubtful is not called a value to cite in the same breath
    assert not doubted or not any("values to cite" in text for text in texts)
    by = {0.0: "this is the value to cite", 10.0: "is the one above"}
    by[5.0] = f"{by[0.0]}, with room for the model’s error"
    assert ("doubtful" if doubted else by[wide]) in beside
    # the corrected value stands in the tables where it is the one to cite
    row = summary.self_check.rows[NAME]
    (line,) = (r for r in table.rows if r.name == NAME)
    right = row.corrected if wide < 10.0 else summary.rows[NAME].middle
    assert line.cited[0] == right
    printed = next(text for text in fit_text(summary) if text.startswith(f"  {NAME} "))
    assert float(printed.split()[1]) == pytest.approx(right, rel=1e-4)
    assert ("corrected for the bias" in printed) == (wide < 10.0)
    for medium in (TEXT, HTML, LATEX):
        value, interval = line.shown(medium)
        told_as = medium.value(right, line.cited[3]), medium.ends(*line.cited)
        assert told_as[medium is not HTML] == value
        assert medium.interval(*line.cited[1:]) in interval
    if wide == 5.0:  # as wide as what has room for the model's error
        low, high = summary.rows[NAME].told_interval
        assert line.cited[2] - line.cited[1] == pytest.approx(high - low)
    else:
        assert list(line.cited[1:3]) == (
            row.corrected_interval if wide < 10.0 else summary.rows[NAME].told_interval
        )
    before = text_rounded(summary.rows[NAME].middle, summary.rows[NAME].told_sd)
    noted = [note for note in table.notes if f"{NAME}, uncorrected {before} [" in note]
    assert len(noted) == (wide < 10.0)
    compared = latex_texts(summary, "run")["tables/estimates.tex"]
    assert ("not corrected for the bias" in compared) == (wide < 10.0)
    lines = csv.DictReader(io.StringIO(parameters_csv(table)))
    (line,) = (one for one in lines if one["name"] == NAME)
    found = [float(line[key]) for key in ("corrected", "corrected_low", "corrected_high")]
    assert found == [row.corrected, *row.corrected_interval]
    cite = tuple(float(line[key]) for key in ("cite", "cite_low", "cite_high"))
    assert cite == next(r.cited[:3] for r in table.rows if r.name == NAME)


def test_where_only_some_corrected_values_are_doubtful_the_others_are_to_be_cited(result):
    summary = told(result, checked(result, [2.0]))
    other = next(name for name, row in summary.parameters.items() if name != NAME)
    rows = dict.fromkeys((NAME, other), summary.self_check.rows[NAME])
    both = summary.self_check.model_copy(update={"rows": rows})
    summary = summary.model_copy(update={"self_check": both})
    assert set(to_cite(summary)["rows"]) == {NAME, other}
    some = summary.with_rows({NAME: {"verdict": "weak", "doubted": ["delay"]}})
    assert "corrected ones where there are any" in cite_sentence(some)
    assert "doubtful ones are not to be cited" in cite_sentence(some)
    assert "doubtful" not in cite_sentence(summary)


def test_a_page_without_a_number_free_of_doubt_does_not_say_that_its_check_tells_nothing(
    result, tmp_path
):
    summary = told(result, checked(result, [2.0]))
    changes = {name: {"verdict": "weak", "doubted": ["delay"]} for name in summary.rows}
    page = run_page(tmp_path, summary.with_rows(changes), "run")
    assert "tells of what the data determine free of doubt: here nothing" in page


def test_the_first_card_parts_what_the_data_alone_tell_from_what_the_prior_helps_to(
    result, tmp_path
):
    """And the row itself says that its interval holds too little."""
    summary = told(result, checked(result, [3.0, -3.0]))  # no shift mends that
    share = f"{100 * summary.self_check.rows[NAME].coverage:.0f} %"
    summary = summary.with_rows({NAME: {"verdict": "weak"}})
    page = read_page(run_page(tmp_path, summary, "run"))
    (card,) = (p.text for p in page.all("p") if p.text.startswith("Self-check by simulation"))
    alone, together = card.split("of what is known only together with prior and bounds")
    assert "of what the data alone determine" in alone
    assert NAME not in alone
    assert share in together
    assert NAME in together
    said = [s.text for s in page.all("span") if "in simulation this interval" in s.text]
    assert said == [f"in simulation this interval holds the truth in {share} only"]
    assert "in simulation this interval" not in run_page(tmp_path, result.summary, "run")


def test_a_correction_that_changes_no_digit_is_none(result, tmp_path):
    """A bias of 0.35 sd is below the last digit where the model's error makes that a coarse one."""
    summary = told(result, checked(result, [0.35]))
    row = summary.rows[NAME]
    assert to_cite(summary) is not None
    wide = 100.0 * row.sd
    low, high = row.median - 1.6 * wide, row.median + 1.6 * wide
    wider = {"model_error_interval": [low, high], "model_error_sd": wide}
    summary = summary.with_rows({NAME: wider}, model_error=ModelError(shown=True))
    assert summary.self_check.rows[NAME].corrected_interval
    assert cite_sentence(summary) == ""
    assert not [a for a in alerts_of(summary) if a.kind == "corrected"]
    assert "corrected" not in "\n".join(self_check_lines(summary))
    said = methods_text(result.fit, summary).plain
    assert f"{NAME} was biased by more than 0.3 posterior sds ({NAME} by less than shows" in said
    page = run_page(tmp_path, summary, "run")
    assert "by the self-check:" not in page
    assert "changes no digit" in page


def test_nothing_is_said_of_citing_where_nothing_is_corrected(result):
    assert cite_sentence(told(result, checked(result, [0.0]))) == ""
    assert "to cite" not in methods_text(result.fit, result.summary).plain
