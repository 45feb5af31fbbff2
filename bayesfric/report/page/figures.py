"""A run's figures as a page holds them: drawing, words, and names of their own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from bayesfric.report.page.figure_words import FigureWords
from bayesfric.report.page.inline_svg import Drawing, inline_svg

# Points; wider than a column of a paper, a figure needs a page's width to be read.
_COLUMN = 300.0


@dataclass(frozen=True)
class PageFigure:
    """One figure.

    Attributes
    ----------
    stem
        Its file's name, and its anchor behind ``figure-``.
    words
        Title, caption, text alternative.
    drawing
        The SVG.
    """

    stem: str
    words: FigureWords
    drawing: Drawing

    @property
    def wide(self) -> bool:
        """Whether it is made for the width of a page."""
        return self.drawing.width > _COLUMN


def read_figures(folder: Path, words: Mapping[str, FigureWords]) -> dict[str, PageFigure | None]:
    """Read the named figures; those that were not drawn are ``None``.

    A file that is no drawing of this package is left out, as if it were not there.
    """
    return {stem: _read(folder / f"{stem}.svg", stem, said) for stem, said in words.items()}


def _read(path: Path, stem: str, words: FigureWords) -> PageFigure | None:
    try:
        text = path.read_text(encoding="utf-8")
        return PageFigure(stem, words, inline_svg(text, f"{stem}-", words.alternative))
    except (OSError, ValueError):
        return None
