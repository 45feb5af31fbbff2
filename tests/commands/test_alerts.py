"""What a run warns of: the first screen of its page and the terminal say the same."""

import copy

import pytest

from bayesfric.commands.fit import fit_text
from bayesfric.report.alerts import alerts_of
from bayesfric.report.page.run_page import run_page
from tests.report.made_summaries import FOUND, knee
from tests.report.page_reader import read_page

from .bench import JOINT, recorded

QUADRATIC = "[mechanism.elements.motor]\nquadratic = true\n"
CONFIG = f"""{JOINT}{QUADRATIC}{recorded("one")}{recorded("two")}
[processing]
lowpass = "80 Hz"
decimate = 2

[sampling]
min_ess = 200
seed = 3
walkers = 24
ensembles = 2

[noise]
model = "white"

[validation]
hold_out = 0.3

[simulation]
duration = 8.0
rate = 200
excitation = "multisine"
encoder_counts = 1048576
parameters = {{ "motor.quadratic" = 0.1 }}
"""


def on_page(text):
    """The flags of the first screen, and the parameters it leaves open."""
    (first,) = read_page(text).all("section", id="findings")
    flags = [next(p.all("span")).text for p in first.all("p") if p.attrs.get("class") == "flag"]
    names = [code.text for p in first.all("p", **{"class": "names"}) for code in p.all("code")]
    return flags, names


def on_terminal(text):
    """What it warns of, and the parameters it calls undetermined."""
    lines = text.splitlines()
    problems = []
    for line in lines[1:]:
        if not line.startswith("  "):
            break
        problems.append(line.strip())
    warned = [line.removeprefix("WARNING: ") for line in lines if line.startswith("WARNING: ")]
    return problems + warned, [line.split()[0] for line in lines if "NOT determined" in line]


def same(page, terminal):
    flags, left = on_page(page)
    said, open_ = on_terminal(terminal)
    assert [text.removesuffix(".").lower() for text in flags] == [text.lower() for text in said]
    if "No intervals" not in terminal:
        assert set(left) == set(open_)
    return said


@pytest.mark.usefixtures("no_figures")
def test_page_and_terminal_warn_of_the_same(bench):
    bench.simulated(CONFIG, "one")
    bench.simulated(CONFIG, "two", seed=4)
    bench.config(CONFIG.replace(QUADRATIC, ""))
    ended = bench.run("fit", "c.toml", "-o", "run")
    assert ended.code == 3, ended  # numbers are doubted
    page = (bench.folder / "run" / "report.html").read_text(encoding="utf-8")
    said = same(page, ended.out)
    assert any("friction with the square of speed explains" in text for text in said)
    assert any("simulated" in text for text in said)


def troubled():
    told = copy.deepcopy(knee())
    told["sampler"] = {
        "status": "tentative", "problems": ["R-hat 1.3"], "min_ess": 90.0, "max_rhat": 1.3,
        "seconds": 1.0,
    }  # fmt: skip
    told["doubts"] = [{"kind": "of tomorrow", "parameters": ["motor.inertia", "motor.viscous"]}]
    told["fit"]["recordings"] = {"a": {}, "b": {}}
    told["findings"] = [FOUND | {"severity": "note"}]
    told["noise"]["innovation_whiteness"] = {"white": False, "p_value": 0.03}
    told["estimates"]["least-squares"]["parameters"]["total.inertia"]["value"] *= 1.1
    told["warnings"] = ["a: coarse", "b: coarse", "something else"]
    told["identifiability"] = {"null_directions": []}
    told["may_be_simulated"] = True
    return told


@pytest.mark.parametrize("status", ["tentative", "unusable"])
def test_what_makes_numbers_unsafe_comes_first(tmp_path, status):
    told = troubled()
    told["sampler"]["status"] = status
    said = same(run_page(tmp_path, told, "knee"), "\n".join(fit_text(told)))
    kinds = [one.kind for one in alerts_of(told)]
    model = ["missing", "not white", "methods"] if status == "tentative" else []
    assert kinds == ["sampler", "of tomorrow", *model, "warning", "warning", "simulated"]
    assert said[0] == "R-hat 1.3"
    assert said[1] == "of tomorrow: motor.inertia, motor.viscous"
    assert "coarse (2 of 2 recordings)" in said
