"""What holds for every figure: size, fonts, bytes, labels, nothing cut off."""

import re

import matplotlib
import pytest
from matplotlib import pyplot
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.figures.posterior import corner_figure
from bayesfric.report.figures.forest import forest_figure
from bayesfric.report.figures.friction import friction_figure
from bayesfric.report.figures.prediction import prediction_figure
from bayesfric.report.figures.prediction import residual_figure
from bayesfric.report.figures.posterior import ridge_figure
from bayesfric.report.figures.style import (
    COLUMN,
    PAGE,
    mathtext,
    paper_style,
    save,
)
from bayesfric.report.summary.summary import summarise

FIGURES = {
    "friction": lambda fit, _: friction_figure(fit),
    "residual": lambda fit, _: residual_figure(fit),
    "ridge": lambda fit, _: ridge_figure(fit),
    "forest": lambda _, summary: forest_figure(comparison({"run": summary})),
    "prediction": lambda fit, _: prediction_figure(fit),
    "corner": corner_figure,
}
CASES = [
    *((stem, "knee") for stem in ("friction", "residual", "ridge", "forest")),
    *((stem, fit) for stem in ("prediction", "corner") for fit in ("many", "slide")),
]


def shown_texts(figure):
    """Every text that is drawn, with its box in pixels."""
    with paper_style():
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        renderer = canvas.get_renderer()
        found = []
        for text in figure.findobj(Text):
            if text.get_visible() and text.get_text():
                found.append((text, text.get_window_extent(renderer)))
    return found


def drawn_ticks(figure):
    """Identify the tick labels inside the limits: the others exist but are not drawn."""
    drawn = set()
    for ax in figure.axes:
        for axis in (ax.xaxis, ax.yaxis):
            low, high = sorted(axis.get_view_interval())
            for tick in axis.get_major_ticks():
                if low <= tick.get_loc() <= high:
                    drawn.add(id(tick.label1))
    return drawn


def nothing_cut_off(figure, upright=True):
    """All words are inside the figure, and none on another.

    ``upright``: rotated numbers have boxes larger than their ink, and may overlap.
    """
    ticks = {id(t.label1) for ax in figure.axes for a in (ax.xaxis, ax.yaxis) for t in a.majorTicks}
    drawn = drawn_ticks(figure)
    boxes = [(t, b) for t, b in shown_texts(figure) if id(t) not in ticks or id(t) in drawn]
    width, height = figure.bbox.size
    for text, box in boxes:
        inside = box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height
        assert inside, (text.get_text(), box)
    if upright:
        boxes = [(t, b) for t, b in boxes if t.get_rotation() in (0.0, 90.0)]
    for i, (text, box) in enumerate(boxes):
        for other, other_box in boxes[:i]:
            across = min(box.x1, other_box.x1) - max(box.x0, other_box.x0)
            up = min(box.y1, other_box.y1) - max(box.y0, other_box.y0)
            assert across <= 1.0 or up <= 1.0, (text.get_text(), other.get_text())


def fonts_embedded(pdf, width):
    """TrueType alone, and as many inches wide as it says."""
    content = pdf.read_bytes()
    kinds = set(re.findall(rb"/Subtype /(Type0|Type1|Type3|TrueType|CIDFontType\d)", content))
    assert b"Type0" in kinds or b"TrueType" in kinds
    assert not kinds & {b"Type3", b"Type1"}
    assert b"/FontFile2" in content
    names = set(re.findall(rb"/BaseFont /(?:[A-Z]{6}\+)?([\w-]+)", content))
    assert names <= {b"DejaVuSans", b"DejaVuSans-Oblique", b"DejaVuSansDisplay"}
    (box,) = re.findall(rb"/MediaBox \[\s*0 0 ([\d.]+) ", content)
    assert float(box) == pytest.approx(72 * width, abs=1e-3)


def has_unit(label):
    return re.search(r"\(.+\)$", label) is not None


@pytest.mark.parametrize(("stem", "which"), CASES)
def test_figures_for_papers(stem, which, request, tmp_path):
    """Printed size, nothing cut off or on top of each other, TrueType fonts, units, same bytes."""
    fit = request.getfixturevalue(which)
    summary = summarise(fit)
    figure = FIGURES[stem](fit, summary)
    assert figure.get_figwidth() in (COLUMN, PAGE)
    assert figure.get_figheight() <= 9.2
    nothing_cut_off(figure, upright=which != "knee")
    for ax in figure.axes:
        assert ax.get_xlabel() == "" or has_unit(ax.get_xlabel())
        # the density on the corner's diagonal has no scale
        density = stem == "corner" and ax.get_subplotspec().is_first_row()
        assert density or ax.get_ylabel() == "" or has_unit(ax.get_ylabel())
    save(figure, tmp_path, stem)
    fonts_embedded(tmp_path / f"{stem}.pdf", figure.get_figwidth())
    assert b"CreationDate" not in (tmp_path / f"{stem}.pdf").read_bytes()
    assert (tmp_path / f"{stem}.png").read_bytes().startswith(b"\x89PNG")
    # what may differ from one drawing to the next differs in all formats; this is the fastest
    again = tmp_path / "again.svg"
    with matplotlib.rc_context({"font.size": 20, "font.family": "serif", "axes.grid": True}):
        before = dict(matplotlib.rcParams)
        drawn = FIGURES[stem](fit, summary)
        assert dict(matplotlib.rcParams) == before
    with paper_style():
        drawn.savefig(again, format="svg", metadata={"Date": None})
    assert again.read_bytes() == (tmp_path / f"{stem}.svg").read_bytes()
    assert pyplot.get_fignums() == []


@pytest.mark.parametrize(
    ("symbol", "shown"),
    [
        # no LaTeX: the parameter's name instead
        ("J_{50%}", "50%.inertia"),
        ("J_{a}b}", "50%.inertia"),
    ],
)
def test_symbols(symbol, shown):
    assert mathtext(symbol, "50%.inertia") == shown
