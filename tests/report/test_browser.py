"""The pages in a real browser: drawn, quiet, alone, usable by keyboard, on a phone, on paper."""

import base64
import copy
import json
import re
import shutil

import pytest

from bayesfric.commands.compare import compare
from bayesfric.report.page.pages import run_page

from .chromium import barriers, events, needs_axe, needs_browser, show, until
from .made_fleet import COUNT, WORN, write_fleet
from .made_summaries import every_kind, knee, loaded, write_draws

pytest.importorskip("selenium", reason="selenium is not installed")
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

pytestmark = needs_browser


@pytest.fixture(scope="module")
def pages(written_run, tmp_path_factory):
    """Copies of all pages in a folder that holds nothing else."""
    alone = tmp_path_factory.mktemp("alone")
    shutil.copyfile(written_run / "report.html", alone / "run.html")
    made = tmp_path_factory.mktemp("runs")
    for name, summary in (("knee", knee()), ("loaded", loaded())):
        (made / name).mkdir()
        (made / name / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
        write_draws(made / name / "posterior.nc", summary)
    compare([made / "knee", made / "loaded"], made / "out")
    shutil.copyfile(made / "out" / "report.html", alone / "compare.html")
    fleet = tmp_path_factory.mktemp("fleet")
    write_fleet(fleet)
    shutil.copyfile(fleet / "fleet.html", alone / "fleet.html")
    return alone


@pytest.fixture(params=["run.html", "compare.html", "fleet.html"])
def page(request, browser, pages):
    return show(browser, pages / request.param)


@pytest.fixture
def run(browser, pages):
    return show(browser, pages / "run.html")


def test_it_is_quiet_and_alone(page):
    page.execute_script("scrollTo(0, document.documentElement.scrollHeight)")
    page.execute_script("for (const one of document.querySelectorAll('details')) one.open = true")
    assert page.get_log("browser") == []
    asked = [one["request"]["url"] for one in events(page, "Network.requestWillBeSent")]
    assert [url for url in asked if not url.startswith("data:")] == [page.current_url]


def test_its_policy_stops_what_it_does_not_name(run):
    """The policy holds in fact: an image and a script put into the page are refused."""
    run.execute_script(
        "const a = document.createElement('script'); a.textContent = 'window.acted = 1';"
        "document.body.append(a);"
        "const b = document.createElement('img'); b.src = 'https://example.invalid/x.png';"
        "document.body.append(b);"
    )
    assert run.execute_script("return window.acted") is None
    failed = until(lambda: events(run, "Network.loadingFailed"))
    assert [one["blockedReason"] for one in failed] == ["csp"]
    until(lambda: "Content Security Policy" in str(run.get_log("browser")))


def test_every_figure_is_drawn(page):
    page.execute_script("for (const one of document.querySelectorAll('details')) one.open = true")
    sizes = page.execute_script(
        "return [...document.querySelectorAll('figure img')].map(s => {"
        "const b = s.getBoundingClientRect();"
        "return [b.width, b.height, s.naturalWidth, s.naturalHeight]})"
    )
    assert len(sizes) == len(page.find_elements(By.TAG_NAME, "figure"))
    assert sizes
    for size in sizes:
        assert min(size) > 0, sizes


SORT_ALL = """
const found = [];
for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => {
    for (const way of ["ascending", "descending"]) {
      head.querySelector("button").click();
      const keys = [...table.tBodies[0].rows].map(r => {
        const told = r.cells[column].dataset.sort; return told === undefined ? null : told});
      found.push({way, said: heads.map(h => h.getAttribute("aria-sort")), column, keys});
    }
  });
}
return found;
"""


def test_every_column_of_every_table_sorts(page):
    found = page.execute_script(SORT_ALL)
    assert len({tuple(one["said"]) for one in found}) >= 10
    numeric = 0
    for one in found:
        expected = [None] * len(one["said"])
        expected[one["column"]] = one["way"]
        assert one["said"] == expected
        told = [key for key in one["keys"] if key is not None]
        # what is open stands last, whichever way
        assert not told or one["keys"][len(told) :] == [None] * (len(one["keys"]) - len(told))
        try:
            numbers = [float(key) for key in told]
        except ValueError:
            continue
        numeric += len(numbers) > 1
        assert numbers == sorted(numbers, reverse=one["way"] == "descending")
    assert numeric > 10


def test_tables_sort_by_keyboard_and_mouse(page):
    head = page.find_element(By.CSS_SELECTOR, "table.sortable thead th")
    button = head.find_element(By.TAG_NAME, "button")
    button.send_keys(Keys.ENTER)
    assert head.get_attribute("aria-sort") == "ascending"
    button.send_keys(Keys.SPACE)
    assert head.get_attribute("aria-sort") == "descending"
    button.click()
    assert head.get_attribute("aria-sort") == "ascending"


def test_a_fleets_units_stand_outliers_first_and_can_be_filtered(browser, pages):
    page = show(browser, pages / "fleet.html")
    names = (
        "return [...document.querySelectorAll('#table-units tbody tr')]"
        ".filter(r => r.getBoundingClientRect().height > 0).map(r => r.cells[0].textContent)"
    )
    every = page.execute_script(names)
    assert len(every) == COUNT + 1
    assert (every[0], every[-1]) == (WORN, "broken")
    box = page.find_element(By.CSS_SELECTOR, ".filter input")
    box.send_keys("J1 2026-05")
    assert set(page.execute_script(names)) == {"knee-01", "knee-05", "knee-09"}
    assert page.find_element(By.CSS_SELECTOR, ".filter output").text == f"3 of {COUNT + 1}"
    box.clear()
    box.send_keys(" ")
    assert page.execute_script(names) == every
    # a page of its own where there is one, its folder else
    links = {
        a.text: a.get_attribute("href")
        for a in page.find_elements(By.CSS_SELECTOR, "#table-units a")
    }
    assert links["knee-00"].endswith("/units/knee-00/report.html")
    assert links["knee-01"].endswith("/units/knee-01")


def test_anchors_lead_to_their_sections(page):
    links = page.find_elements(By.CSS_SELECTOR, "nav a")
    assert len(links) >= 5
    for link in links:
        link.send_keys(Keys.ENTER)
        target = link.get_attribute("href").partition("#")[2]
        assert page.execute_script("return location.hash") == f"#{target}"
        top, bottom, end = page.execute_script(
            "const b = document.getElementById(arguments[0]).getBoundingClientRect();"
            "return [b.top, b.bottom, innerHeight]",
            target,
        )
        # at the top, or as far up as the page's end lets it
        assert top < end
        assert bottom > 0


def test_what_a_link_leads_to_is_opened(browser, tmp_path):
    path = tmp_path / "report.html"
    path.write_text(run_page(tmp_path, knee(), "run"), encoding="utf-8")
    page = show(browser, path, folded=True)
    fold = page.find_element("css selector", "#parameters > details")
    assert fold.get_attribute("open") is None
    assert len(page.find_element("tag name", "body").text.split()) < 1200
    page.find_element("css selector", 'nav a[href="#parameters"]').click()
    until(lambda: fold.get_attribute("open") is not None)


def test_the_skip_link_is_the_first_stop(run):
    run.find_element(By.TAG_NAME, "body").send_keys(Keys.TAB)
    first = run.switch_to.active_element
    assert first.get_attribute("class") == "skip"
    assert first.rect["x"] >= 0
    first.send_keys(Keys.ENTER)
    assert run.execute_script("return location.hash") == "#main"


@pytest.mark.parametrize("name", ["run.html", "compare.html", "fleet.html"])
def test_a_phone_needs_no_sideways_scrolling(browser, pages, name):
    show(browser, pages / name, width=380, height=800)
    widest = browser.execute_script(
        "return [document.documentElement.scrollWidth, document.body.scrollWidth]"
    )
    assert max(widest) <= 380
    # what is wider scrolls by itself, also by keyboard
    for box in browser.find_elements(By.CSS_SELECTOR, ".scroll, .card"):
        assert box.get_attribute("tabindex") == "0"
        assert box.rect["width"] <= 380


@pytest.mark.parametrize("width", [390, 800, 1000, 1200, 1440])
def test_no_table_of_parameters_is_cut(browser, tmp_path, width):
    """With every column that there is; on a phone it scrolls by itself."""
    told = copy.deepcopy(every_kind()) | {"model_error": {"shown": True}}
    for row in told["parameters"].values():
        low, high = row["interval"]
        wider = {"model_error_interval": [low - 0.1, high + 0.1], "model_error_sd": row["sd"] + 0.1}
        row |= wider | {"white_interval": [low, high], "white_sd": row["sd"], "prior_sd": 123.456}
        row |= {"prior": "halfnorm(loc=0, scale=0.123)", "prior_default": True}
    page = tmp_path / "run.html"
    page.write_text(run_page(tmp_path, told, "run"), encoding="utf-8")
    show(browser, page, width=width)
    boxes = browser.execute_script(
        "return [...document.querySelectorAll('#parameters .scroll')].map("
        "one => [one.scrollWidth, one.clientWidth])"
    )
    assert len(boxes) >= 3
    assert all(room <= width for _, room in boxes)
    if width > 600:
        assert [wide for wide, room in boxes if wide > room] == []


@pytest.mark.parametrize(
    ("name", "dark"),
    [("run.html", False), ("run.html", True), ("compare.html", False), ("fleet.html", True)],
)
@needs_axe
def test_nothing_keeps_anybody_out(browser, pages, name, dark):
    show(browser, pages / name, dark=dark)
    assert barriers(browser) == []


def test_it_prints(page):
    printed = page.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})
    pdf = base64.b64decode(printed["data"])
    assert pdf.startswith(b"%PDF-")
    assert len(re.findall(rb"/Type\s*/Page\b", pdf)) >= 2
