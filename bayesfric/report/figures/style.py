"""Style of all figures: widths, fonts and colours of a two-column paper."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.mathtext import MathTextParser
from matplotlib.ticker import MaxNLocator, ScalarFormatter
from numpy.typing import NDArray

Array = NDArray[np.float64]
LineStyle = Literal["solid"] | tuple[float, Sequence[float]]
Look = dict[str, Any]  # what Matplotlib takes by name

# Inches; one and two columns of the IEEE and IFAC layouts.
COLUMN = 3.5
PAGE = 7.16

SMALL = 7.0  # points, of ticks, legends and remarks
WORDS = 6.0  # of words inside small panels

# Distinct for every common colour vision, and by lightness (CIE L* 14, 35, 53, 73)
# once a page is copied in grey.
PALETTE = ("#12233f", "#0a5694", "#cb631a", "#62b8e2")
MEASURED = "#3a3a3a"
BAND = "#a9d3ec"
PRIOR = PALETTE[2]
POSTERIOR = PALETTE[1]
# What the data leave open is hatched, never a plain band.
OPEN_HATCH = "//////"
DASHED: LineStyle = (0, (4.0, 1.5))
DOTTED: LineStyle = (0, (1.0, 1.2))

_TICKS = {
    "labelsize": SMALL, "direction": "in", "major.width": 0.5, "major.size": 2.5, "major.pad": 2.5,
}  # fmt: skip
# Matplotlib 3.11 types the keys, earlier ones do not.
_STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 8.0,
    "mathtext.fontset": "dejavusans",
    "axes.labelsize": 8.0,
    "axes.titlesize": 8.0,
    "axes.linewidth": 0.5,
    "axes.labelpad": 2.0,
    "axes.unicode_minus": True,
    # one power of ten at the axis' end
    "axes.formatter.limits": (-2, 4),
    "axes.formatter.use_mathtext": True,
    "axes.formatter.useoffset": False,
    **{f"{axis}tick.{key}": value for axis in "xy" for key, value in _TICKS.items()},
    "legend.fontsize": SMALL,
    "legend.frameon": False,
    "legend.borderaxespad": 0.2,
    "legend.borderpad": 0.2,
    "legend.columnspacing": 1.2,
    "legend.handlelength": 1.8,
    "legend.labelspacing": 0.25,
    "lines.linewidth": 0.9,
    "patch.linewidth": 0.6,
    "figure.dpi": 150.0,
    "savefig.dpi": 300.0,
    # publishers refuse Type 3 fonts, and outlines cannot be searched
    "pdf.fonttype": 42,
    "ps.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "bayesfric",
    "hatch.linewidth": 0.4,
    # very long paths overflow the rasteriser in one piece
    "agg.path.chunksize": 10_000,
}


@contextmanager
def paper_style() -> Iterator[None]:
    """Draw in the package's style inside the block, without the user's ``matplotlibrc``."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        yield


# Files of a figure: what a page shows, what goes into papers and talks.
ON_PAGE, IN_PAPER = ("svg",), ("pdf", "png")
ALL_KINDS = (*ON_PAGE, *IN_PAPER)
# The same figure gives the same bytes.
_UNDATED: dict[str, dict[str, Any]] = {
    "pdf": {"metadata": {"CreationDate": None}},
    "svg": {"metadata": {"Date": None}},
    "png": {"dpi": 300.0},
}


def save(figure: Figure, folder: Path, stem: str, kinds: Sequence[str] = ALL_KINDS) -> None:
    """Write a figure as ``<stem>.pdf``, ``.svg`` and ``.png`` (300 dpi), or some of them."""
    with paper_style():
        for kind in kinds:
            drawn = io.BytesIO()  # on a full disk Matplotlib fails with another error
            figure.savefig(drawn, format=kind, **_UNDATED[kind])
            (folder / f"{stem}.{kind}").write_bytes(drawn.getvalue())


def axis_label(symbol: str, name: str, unit: str, between: str = " ") -> str:
    """Write symbol and unit for an axis; the name where there is no LaTeX symbol."""
    return f"{mathtext(symbol, name)}{between}({unit or '–'})"


@cache
def mathtext(symbol: str, name: str) -> str:
    """Turn a LaTeX symbol, without dollar signs, into Matplotlib's mathtext.

    Words in subscripts (names of elements) are upright. A symbol that cannot be set, as with odd
    characters in an element's name, is replaced by the parameter's name.
    """
    if not symbol:
        return name
    # an empty subscript is the paper's bare symbol
    symbol = symbol.replace("_{}", "")
    symbol = re.sub(r"_\{([^{}]*)\}", lambda m: "_{" + _upright(m[1]) + "}", symbol)
    # parsing takes milliseconds, and symbols differ by the words in them
    plain = re.sub(r"\\mathrm\{[A-Za-z0-9]+\}", "x", symbol)
    return f"${symbol}$" if _is_mathtext(plain) else name.replace("$", r"\$")


@cache
def _is_mathtext(symbol: str) -> bool:
    try:
        MathTextParser("path").parse(f"${symbol}$")
    except (ValueError, RuntimeError):
        return False
    return True


def _upright(subscript: str) -> str:
    subscript = re.sub(r"(?<!\\)_", r"\\_", subscript)
    words = r"[^\W\d_]{2,}(?:(?:\\_|[\s-])*\w+)*"
    # mathtext drops plain spaces
    return re.sub(words, lambda m: rf"\mathrm{{{m[0].replace(' ', chr(92) + ' ')}}}", subscript)


def shortened(name: str, max_count: int = 36) -> str:
    """Cut a user's name to length, and escape dollar signs."""
    if len(name) > max_count:
        name = f"{name[: max_count - 1]}…"
    return name.replace("$", r"\$")


@contextmanager
def paper_figure(width: float, height: float, *, apart: float = 0.03) -> Iterator[Figure]:
    """Give a figure of so many inches to draw in, in the package's style.

    When the block ends, constrained layout runs once: the files differ otherwise by hairs.
    ``apart`` is half of the space between panels.
    """
    with paper_style():
        figure = Figure(figsize=(width, height), layout="constrained")
        # words are measured as they are written
        FigureCanvasSVG(figure)
        engine = figure.get_layout_engine()
        assert isinstance(engine, ConstrainedLayoutEngine)
        engine.set(w_pad=apart, h_pad=apart, wspace=0.0, hspace=0.0)
        yield figure
        engine.execute(figure)
        figure.set_layout_engine(None)  # an engine that does nothing has all drawn twice


def panel_grid(figure: Figure, count: int, columns: int) -> list[Axes]:
    """Fill a figure with panels of equal size, row by row."""
    grid = figure.add_gridspec(-(-count // columns), columns)
    return [figure.add_subplot(grid[divmod(k, columns)]) for k in range(count)]


def labelled(figure: Figure) -> list[Artist]:
    """List the first artist that is drawn with each label."""
    first: dict[str, Artist] = {}
    for ax in figure.axes:
        for artist, label in zip(*ax.get_legend_handles_labels(), strict=True):
            first.setdefault(label, artist)
    return list(first.values())


def legend_above(
    figure: Figure, handles: Sequence[Artist] | None = None, columns: int | None = None
) -> None:
    """Put the legend above the panels, in one line if ``columns`` is left out."""
    handles = labelled(figure) if handles is None else handles
    figure.legend(handles=handles, loc="outside upper left", ncols=columns or len(handles))


def remark_below(figure: Figure, words: str) -> None:
    """Write below the panels what a figure leaves out."""
    figure.supxlabel(words, x=0.99, ha="right", fontsize=SMALL)


class _PlainNumbers(ScalarFormatter):
    """Keep to mathtext for the power of ten only: parsing each number takes a second a page."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return super().__call__(x, pos).removeprefix(r"$\mathdefault{").removesuffix("}$")


def few_ticks(axis: Axis, max_count: int, *, inner: bool = False) -> None:
    """Put at most ``max_count`` numbers on an axis, away from its ends for panels that touch."""
    prune = "both" if inner else None
    axis.set_major_formatter(_PlainNumbers())
    axis.set_major_locator(MaxNLocator(max_count, steps=[1, 2, 5, 10], min_n_ticks=2, prune=prune))
