"""Tables for papers: the summary's numbers, read back; nothing open passes for a number."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesfric.report import numbers
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.paper import latex
from bayesfric.report.paper.tables import (
    methods_latex,
    parameter_table,
)
from bayesfric.report.summary.record import is_skewed
from bayesfric.report.summary.summary import summarise
from bayesfric.report.terminal import fit_text

from .made_summaries import every_kind, knee, loaded
from .made_tables import lines, num, skewed

CASES = {"open": knee, "loaded": loaded, "invented": every_kind}


@pytest.fixture(params=CASES)
def summary(request):
    return CASES[request.param]()


@pytest.fixture(scope="module")
def real(make_fit):
    return summarise(make_fit(samples=600)).as_dict()


def test_what_least_squares_makes_of_the_motion_is_not_what_the_motor_feels(real):
    """Behind a load loss it may lie outside what is felt in either direction of power."""
    of_motion = {name for name, row in real["derived"].items() if row.get("of_motion")}
    assert "total.inertia" in of_motion
    assert not of_motion & {r.name for r in parameter_table(real).rows}
    assert not of_motion & {line.split()[0] for line in fit_text(real) if line.strip()}
    # beside least squares, marked
    assert "total.inertia" in {row.name for row in comparison({"run": real}).rows}
    assert r"\textsuperscript{m}" in methods_latex(comparison({"run": real}))


def test_methods_table_is_the_comparison(summary):
    found = comparison({"run": summary})
    body = lines(methods_latex(found))
    assert len(body) == len(found.rows)
    for cells, row in zip(body, found.rows, strict=True):
        for text, column in zip(cells[2:], found.columns, strict=True):
            cell = row.cells.get(column.label)
            if cell is None:
                assert text == ""
            elif cell.status == "undetermined":
                assert text == "---"
            elif cell.status != "limit":
                if cell.interval and is_skewed(cell.value, *cell.interval):
                    middle, up, down, last = skewed(re.sub(r"\\textsuperscript\{.*\}$", "", text))
                    both = [middle - down, middle + up]
                    np.testing.assert_allclose(both, cell.interval, rtol=0, atol=1.001 * last)
                    continue
                value, sd, last = num(re.sub(r"\\textsuperscript\{.*\}$", "", text))
                tolerance = 0.5001 * last if cell.sd else 1e-3 * abs(cell.value)
                assert value == pytest.approx(cell.value, abs=tolerance)
                if cell.sd:
                    assert sd == pytest.approx(cell.sd, abs=0.5001 * last)


# -- numbers


@given(
    st.floats(-1e6, 1e6, allow_subnormal=False),
    st.floats(1e-9, 1e6),
)
def test_any_number_reads_back(value, sd):
    text = numbers.LATEX.value(value, sd)
    found, uncertainty, _ = num(text)
    last = 10.0 ** numbers.last_digit(sd)
    # beside the rounding to the last digit that of a double
    assert found == pytest.approx(value, abs=0.5001 * last + 1e-15 * abs(value))
    assert uncertainty == pytest.approx(sd, abs=0.5001 * last)


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [
        (4.6178e-4, 3.6e-7, r"\num{4.6178(36)e-4}"),
        (0.23600, 0.00084, r"\num{0.23600(84)}"),
        (0.0123, 0.000996, r"\num{0.0123(10)}"),
        (203.5, 1.14, r"\num{203.5(11)}"),
        (95123.0, 310.0, r"\num{9.512(31)e4}"),
        (0.0, 0.25, r"\num{0.00(25)}"),
        (-0.001, 0.3, r"\num{0.00(30)}"),
        (2034.0, 11.4, r"\num{2034(11)}"),
    ],
)
def test_digits_are_set_by_the_uncertainty(value, sd, text):
    assert numbers.LATEX.value(value, sd) == text


def test_names_that_latex_would_trip_over():
    assert latex.symbol("", "motor_50%.inertia") == r"\texttt{motor\_50\%.inertia}"
    assert latex.symbol("J_{left_arm}", "x") == r"$J_{\mathrm{left\_arm}}$"
    assert latex.escaped("a & b_c $5 {x} 50%") == r"a \& b\_c \$5 \{x\} 50\%"


@pytest.mark.parametrize("sd", [0.0, -1.0, float("nan"), float("inf")])
def test_no_uncertainty_no_digits(sd):
    with pytest.raises(ValueError, match="no uncertainty"):
        numbers.last_digit(sd)


@pytest.mark.parametrize(
    ("middle", "low", "high", "sd", "shown"),
    [
        # of runs: a tail of one side made the sd larger than all of the other
        (11.1, 4.80, 11.54, 5.2, ("[4.80, 11.54]", r"$\num{11.10}^{+\num{0.44}}_{-\num{6.30}}$")),
        (1.0056, 1.0003, 9.1, 6.0, ("[1.0003, 9.1000]", None)),
        (0.9473, 0.512, 0.9502, 0.2, ("[0.5120, 0.9502]", None)),
        # an end that is nearer than a thousandth of the other's distance sets no digits
        (18.19, -11962.0, 18.2, 12000.0, ("[-1.1962e4, 18]", None)),
        (4.1, 2.455, 5.745, 1.0, ("[2.5, 5.7]", r"$\num{4.1}^{+\num{1.6}}_{-\num{1.6}}$")),
    ],
)
def test_a_skewed_interval_is_rounded_by_its_nearer_end(middle, low, high, sd, shown):
    fine = numbers.finer(middle, low, high, sd)
    interval, ends_ = shown
    assert numbers.TEXT.interval(low, high, fine) == interval
    if ends_ is not None:
        assert numbers.LATEX.ends(middle, low, high, fine) == ends_


def test_a_value_far_below_its_sd_takes_the_sds_power_of_ten():
    assert numbers.HTML.value(1.35, 690.0) == "(0.0 ± 6.9)\u00a0×\u00a010<sup>2</sup>"
    assert numbers.LATEX.value(1.35, 690.0) == r"\num{0.0(69)e2}"
    assert numbers.TEXT.interval(-1.2e4, 1.0, 6900.0) == "[-1.20e4, 0]"
