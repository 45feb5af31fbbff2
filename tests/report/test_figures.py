"""What holds for every figure: size, fonts, bytes, labels, nothing cut off."""

import re

import matplotlib
import pytest
from matplotlib import pyplot
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from bayesfric.report.figures.registry import RUN_FIGURES
from bayesfric.report.figures.style import COLUMN, PAGE, mathtext, paper_style, save
from bayesfric.report.summary.summary import summarise

CASES = [
    *((stem, "knee") for stem in ("friction", "residual", "ridge", "methods")),
    *((stem, fit) for stem in ("prediction", "corner") for fit in ("many", "slide")),
]


def texts(figure):
    """Give every text that is drawn, with its box in pixels."""
    hidden = set()
    for axis in (axis for ax in figure.axes for axis in (ax.xaxis, ax.yaxis)):
        low, high = sorted(axis.get_view_interval())
        hidden |= {t.label1 for t in axis.get_major_ticks() if not low <= t.get_loc() <= high}
    with paper_style():
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        return [
            (text, text.get_window_extent(canvas.get_renderer()))
            for text in figure.findobj(Text)
            if text.get_visible() and text.get_text() and text not in hidden
        ]


def nothing_cut_off(figure, upright):
    """All words are inside the figure, and none on another.

    ``upright``: rotated numbers have boxes larger than their ink, and may overlap.
    """
    boxes = texts(figure)
    width, height = figure.bbox.size
    for text, box in boxes:
        assert box.x0 >= 0, text
        assert box.y0 >= 0, text
        assert box.x1 <= width, text
        assert box.y1 <= height, text
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
    assert kinds & {b"Type0", b"TrueType"}
    assert not kinds & {b"Type3", b"Type1"}
    names = set(re.findall(rb"/BaseFont /(?:[A-Z]{6}\+)?([\w-]+)", content))
    assert names <= {b"DejaVuSans", b"DejaVuSans-Oblique", b"DejaVuSansDisplay"}
    (box,) = re.findall(rb"/MediaBox \[\s*0 0 ([\d.]+) ", content)
    assert float(box) == pytest.approx(72 * width, abs=1e-3)


@pytest.mark.parametrize(("stem", "which"), CASES)
def test_figures_for_papers(stem, which, request, tmp_path):
    """Printed size, nothing cut off or on top of each other, TrueType fonts, units, same bytes."""
    fit = request.getfixturevalue(which)
    run = fit, summarise(fit)
    figure = RUN_FIGURES[stem].draw(*run)
    assert figure.get_figwidth() in (COLUMN, PAGE)
    assert figure.get_figheight() <= 9.2
    nothing_cut_off(figure, upright=which != "knee")
    for ax in figure.axes:
        # the density on the corner's diagonal has no scale
        density = stem == "corner" and ax.get_subplotspec().is_first_row()
        for label in [ax.get_xlabel()] + [ax.get_ylabel()] * (not density):
            assert label == "" or re.search(r"\(.+\)$", label)
    save(figure, tmp_path, stem)
    fonts_embedded(tmp_path / f"{stem}.pdf", figure.get_figwidth())
    assert b"CreationDate" not in (tmp_path / f"{stem}.pdf").read_bytes()
    assert (tmp_path / f"{stem}.png").read_bytes().startswith(b"\x89PNG")
    # what may differ from one drawing to the next differs in all formats; this is the fastest
    with matplotlib.rc_context({"font.size": 20, "font.family": "serif", "axes.grid": True}):
        before = dict(matplotlib.rcParams)
        save(RUN_FIGURES[stem].draw(*run), tmp_path, "again", ("svg",))
        assert dict(matplotlib.rcParams) == before
    assert (tmp_path / "again.svg").read_bytes() == (tmp_path / f"{stem}.svg").read_bytes()
    assert pyplot.get_fignums() == []


@pytest.mark.parametrize("symbol", ["J_{50%}", "J_{a}b}"])
def test_a_symbol_that_is_no_latex_is_the_parameters_name(symbol):
    assert mathtext(symbol, "50%.inertia") == "50%.inertia"
