"""`explain` on the command line and in Python, on a SIMULATED recording that lacks a term."""

import json
from pathlib import Path

import pytest

import bayesfric as bf
from bayesfric.report.numbers import text_value

from .bench import has, recorded

JOINT = '[mechanism]\npreset = "motor-axis"\n'
BY_DIRECTION = '[mechanism.elements.motor]\nviscous = "by-direction"\n'
SIMULATION = """
[simulation]
duration = 12
rate = 500
excitation = "multisine"
amplitude = 1.5
torque_noise = 0.02
encoder_side = "joint"

[simulation.parameters]
"motor.inertia" = 0.05
"motor.viscous_positive" = 0.2
"motor.viscous_negative" = 0.3
"motor.coulomb" = 0.2
"offset" = 0.05
"""


@pytest.fixture
def swing(bench):
    bench.simulated(JOINT + BY_DIRECTION + SIMULATION)
    bench.config(JOINT + recorded())
    return bench


def test_what_is_missing_is_named_first_with_what_to_write(swing):
    text = swing.run("explain", "c.toml").out
    assert text.startswith("These recordings ask for a term that the model lacks")
    first = text.splitlines()[:4]
    assert '   Write under [mechanism.elements.motor]: viscous = "by-direction"' in first
    assert len(text.splitlines()) < 30
    found = json.loads(swing.run("explain", "c.toml", "--json").out)
    (term,) = found["asked"]
    assert term["setting"] == 'mechanism.elements.motor.viscous = "by-direction"'
    before, after = found["models"][:2]
    assert after["held_out"] < before["held_out"]
    # what was put in, by the fit with the term
    for name, value in (("motor.viscous_positive", 0.2), ("motor.viscous_negative", 0.3)):
        number = after["numbers"][name]
        assert abs(number["value"] - value) < 4.0 * number["sd"]
        assert number["unit"] == "N m s"
        # and beside the term, where they are looked for
        printed = text_value(number["value"], number["sd"])
        assert any(f"{name} = {printed} N m s" in line for line in first)
    falls = f"from {before['held_out']:.3g} to {after['held_out']:.3g} N m"
    assert falls in first[0]


def test_python_returns_what_the_command_prints(swing):
    printed = json.loads(swing.run("explain", "c.toml", "--json").out)
    found = bf.Model.from_config("c.toml").explain()
    assert found.as_json() == {k: v for k, v in printed.items() if k != "config"}
    assert list(found.frame["held_out"]) == [m.held_out for m in found.models]


def test_a_model_that_lacks_nothing_is_told_so(swing):
    swing.config(JOINT + BY_DIRECTION + recorded())
    text = swing.run("explain", "c.toml").out
    assert text.startswith("These recordings ask for none of the")


def test_the_figure_is_written_and_nothing_else(swing):
    before = swing.held()
    swing.run("explain", "c.toml", "-o", "ladder.pdf")
    assert {p.name for p in swing.folder.iterdir()} - {Path(p).name for p in before} == {
        "ladder.pdf",
        "ladder.png",
        "ladder.svg",
    }
    assert (swing.folder / "ladder.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize("name", ["ladder.txt", "c.toml/ladder.pdf"])
def test_a_place_that_cannot_be_is_refused_before_anything(swing, name):
    has(swing.refused("explain", "c.toml", "-o", name), name)


def test_too_short_is_refused_with_the_mend(swing):
    more = '[processing]\ndecimate = 100\nband = "2 Hz"\n'
    swing.config(JOINT + recorded() + more)
    has(
        swing.refused("explain", "c.toml"),
        "too few to tell what a model lacks",
        "of such motion",
    )


@pytest.mark.usefixtures("no_figures")
def test_a_fit_of_too_few_outputs_to_explain_is_made_and_says_so(swing):
    more = '[processing]\ndecimate = 100\nband = "2 Hz"\n'
    swing.config(JOINT + recorded() + more)
    done = swing.run("fit", "c.toml", "-o", "run", "--explain")
    assert done.code in (0, 3), done.err
    summary = json.loads((swing.folder / "run" / "summary.json").read_text())
    (told,) = (one for one in summary["warnings"] if "was not asked" in one)
    assert "too few to tell what a model lacks" in told
    assert summary.get("explanation") is None


@pytest.mark.usefixtures("no_figures")
def test_a_fit_says_it_when_asked_and_its_page_holds_it(swing):
    done = swing.run("fit", "c.toml", "-o", "run", "--explain")
    assert done.code in (0, 3), done.err
    summary = json.loads((swing.folder / "run" / "summary.json").read_text())
    (term,) = summary["explanation"]["asked"]
    assert term["setting"] == 'mechanism.elements.motor.viscous = "by-direction"'
    page = (swing.folder / "run" / "report.html").read_text()
    assert 'id="lacking"' in page
    assert "viscous loss by direction" in page
    # the page is made again from the file alone
    swing.run("report", "run")
    assert (swing.folder / "run" / "report.html").read_text().count('id="lacking"') == 1


def test_what_a_fit_finds_is_what_would_put_it_in(swing):
    found = bf.Model.from_config("c.toml").fit().summary.findings
    assert [one.kind for one in found] == ["viscous_by_direction"]
    assert found[0].hint == 'mechanism.elements.motor.viscous = "by-direction"'
    # with the term there is nothing left to tell
    swing.config(JOINT + BY_DIRECTION + recorded())
    assert not bf.Model.from_config("c.toml").fit().summary.findings
