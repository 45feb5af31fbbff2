"""A figure is one file: what it declares reaches folder, captions and page."""

import sys

import pytest

from bayesfric.report import figures, run_directory
from bayesfric.report.figures import registry
from bayesfric.report.figures.registry import read_captions
from bayesfric.report.page.pages import run_page
from bayesfric.report.summary.summary import summarise

from .page_reader import read_page

FILE = """
from bayesfric.report.figures.registry import RunFigure
from bayesfric.report.figures.style import COLUMN, paper_figure


def draw(run):
    with paper_figure(COLUMN, 1.0) as figure:
        figure.subplots().set_xlabel(f"{len(run.fit.posterior.names)} parameters (–)")
    return figure


FIGURE = RunFigure(
    stem="made_up",
    title="Made up",
    section="friction",
    draw=draw,
    caption=lambda run: f"Torque of {run.fit.observations[0].name}: nothing is seen.",
)
"""


@pytest.fixture
def one_more(tmp_path, monkeypatch):
    """Put a file beside those of the package."""
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "made_up.py").write_text(FILE, encoding="utf-8")
    monkeypatch.setattr(figures, "__path__", [*figures.__path__, str(tmp_path / "more")])
    registry.run_figures.cache_clear()
    yield registry.run_figures()
    sys.modules.pop("bayesfric.report.figures.made_up", None)
    registry.run_figures.cache_clear()


def test_one_file_makes_a_figure(one_more, tmp_path, knee, monkeypatch):
    monkeypatch.setattr(run_directory, "FIGURES", {"made_up": one_more["made_up"]})
    run, summary = tmp_path / "run", summarise(knee)
    run_directory.write_run(run, knee, summary, "", [])
    files = {path.name for path in (run / "figures").iterdir()}
    assert files == {"made_up.svg"}
    caption = "Torque of run 0: nothing is seen."
    written = read_captions((run / "text" / "captions.md").read_text(encoding="utf-8"))
    assert written == {"made_up": caption}
    page = read_page(run_page(run, summary, "run"))
    (section,) = page.all("section", id="friction")
    (figure,) = section.all("figure", id="figure-made_up")
    assert caption in figure.text
    (drawing,) = figure.all("img")
    assert drawing.attrs["alt"].startswith("Made up. ")
