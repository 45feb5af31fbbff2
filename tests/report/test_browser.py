"""The pages in a real browser: alone, under their policy, with the numbers of the summary."""

import json
import shutil
import time

import pytest

from bayesfric.commands.runs import compare

from .made_fleet import COUNT, WORN, write_fleet
from .made_summaries import knee, loaded, write_draws

webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
from selenium.webdriver.chrome.service import Service  # noqa: E402

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-dev-shm-usage",
)  # fmt: skip
pytestmark = pytest.mark.skipif(
    not (BROWSER and DRIVER), reason="needs Debian's chromium and chromium-driver"
)

CELLS = """
return [...document.querySelectorAll("table.parameters tr[data-name]")].map(
  row => [row.dataset.name, row.querySelector(".value").dataset.sort]);
"""
SORTED = """
const table = document.querySelector("table.sortable");
const head = table.tHead.rows[0].cells[0];
return ["ascending", "descending"].map(way => {
  head.querySelector("button").click();
  const names = [...table.tBodies[0].rows].map(row => row.cells[0].dataset.sort);
  return [head.getAttribute("aria-sort") === way, names];
});
"""
UNITS = """
const bodies = [...document.querySelectorAll("#units tbody")];
return bodies.flatMap(body => [...body.rows].map(row => row.cells[0].textContent));
"""
ADDED = """
const script = document.createElement("script");
script.textContent = "window.acted = 1";
const image = document.createElement("img");
image.src = "https://example.invalid/x.png";
document.body.append(script, image);
return window.acted;
"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """A browser that logs its requests."""
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(DRIVER))
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def pages(written_run, tmp_path_factory):
    """Copies of all pages in a folder that holds nothing else."""
    alone = tmp_path_factory.mktemp("alone")
    shutil.copyfile(written_run / "report.html", alone / "run.html")
    runs = tmp_path_factory.mktemp("runs")
    for name, summary in (("knee", knee()), ("loaded", loaded())):
        (runs / name).mkdir()
        (runs / name / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
        write_draws(runs / name / "posterior.nc", summary)
    compare([runs / "knee", runs / "loaded"], runs / "out")
    shutil.copyfile(runs / "out" / "report.html", alone / "compare.html")
    fleet = tmp_path_factory.mktemp("fleet")
    write_fleet(fleet)
    shutil.copyfile(fleet / "fleet.html", alone / "fleet.html")
    return alone


def events(browser, method):
    """Events of the network since the last call."""
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    return [message["params"] for message in messages if message["method"] == method]


@pytest.mark.parametrize("name", ["run.html", "compare.html", "fleet.html"])
def test_a_page_works_alone(browser, pages, written_run, name):
    for log in ("browser", "performance"):  # of the page before
        browser.get_log(log)
    browser.get((pages / name).as_uri())
    sortings = browser.execute_script(SORTED)
    for (marked, names), descending in zip(sortings, (False, True), strict=True):
        assert marked
        assert names == sorted(names, reverse=descending)
    if name == "run.html":
        summary = json.loads((written_run / "summary.json").read_text(encoding="utf-8"))
        rows = summary["parameters"] | summary["derived"]
        shown = {row: float(x) for row, x in browser.execute_script(CELLS) if x is not None}
        assert "total_drive.inertia" in shown
        assert shown == {row: rows[row]["median"] for row in shown}
    if name == "fleet.html":
        browser.refresh()
        units = browser.execute_script(UNITS)
        assert (len(units), units[0], units[-1]) == (COUNT + 1, WORN, "broken")
    assert browser.get_log("browser") == []
    requests = {event["request"]["url"] for event in events(browser, "Network.requestWillBeSent")}
    assert {url for url in requests if not url.startswith("data:")} == {browser.current_url}
    # the policy holds: a script and an image added to the page are refused
    assert browser.execute_script(ADDED) is None
    end, refused = time.monotonic() + 10.0, []
    while not refused and time.monotonic() < end:
        refused = events(browser, "Network.loadingFailed")
    assert [event["blockedReason"] for event in refused] == ["csp"]
