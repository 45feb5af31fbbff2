"""A real browser for tests of the pages: Debian's chromium, alone and quiet.

``AXE_CORE`` names the file ``axe.min.js`` of the npm package axe-core.
"""

import json
import os
import shutil
import time
from pathlib import Path

import pytest

webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
from selenium.webdriver.chrome.service import Service  # noqa: E402

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
AXE = Path(os.environ.get("AXE_CORE", "no-such-file"))
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-dev-shm-usage",
)  # fmt: skip

needs_browser = pytest.mark.skipif(
    not (BROWSER and DRIVER), reason="needs Debian's chromium and chromium-driver"
)
needs_axe = pytest.mark.skipif(
    not AXE.is_file(), reason="AXE_CORE does not name axe.min.js of axe-core"
)


def started(profile):
    """Start a browser that logs what it asks for."""
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    return webdriver.Chrome(options=options, service=Service(DRIVER))


def show(browser, path, *, dark=False, width=1280, height=900, folded=False):
    browser.get_log("browser")
    browser.get_log("performance")
    scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.get(path.as_uri())
    # tests do not wait for a page to glide
    browser.execute_script("document.documentElement.style.scrollBehavior = 'auto'")
    if not folded:
        script = "for (const one of document.querySelectorAll('details.part')) one.open = true"
        browser.execute_script(script)
    return browser


def until(true, seconds=10.0):
    end = time.monotonic() + seconds
    while not (found := true()):
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.05)
    return found


def events(browser, method):
    messages = [json.loads(one["message"])["message"] for one in browser.get_log("performance")]
    return [one["params"] for one in messages if one["method"] == method]


def barriers(browser):
    """Serious and critical violations that axe finds in what is shown."""
    browser.execute_script(AXE.read_text(encoding="utf-8"))
    browser.set_script_timeout(60)
    found = browser.execute_async_script(
        "const done = arguments[0]; axe.run(document, {resultTypes: ['violations']})"
        ".then(r => done(r.violations), e => done([{impact: 'critical', id: String(e)}]))"
    )
    return [
        (v["id"], v["help"], [n["target"] for n in v["nodes"]][:3])
        for v in found
        if v["impact"] in ("serious", "critical")
    ]
