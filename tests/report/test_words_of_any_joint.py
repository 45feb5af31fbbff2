"""Arms and wheels have no leg: what a run writes speaks of the load, but for the paper's knee."""

import html
import re
from importlib.resources import files

import pytest

from bayesfric.report.paper.tables import latex_texts, summary_texts
from bayesfric.report.summary.summary import summarise
from bayesfric.report.terminal import fit_text

_PAPERS_OWN = re.compile(r"knee of the robot Rabbit|robot Rabbit's knee")
_LIMB = re.compile(r"\b(legs?|knees?)\b", re.IGNORECASE)


def limbs(text):
    plain = re.sub(r"<(script|style).*?</\1>|<[^>]*>", " ", text, flags=re.DOTALL)
    return _LIMB.findall(_PAPERS_OWN.sub("", re.sub(r"\s+", " ", html.unescape(plain))))


def test_what_a_run_writes(written_run):
    texts = [*written_run.glob("*.html"), *written_run.rglob("*.md"), *written_run.rglob("*.txt")]
    assert texts
    for path in texts:
        assert not limbs(path.read_text(encoding="utf-8")), path.name


def test_what_a_paper_and_a_terminal_are_told(knee):
    summary = summarise(knee)
    every = {"terminal": "\n".join(fit_text(summary))}
    every |= latex_texts(summary, "run") | summary_texts(summary, "run")
    for name, text in every.items():
        assert not limbs(text), name


TEMPLATES = [
    one
    for package in ("bayesfric.report", "bayesfric.report.page")
    for one in (files(package) / "templates").iterdir()
    if one.name.endswith(".j2")
]


@pytest.mark.parametrize("template", TEMPLATES, ids=lambda one: one.name)
def test_templates(template):
    words = re.sub(r"\{#.*?#\}", "", template.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert not limbs(words)
