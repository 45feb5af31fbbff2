"""What holds for every figure: size, fonts, bytes, labels, nothing cut off."""

import re

import matplotlib
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.figures.corner import corner_figure
from bayesfric.report.figures.forest import forest_figure
from bayesfric.report.figures.friction import friction_figure
from bayesfric.report.figures.prediction import prediction_figure
from bayesfric.report.figures.residual import residual_figure
from bayesfric.report.figures.ridge import ridge_figure
from bayesfric.report.figures.style import (
    COLUMN,
    PAGE,
    mathtext,
    paper_style,
    save,
)
from bayesfric.report.summary.summary import summarise


def draw_corner(fit):
    return corner_figure(fit, summarise(fit))


DRAW = {"corner": draw_corner, "prediction": prediction_figure}
figures = pytest.mark.parametrize("draw", DRAW.values(), ids=DRAW.keys())


@pytest.fixture(scope="module")
def drawn_once(request):
    """Draw a figure of a fit, once for all tests that only look at it."""
    kept = {}

    def of(draw, which):
        if (draw, which) not in kept:
            kept[draw, which] = draw(request.getfixturevalue(which))
        return kept[draw, which]

    return of


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


@figures
@pytest.mark.parametrize("which", ["many", "slide"])
def test_a_page_wide_and_nothing_cut_off(draw, which, drawn_once):
    figure = drawn_once(draw, which)
    assert figure.get_figwidth() == PAGE
    assert figure.get_figheight() <= 9.0
    nothing_cut_off(figure)


@figures
def test_fonts_are_embedded_truetype(draw, drawn_once, tmp_path):
    save(drawn_once(draw, "many"), tmp_path, "figure")
    fonts_embedded(tmp_path / "figure.pdf", PAGE)
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")


@figures
def test_same_fit_same_bytes_whatever_the_readers_style(draw, slide, tmp_path):
    save(draw(slide), tmp_path, "one")
    with matplotlib.rc_context({"font.size": 20, "font.family": "serif", "axes.grid": True}):
        before = dict(matplotlib.rcParams)
        save(draw(slide), tmp_path, "two")
        assert dict(matplotlib.rcParams) == before
    for suffix in ("pdf", "svg", "png"):
        one, two = ((tmp_path / f"{name}.{suffix}").read_bytes() for name in ("one", "two"))
        assert one == two
    assert b"CreationDate" not in (tmp_path / "one.pdf").read_bytes()
    assert b"dc:date" not in (tmp_path / "one.svg").read_bytes()


FOR_PAPERS = {
    "friction": lambda fit, _: friction_figure(fit),
    "residual": lambda fit, _: residual_figure(fit),
    "ridge": lambda fit, _: ridge_figure(fit),
    "forest": lambda _, summary: forest_figure(comparison({"run": summary})),
}


@pytest.mark.parametrize("stem", FOR_PAPERS)
def test_figures_for_papers(stem, knee, tmp_path):
    """Printed size, nothing cut off or on top of each other, TrueType fonts, units, no title."""
    summary = summarise(knee)
    figure = FOR_PAPERS[stem](knee, summary)
    assert figure.get_figwidth() in (COLUMN, PAGE)
    nothing_cut_off(figure, upright=False)
    for ax in figure.axes:
        assert ax.get_title() == ""
        assert ax.get_xlabel() == "" or has_unit(ax.get_xlabel())
        assert ax.get_ylabel() == "" or has_unit(ax.get_ylabel())
    save(figure, tmp_path, stem)
    fonts_embedded(tmp_path / f"{stem}.pdf", figure.get_figwidth())
    # what may differ from one drawing to the next differs in all formats; this is the fastest
    again = tmp_path / "again.svg"
    with matplotlib.rc_context({"font.size": 20, "font.family": "serif", "axes.grid": True}):
        drawn = FOR_PAPERS[stem](knee, summary)
    with paper_style():
        drawn.savefig(again, format="svg", metadata={"Date": None})
    assert again.read_bytes() == (tmp_path / f"{stem}.svg").read_bytes()


def has_unit(label):
    return re.search(r"\(.+\)$", label) is not None


@pytest.mark.parametrize("which", ["many", "slide"])
@figures
def test_every_axis_says_its_unit(draw, which, drawn_once):
    for ax in drawn_once(draw, which).axes:
        place = ax.get_subplotspec()
        if place.is_last_row():
            assert has_unit(ax.get_xlabel()), ax.get_xlabel()
        # the density on the corner's diagonal has no scale
        if place.is_first_col() and not (draw is draw_corner and place.is_first_row()):
            assert has_unit(ax.get_ylabel()) or (draw is draw_corner and ax.get_ylabel() == "")


def test_no_pyplot_figure_is_left_open(drawn_once):
    from matplotlib import pyplot

    for draw in DRAW.values():
        drawn_once(draw, "many")
    assert pyplot.get_fignums() == []


@pytest.mark.parametrize(
    ("symbol", "shown"),
    [
        ("J_{m}", "$J_{m}$"),
        (r"\mu_{}", r"$\mu$"),
        (r"\dot q_{0,m}", r"$\dot q_{0,m}$"),
        ("C_{gearbox1}", r"$C_{\mathrm{gearbox1}}$"),
        ("f_{3,left_arm}", r"$f_{3,\mathrm{left\_arm}}$"),
        (r"J_{\mathrm{x}}", r"$J_{\mathrm{x}}$"),
        # no LaTeX: the parameter's name instead
        ("J_{50%}", "50%.inertia"),
        ("J_{a}b}", "50%.inertia"),
    ],
)
def test_symbols(symbol, shown):
    assert mathtext(symbol, "50%.inertia") == shown
