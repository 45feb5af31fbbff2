"""What is doubtful is said to be so right beside its interval, wherever that is printed."""

import csv
import io
import re
from pathlib import Path

import pytest

from bayesfric.diagnostics import before_a_fit
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.page.pages import run_page
from bayesfric.report.paper.tables import latex_texts, methods_latex, summary_table, summary_texts
from bayesfric.report.summary import doubts
from bayesfric.report.summary import self_check_part as self_check
from bayesfric.report.terminal import fit_text
from bayesfric.report.words import words

from .made_summaries import loaded
from .page_reader import read_page

NAME, LIMIT, FINE = "motor.inertia", "load.inertia", "motor.viscous"


@pytest.fixture
def told():
    """A run that is right but for two numbers, one of them known as a limit only."""
    found = loaded()
    found["sampler"] |= {"status": "tentative", "min_ess": 5e3, "max_rhat": 1.0, "seconds": 1.0}
    found["doubts"] = [{"kind": "some", "parameters": [NAME, LIMIT]}]
    doubted = {"verdict": "weak", "doubted": ["some"]}
    found["parameters"][NAME] |= doubted | {
        "model_error_interval": [2.7e-4, 4.1e-4], "model_error_sd": 4e-5,
    }  # fmt: skip
    bound = {"at_bound": "lower", "bound": 0.0, "data_sd": 1e-3, "prior_sd": 1.0}
    found["parameters"][LIMIT] |= doubted | bound
    found["model_error"] = {"shown": True}
    return found


def test_in_the_terminal_right_behind_the_interval(told):
    lines = list(fit_text(told))
    (line,) = (x for x in lines if x.split()[:1] == [NAME])
    assert re.search(r"\[[^\]]*\] +kg m² +doubtful$", line)
    (line,) = (x for x in lines if x.split()[:1] == [LIMIT])
    assert re.search(r"at most \S+ \(95 %\) +kg m² +doubtful$", line)
    (line,) = (x for x in lines if x.split()[:1] == [FINE])
    assert "doubtful" not in line


def test_in_the_same_cell_of_every_table(told):
    for row in latex_texts(told, "run")["tables/parameters.tex"].splitlines():
        cells = row.split(" & ")
        if len(cells) < 5:
            continue
        interval = [cell for cell in cells if re.search(r"\[.*\]", cell)][:1]
        value = [cell for cell in cells if r"\leq" in cell]
        if NAME in cells[0]:
            assert interval[0].rstrip("$ ").endswith("(doubtful)"), row
        elif value:
            assert value[0].endswith("(doubtful)"), row
        else:
            assert "doubtful" not in row, row
    assert r"\textsuperscript{d}" in methods_latex(comparison({"run": told}))
    assert "d: doubtful" in methods_latex(comparison({"run": told}))


def test_every_kind_of_doubt_has_a_clause_for_print():
    source = "".join(Path(one.__file__).read_text() for one in (before_a_fit, doubts, self_check))
    kinds = set(re.findall(r'"kind": "([a-z-]+)"', source))
    assert len(kinds) > 6
    assert kinds - set(words()) == {"missing"}  # which is told by the finding's kind


def test_a_table_that_is_filtered_by_status_does_not_pass_it(told):
    rows = list(csv.DictReader(io.StringIO(summary_texts(told, "run")["methods.csv"])))
    status = {row["name"]: row["status"] for row in rows if row.get("column", "posterior") != "CAD"
              and row.get("column_kind", "posterior") == "posterior"}  # fmt: skip
    assert (status[NAME], status[LIMIT]) == ("doubtful", "doubtful")
    assert status[FINE] == "determined"


def test_the_table_of_the_summary_has_the_same_word(told):
    rows = {r["name"]: r for r in csv.DictReader(io.StringIO(summary_table(told)))}
    assert (rows[NAME]["status"], rows[NAME]["findings"]) == ("doubtful", "some")
    assert rows[LIMIT]["status"] == "doubtful"
    assert (rows[FINE]["status"], rows[FINE]["findings"]) == ("identified", "")


def test_on_the_page_beside_each_interval(told, tmp_path):
    told["self_check"] = {
        **{"asked": 40, "made": 40, "seconds": 1.0, "cpu_seconds": 1.0, "unexplained": 0.1},
        "rows": {
            name: {"bias": 0.5, "bias_error": 0.01, "coverage": 0.85, "coverage_error": 0.01,
                   "corrected": 3.4e-4, "corrected_interval": [3e-4, 3.9e-4]}
            for name in (NAME, FINE)
        },
    }  # fmt: skip
    page = read_page(run_page(tmp_path, told, "run"))
    seen = 0
    for row in page.all("tr"):
        if row.attrs.get("data-name") not in (NAME, FINE) or "data-verdict" not in row.attrs:
            continue  # there the status has a column of its own
        for cell in row.all("td"):
            if re.search(r"\[[^\]]*,[^\]]*\]", cell.text):
                seen += 1
                assert ("doubtful" in cell.text) == (row.attrs["data-name"] == NAME), cell.text
    assert seen == 2  # its interval, and that of the other
    (first,) = page.all("section", id="findings")
    status = {
        row.attrs["data-name"]: next(row.all("td", **{"class": "status"})).text
        for row in first.all("tr")
        if row.attrs.get("data-name") in (NAME, FINE)
    }
    assert status == {NAME: "doubtful", FINE: "identified"}
