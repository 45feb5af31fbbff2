"""A run's figures as a page holds them: drawing, words, and names of their own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from bayesfric.report.figures.registry import Declared, Section
from bayesfric.report.page.inline_svg import Drawing, inline_svg

# Points; wider than a column of a paper, a figure needs a page's width to be read.
_COLUMN = 300.0


@dataclass(frozen=True)
class PageFigure:
    """One figure."""

    stem: str  # its file's name, and its anchor behind `figure-`
    # in words
    title: str
    caption: str
    drawing: Drawing  # the SVG, with its text alternative

    @property
    def wide(self) -> bool:
        """Whether it is made for the width of a page."""
        return self.drawing.width > _COLUMN


def page_figures(
    folder: Path,
    figures: Iterable[Declared],
    captions: Mapping[str, str],
) -> dict[str, list[PageFigure]]:
    """Read the figures that the folder has, by section of the page.

    ``captions``, by stem, come before what a figure declares of itself. What a figure says to who
    cannot see it is its caption: the numbers are in the page's tables.
    """
    sections: dict[str, list[PageFigure]] = {section: [] for section in get_args(Section)}
    for one in figures:
        try:
            text = (folder / "figures" / f"{one.stem}.svg").read_text(encoding="utf-8")
            # older runs wrote only some captions down
            caption = captions.get(one.stem, one.caption if isinstance(one.caption, str) else "")
            drawing = inline_svg(text, f"{one.stem}-", f"{one.title}. {caption}".strip())
        except (OSError, ValueError):
            continue
        sections[one.section].append(PageFigure(one.stem, one.title, caption, drawing))
    return sections
