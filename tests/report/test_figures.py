"""What holds for every figure: size, fonts, bytes, units."""

import re

import matplotlib
import pytest
from matplotlib import pyplot

from bayesfric.report.figures.registry import RUN_FIGURES
from bayesfric.report.figures.style import COLUMN, PAGE, mathtext, save
from bayesfric.report.summary.summary import summarise

CASES = [
    *((stem, "knee") for stem in ("friction", "residual", "ridge", "methods")),
    *((stem, fit) for stem in ("prediction", "corner") for fit in ("many", "slide")),
]


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
    """Printed size, TrueType fonts, units, same bytes."""
    fit = request.getfixturevalue(which)
    run = fit, summarise(fit)
    figure = RUN_FIGURES[stem].draw(*run)
    assert figure.get_figwidth() in (COLUMN, PAGE)
    assert figure.get_figheight() <= 9.2
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
