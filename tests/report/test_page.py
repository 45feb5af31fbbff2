"""The page of a run: its numbers are the summary's, nothing open is bare, nothing is fetched."""

import base64
import hashlib
import json
import re
from urllib.parse import unquote

import pytest

from bayesfric.report.page.pages import html_symbol, page_figure, run_page
from bayesfric.report.paper.tables import latex_unit, parameters_latex
from bayesfric.report.result_row import table_rows

from .made_summaries import FOUND, every_kind, knee, loaded
from .page_reader import latex_lines, latex_number, number, read_page


@pytest.fixture(scope="module")
def text(written_run):
    return (written_run / "report.html").read_text(encoding="utf-8")


def lines(page):
    """Cells of every line of the tables of parameters, by name."""
    return {
        row.attrs["data-name"]: row
        for table in page.all("table")
        if "parameters" in table.attrs.get("class", "")
        for row in table.all("tr")
        if "data-name" in row.attrs
    }


def cell(row, kind):
    (td,) = [td for td in row.all("td") if kind in td.attrs.get("class", "").split()]
    return td


def skewed():
    summary = knee()
    summary["parameters"]["motor.viscous"]["interval"][1] *= 1.4
    limit = {"at_bound": "lower", "verdict": "weak", "data_sd": 1e-9}
    summary["parameters"]["motor.inertia"] |= limit
    return summary


@pytest.mark.parametrize("make", [None, knee, loaded, skewed, every_kind])
def test_numbers_are_those_of_summary_and_latex_and_nothing_open_stands_bare(
    written_run, tmp_path, make
):
    """To their last digits; no open interval is shown, nor its ends anywhere without words."""
    summary = make() if make else json.loads((written_run / "summary.json").read_text("utf-8"))
    table = table_rows(summary)
    page = read_page(run_page(tmp_path if make else written_run, summary, "run"))
    rows, latex = lines(page), latex_lines(parameters_latex(summary))
    assert set(rows) == {r.name for r in table}
    open_ = [r for r in table if r.status == "unidentified"]
    assert bool(open_) == (make is not loaded)
    for r, (_, _, value, ends, unit, status) in zip(table, latex, strict=True):
        row = rows[r.name]
        assert (r.in_words, latex_unit(r.unit)) == (status, unit)
        assert cell(row, "verdict").text.startswith(status)
        if r.posterior is None:  # a value that is known
            known = latex_number(value)[0][0]
            assert known == pytest.approx(summary["fixed"][r.name]["value"], rel=1e-3)
            continue
        entry = summary["parameters"].get(r.name) or summary["derived"][r.name]
        if r in open_:
            assert (value, ends) == ("---", "---")
            assert (cell(row, "value").text, cell(row, "interval").text) == ("–", "–")
            continue
        shown, last = number(cell(row, "value").text)
        if r.limit is not None:
            assert shown[0] == pytest.approx(r.limit, rel=5e-3)
            assert shown[0] == pytest.approx(latex_number(value.split("$ ")[-1])[0][0], rel=1e-9)
            assert ends == "---"
            continue
        low, high = number(cell(row, "interval").text)[0]
        assert [low, high] == pytest.approx(latex_number(ends)[0], rel=1e-9)
        assert [low, high] == pytest.approx(entry["interval"], abs=0.51 * last)
        # value and sd, or of what is skewed the distances to the interval's ends
        assert shown == pytest.approx(latex_number(value)[0], rel=1e-9)
        assert shown[0] == pytest.approx(entry["median"], abs=0.51 * last)
        if len(shown) == 2:
            assert shown[1] == pytest.approx(entry["sd"], abs=0.51 * last)
        else:
            middle, up, down = shown
            ends = [middle + down, middle + up]
            assert ends == pytest.approx(entry["interval"], abs=1.1 * last)
    bracket = re.compile(r"\[\s*(\S+?),\s*(\S+?)\]")
    ends = {tuple(f"{end:.3g}" for end in r.posterior.interval) for r in open_}
    for node in page.every():
        said = node.text if node.tag in ("td", "li", "p", "dd", "figcaption") else ""
        said += node.attrs.get("aria-label", "")
        assert not ends & {*bracket.findall(said.replace("\u2212", "-"))}, said


def test_what_ensembles_make_that_disagree_is_nowhere_shown_as_a_result(tmp_path):
    """Every number of an unusable run is one that the same run shows when it is reliable."""
    summary = knee() | {"findings": [FOUND | {"severity": "note"}]}
    summary["noise"]["innovation_whiteness"] = {"test": "", "p_value": 0.01, "white": False}
    sound = lines(read_page(run_page(tmp_path, summary, "knee")))
    summary["sampler"] = {"status": "unusable", "problems": ["R-hat 1.3: raise max_steps"]}
    for row in (*summary["parameters"].values(), *summary["derived"].values()):
        row["converged"] = False
    page = read_page(run_page(tmp_path, summary, "knee"))
    (first,), (why,) = (list(page.all("section", id=name)) for name in ("findings", "why"))
    assert "no number is a posterior" in first.text
    assert not list(first.all("table"))
    assert "raise max_steps" in why.text
    assert not re.search(r"--advise|% rms\)|autocorrelated", first.text + why.text)
    for name, row in lines(page).items():
        for kind in ("value", "interval"):
            assert not re.search(r"\d", cell(row, kind).text), name
        assert "not converged" in cell(row, "verdict").text
        is_open = sound[name].attrs["data-status"] == "unidentified"
        assert bool(re.search(r"\d", cell(sound[name], "interval").text)) != is_open, name


def test_nothing_is_fetched_and_only_its_own_script_may_run(text):
    page = read_page(text)
    names = [node.attrs["id"] for node in page.every() if "id" in node.attrs]
    assert len(names) == len(set(names))
    (policy,) = [m.attrs["content"] for m in page.all("meta") if "http-equiv" in m.attrs]
    assert policy.startswith("default-src 'none'")
    (script,) = page.all("script")
    digest = base64.b64encode(hashlib.sha256("".join(script.children).encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in policy
    for node in page.every():
        assert not {"srcset", "action", "data", "poster"} & set(node.attrs)
        assert not any(key.startswith("on") for key in node.attrs)
        target = node.attrs.get("href", f"#{names[0]}")
        assert target.startswith("#")
        assert target[1:] in names
        assert node.attrs.get("src", "data:image/svg+xml,").startswith("data:image/svg+xml,")
    assert "@import" not in text
    assert not list(page.all("link"))
    *_, shown = page.all("pre")  # the last is the configuration
    assert "</script><b>" in shown.text
    shown = re.sub(r"<(style|script)>.*?</\1>", "", text, flags=re.DOTALL)
    assert not re.search(r"\b(nan|inf|None)\b", shown)


def test_names_from_files_are_only_text(tmp_path):
    bad = '"><script>alert(1)</script>'
    summary = knee() | {"warnings": [bad]}
    summary["parameters"][bad] = dict(summary["parameters"]["motor.inertia"], symbol=bad)
    page = read_page(run_page(tmp_path, summary, bad))
    assert len(list(page.all("script"))) == 1
    assert bad in lines(page)


def test_a_drawing_is_an_image(tmp_path):
    """As such it neither acts nor reaches out; the script of the file stays text."""
    svg = (
        '<svg xmlns="http://www.w3.org/2000/svg" width="9pt" viewBox="0 0 9 8">'
        '<script>alert("&quot;")</script><path id="p" d="M 1.23456 2\nL -7.129999 3"/>'
        '<text x="1.0">0.125</text></svg>'
    )
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "one.svg").write_text(svg, encoding="utf-8")
    drawing = page_figure(tmp_path, "one", "One", "A caption.")
    assert (drawing.width, drawing.height, drawing.wide) == (9.0, 8.0, False)
    assert not set('<>"&\n') & set(drawing.source)
    shown = unquote(drawing.source)
    assert 'id="p" d="M 1.23 2 L -7.12 3"' in shown
    assert "0.125" in shown
    (tmp_path / "figures" / "one.svg").write_text("<svg/>", encoding="utf-8")
    with pytest.raises(ValueError, match="no SVG"):
        page_figure(tmp_path, "one", "", "")


@pytest.mark.parametrize(
    ("symbol", "html"),
    [
        (r"J_{t}^{\mathrm{drive}}", "J<sub>t</sub><sup>drive</sup>"),
        (r"\lambda_1/\lambda_2", "λ<sub>1</sub>/λ<sub>2</sub>"),
        (r"\Delta\mu_{left_arm}", "Δμ<sub>left_arm</sub>"),
        # cannot be set
        *((symbol, "") for symbol in ("", "{", r"\nosuch{a}", "a}")),
    ],
)
def test_symbols(symbol, html):
    expected = f'<span class="sym">{html}</span>' if html else "<code>a&lt;b</code>"
    assert html_symbol(symbol, "a<b") == expected
