"""The page's calculator in a real browser gives what the model gives, and says where it cannot."""

import math
import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from bayesfric.identifiability.friction_curve import friction_torque
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.inverse import inverse_torque, load_reach, load_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.own_term import Term
from bayesfric.mechanism.presets import PRESETS
from bayesfric.mechanism.scaling import scalings
from bayesfric.recordings.inputs import AT_ROOM, steady
from bayesfric.report import calculator
from bayesfric.report.calculator import FILE, calculator_json, read_calculator, written
from bayesfric.report.page.pages import run_page

from .chromium import barriers, events, needs_axe, needs_browser, show, until
from .conftest import EVERYTHING, build
from .made_summaries import knee

pytest.importorskip("selenium", reason="selenium is not installed")
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

pytestmark = needs_browser

SLIDE = Joint(
    elements=(Element("slide", inertia=True, coulomb="symmetric", viscous=True, motion="linear"),),
    load=Load(motion="linear", inertia=True),
    offset=True,
)
ODD = Joint.preset("motor-axis").with_term(Term("motor.odd", lambda m: math.sin(m.position)))
# Of these no recording is needed: their parameters are any numbers.
DRAWN = ("everything", "own")
SEEN = {
    "speed": [-2.0, 2.0], "slowest": 0.1, "position": [-1.0, 1.0], "acceleration": [-9.0, 9.0],
    "load": [-1.0, 1.0], "outside": 3.0, "typical": [0.0, 1.0, 0.0],
}  # fmt: skip
SLOW = pytest.mark.slow  # terms that the kernels do not write out are compiled, each by itself
CHAINS = {
    **{name: preset.chain() for name, preset in PRESETS.items()},
    "everything": EVERYTHING,
    "gained": replace(PRESETS["servo-pendulum"].chain(), gain=True),
    "slide": SLIDE,
    "own": Joint.preset("motor-axis").with_term(
        Term("motor.ripple", lambda m: np.abs(m.speed) * np.cos(3 * m.position))
    ),
    "odd": ODD,
}
ALL = """
const found = [];
for (const asked of arguments[0]) {
  for (const [name, value] of Object.entries(asked)) {
    const input = document.getElementById(`ask-${name}`);
    if (!input) continue;
    input.value = String(value);
    input.dispatchEvent(new Event("change"));
  }
  const told = {};
  for (const one of document.querySelectorAll(".ask [data-answer], .ask tr[data-group]")) {
    const {value, low, high} = one.dataset;
    told[one.dataset.answer ?? one.dataset.group] = value === undefined ? null : [value, low, high].map(Number);
  }
  told.said = [...document.querySelectorAll(".told li")].map(one => one.textContent);
  found.push(told);
}
return found;
"""  # noqa: E501
LEVELS = (0.5, 0.05, 0.95)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("asked")


@pytest.fixture(scope="module")
def made(folder):
    """Give a chain's page, its fit, and what the page was made from, once it is asked for."""
    found = {}

    def of(name):
        if name not in found:
            fit = None
            if name in DRAWN:
                law = written(CHAINS[name], drawn(CHAINS[name]), SEEN, open_scale=False)
            else:
                fit = build(CHAINS[name], samples=300, ensembles=2, spread=0.05)
                law = calculator.calculator(fit)
            page = page_of(folder, name, calculator_json(law))
            found[name] = (page, fit, read_calculator(page.parent))
        return found[name]

    return of


def parameter_vectors(found):
    """Give the draws that a page holds as vectors of the joint, ``(n, n_parameters)``."""
    n = max((len(x) for x in found["values"] if isinstance(x, list)), default=1)
    columns = [np.broadcast_to(np.asarray(x), (n,)) for x in found["values"]]
    return np.stack(columns, axis=1)


def drawn(chain):
    return np.random.default_rng(11).uniform(0.1, 0.6, (300, len(chain.names)))


def page_of(folder, name, text):
    run = folder / name
    run.mkdir()
    (run / FILE).write_text(text, encoding="utf-8")
    (run / "report.html").write_text(run_page(run, knee(), name), encoding="utf-8")
    return run / "report.html"


def of_one(law, vector):
    """Return the same page data with one draw only."""
    return calculator_json(law | {"values": [float(x) for x in vector]})


def grid(chain):
    """Speeds of both signs, angles, loads of both signs, some with acceleration."""
    fast = 3.0 / chain.ratio if chain.ratio > 1 else 3.0
    rows = product((-fast, -0.1, 1e-3, 0.7 * fast), (-4.0, 0.0, 5.0), (-0.8, 1.3), (0.0, 2.5))
    return [dict(zip(("speed", "load", "position", "acceleration"), r, strict=True)) for r in rows]


def expected(chain, vectors, asked):
    """Return torque of every draw at every place ``(n, N)``, by the compiled inverse model."""
    columns = []
    for one in asked:
        inputs = replace(AT_ROOM, load_torque=steady(one["load"]))
        motion = ([one["position"]], [one["speed"]], [one["acceleration"]])
        columns.append(
            inverse_torque(chain, vectors, *motion, inputs=inputs, time=np.zeros(1))[:, 0]
        )
    return np.stack(columns, axis=1)


@pytest.mark.parametrize(
    "name",
    [
        *PRESETS,
        "gained",
        *(pytest.param(one, marks=SLOW) for one in ("slide", "own", "everything")),
    ],
)
def test_the_numbers_are_the_models(browser, made, name):
    path, fit, law = made(name)
    chain = CHAINS[name]
    asked = grid(chain)
    vectors = parameter_vectors(law)
    assert len(vectors) == 300
    show(browser, path)
    answered = browser.execute_script(ALL, asked)
    recorded = expected(chain, vectors, asked)
    # what the motor needs is the true torque, what is recorded that over the gain
    gain = vectors[:, [chain.names.index("drive.gain")]] if chain.gain else 1.0
    for key, draws in {"torque": gain * recorded, "recorded": recorded}.items():
        if key == "recorded" and not chain.gain:
            assert key not in answered[0]
            continue
        found = np.array([one[key] for one in answered])
        torque = np.quantile(draws, LEVELS, axis=0).T
        assert np.abs(found - torque).max() <= 1e-6 * np.abs(torque).max()
        assert found == pytest.approx(torque, rel=1e-6, abs=1e-9)
    # draws are those of the posterior, to the digits that are kept
    if fit is not None:
        own = fit.target.chain_values(fit.posterior.flat(300))
        assert vectors == pytest.approx(own, rel=1e-6)


@pytest.mark.parametrize("name", ["rabbit-knee", "servo-pendulum", "motor-axis", "gained"])
def test_friction_is_that_of_the_friction_figure(browser, made, name):
    """At constant speed: what a load-free law leaves, the mean load where its scale is open."""
    path, fit, law = made(name)
    chain = fit.chain
    assert law["open_scale"] == (name == "rabbit-knee")
    vectors = parameter_vectors(law)[:1]
    show(browser, page_of(path.parent.parent, f"{name}-one", of_one(law, vectors[0])))
    asked = [one | {"acceleration": 0.0} for one in grid(chain)]
    for one, told in zip(asked, browser.execute_script(ALL, asked), strict=True):
        sign = np.sign(one["speed"])
        inputs = replace(AT_ROOM, load_torque=steady(one["load"]))
        gamma = load_torque(
            chain, vectors[0], [one["position"]], [0.0], inputs=inputs, time=np.zeros(1)
        )
        load = sign * gamma * load_reach(chain, vectors, open_scale=law["open_scale"])
        speed = np.array([one["speed"] * chain.ratio])
        friction = sign * friction_torque(chain, vectors, speed, load, open_scale=law["open_scale"])
        offset = vectors[0][chain.names.index("offset")] if "offset" in chain.names else 0.0
        assert told["friction"][0] == pytest.approx(float(friction[0, 0]), abs=1e-9)
        assert told["torque"][0] == pytest.approx(
            float(friction[0, 0] + sign * load[0]) + offset, abs=1e-9
        )


def test_the_parts_make_up_the_torque(browser, made):
    for name in ("rabbit-knee", "servo-pendulum"):
        path, _, law = made(name)
        vector = parameter_vectors(law)[7]
        show(browser, page_of(path.parent.parent, f"{name}-sum", of_one(law, vector)))
        for told in browser.execute_script(ALL, grid(CHAINS[name])):
            parts = [x[0] for key, x in told.items() if key not in ("torque", "friction", "said")]
            assert sum(parts) == pytest.approx(told["torque"][0], abs=1e-9)


def test_no_line_depends_on_an_open_scale(browser, made):
    """All members of the paper's ridge give the same table: alpha and leg scaled together."""
    path, fit, law = made("rabbit-knee")
    vector = parameter_vectors(law)[3]
    (scaling,) = scalings(fit.chain)
    moved = scaling.scaled(vector, 1.15)
    assert np.abs(moved / vector - 1.0).max() > 0.1
    asked = [one | {"load": 0.0} for one in grid(fit.chain)]
    told = []
    for k, one in enumerate((vector, moved)):
        show(browser, page_of(path.parent.parent, f"ridge-{k}", of_one(law, one)))
        told.append(browser.execute_script(ALL, asked))
        assert "mean of what the motor feels" in browser.page_source
    for here, there in zip(*told, strict=True):
        for key in here.keys() - {"said"}:
            assert here[key] == pytest.approx(there[key], abs=1e-9), key


def test_rest_has_no_answer_and_says_so(browser, made):
    show(browser, made("rabbit-knee")[0])
    place = {"load": 1.0, "position": 0.1, "acceleration": 0.0}
    (told,) = browser.execute_script(ALL, [place | {"speed": 0}])
    (said,) = told.pop("said")
    assert said.startswith("At rest friction has no one value")
    assert set(told.values()) == {None}
    # the motor holds it with what moves it neither way
    slow = browser.execute_script(ALL, [place | {"speed": speed} for speed in (-1e-9, 1e-9)])
    ends = re.search(r"from (\S+) to (\S+) N", said.replace("−", "-")).groups()
    step = 10.0 ** -len(ends[0].partition(".")[2])
    assert [float(x) for x in ends] == pytest.approx(
        sorted(one["torque"][0] for one in slow), abs=0.6 * step
    )
    (told,) = browser.execute_script(ALL, [place | {"speed": ""}])
    assert told["said"] == ["Give a number for Speed (rad/s)."]
    assert told["torque"] is None
    assert browser.find_element(By.ID, "ask-speed").get_attribute("aria-invalid") == "true"
    (told,) = browser.execute_script(ALL, [place | {"speed": 1.0}])
    assert told["torque"] is not None


def test_it_says_where_the_data_never_were(browser, made):
    path, fit, law = made("rabbit-knee")
    seen = law["seen"]
    (o,) = fit.observations
    assert seen["speed"] == [o.speed.min(), o.speed.max()]
    assert seen["slowest"] >= 0.2  # the dead zone of its processing
    show(browser, path)
    inside = {"speed": 1.0, "position": np.mean(seen["position"]), "acceleration": 0.0, "load": 0.0}
    for change, words in (
        ({}, []),
        ({"speed": 1.01 * seen["speed"][1]}, ["at this speed"]),
        ({"speed": 1.01 * seen["speed"][0]}, ["at this speed"]),
        ({"speed": 0.5 * seen["slowest"]}, ["this slow"]),
        ({"position": seen["position"][1] + 0.01}, ["at this angle"]),
        ({"acceleration": 1.5 * seen["acceleration"][0]}, ["at this acceleration", "at this load"]),
        ({"load": 3.0 * seen["outside"]}, ["at this load", "besides its own"]),
    ):
        (told,) = browser.execute_script(ALL, [inside | change])
        assert len(told["said"]) == len(words), told["said"]
        assert all(word in line for word, line in zip(words, told["said"], strict=True))


def test_a_term_it_does_not_know_gives_no_calculator(browser, made):
    path, _, law = made("odd")
    assert law["missing"] == "motor.odd"
    show(browser, path)
    section = browser.find_element(By.ID, "calculator")
    assert "motor.odd is a term that the page’s script does not know" in section.text
    assert not section.find_elements(By.TAG_NAME, "input")
    assert browser.get_log("browser") == []


def test_it_is_used_by_keyboard_and_tells_who_cannot_see(browser, made):
    page = show(browser, made("servo-pendulum")[0])
    speed = page.find_element(By.ID, "ask-speed")
    live = page.find_element(By.CSS_SELECTOR, ".answers-now")
    assert live.get_attribute("aria-live") == "polite"
    torque = page.find_element(By.CSS_SELECTOR, "[data-answer=torque]")
    before = torque.get_attribute("data-value")
    speed.send_keys(Keys.HOME, "-")
    until(lambda: torque.get_attribute("data-value") != before)
    assert float(torque.get_attribute("data-value")) < 0.0 < float(before)
    # what stands there is the number, in the digits that its band allows
    shown = torque.find_element(By.TAG_NAME, "b").text.replace("−", "-")
    last = 10.0 ** -len(shown.partition(".")[2])
    assert float(shown) == pytest.approx(float(torque.get_attribute("data-value")), abs=0.51 * last)
    slider = page.find_element(By.CSS_SELECTOR, "[data-slider=load]")
    before = torque.get_attribute("data-value")
    slider.send_keys(Keys.ARROW_RIGHT)
    until(lambda: torque.get_attribute("data-value") != before)
    at = page.find_element(By.ID, "ask-load").get_attribute("value")
    assert float(at) == float(slider.get_attribute("value")) != 0.0
    for control in page.find_elements(By.CSS_SELECTOR, ".ask input"):
        assert control.accessible_name


@needs_axe
@pytest.mark.parametrize("dark", [False, pytest.param(True, marks=SLOW)])
def test_it_keeps_nobody_out(browser, made, dark):
    show(browser, made("everything")[0], dark=dark)
    assert barriers(browser) == []


def test_it_asks_nobody_and_fits_a_phone(browser, made):
    path, _, _ = made("everything")
    page = show(browser, path, width=360, height=740)
    page.execute_script(ALL, grid(EVERYTHING)[:2])
    asked = [one["request"]["url"] for one in events(page, "Network.requestWillBeSent")]
    assert [url for url in asked if not url.startswith("data:")] == [page.current_url]
    assert page.get_log("browser") == []
    assert page.execute_script("return document.documentElement.scrollWidth") <= 360
    assert path.stat().st_size < 500_000  # and figures come on top of that
