"""What a run warns of: the first screen of its page and the terminal say the same."""

import copy

from bayesfric.commands.fit import fit_text
from bayesfric.report.alerts import alerts_of
from bayesfric.report.page.pages import run_page
from bayesfric.report.terminal import WIDTH, brief
from tests.report.made_summaries import FOUND, knee
from tests.report.page_reader import read_page


def same(page, summary):
    """Compare findings, and all that ``--verbose`` says, with those of the page."""
    read, terminal = read_page(page), "\n".join(fit_text(summary, verbose=True))
    (first,), (why,) = (read.all("section", id=one) for one in ("findings", "why"))
    lines = [line for line in terminal.splitlines() if line.startswith(("! ", "- "))]
    short = [text.removeprefix("! ").lower() for text in lines]
    listed = [item.text.lower() for item in first.all("li") if not item.text.startswith("and ")]
    told = brief(summary)
    assert listed == [line.lower() for line in told.findings]
    assert all(line in short for line in listed if len(line) < WIDTH - 2)
    for name in told.unidentified:
        assert name in first.text
        assert name in terminal
    flags = [next(p.all("span")).text for p in why.all("p") if p.attrs.get("class") == "flag"]
    for text in flags:
        assert text.removesuffix(".").lower() in [line[2:].lower() for line in lines]
    return flags


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


def test_what_makes_numbers_unsafe_comes_first(tmp_path):
    told = troubled()
    said = same(run_page(tmp_path, told, "knee"), told)
    kinds = [one.kind for one in alerts_of(told)]
    model = ["missing", "not white", "methods"]
    assert kinds == ["sampler", "of tomorrow", *model, "warning", "warning", "simulated"]
    assert said[0] == "R-hat 1.3."
    assert said[1] == "Of tomorrow: motor.inertia, motor.viscous."
    assert "Coarse (2 of 2 recordings)." in said
