"""A run's figures as a page holds them: drawing and words.

A drawing is an image: whatever its file holds, an image neither acts nor reaches out.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import get_args
from urllib.parse import quote

from bayesfric.errors import BadInput
from bayesfric.opened import read_text
from bayesfric.report.figures.registry import Declared, Section

_SIZE = re.compile(r'<svg\b[^>]*\bviewBox="0 0 ([\d.]+) ([\d.]+)"')
# Coordinates in points: a hundredth is finer than any printer, and halves the page.
_COORDINATES = re.compile(r'\b[dxy]="[^"]*"')
_LONG = re.compile(r"(?<=\.\d\d)\d+")
# Points; wider than a column of a paper, a figure needs a page's width to be read.
_COLUMN = 300.0


@dataclass(frozen=True)
class PageFigure:
    """One figure."""

    stem: str  # its file's name, and its anchor behind `figure-`
    # in words
    title: str
    caption: str
    alt: str  # what it says to who cannot see it
    source: str  # the drawing as a data URL
    # in points
    width: float
    height: float

    @property
    def wide(self) -> bool:
        """Whether it is made for the width of a page."""
        return self.width > _COLUMN


def page_figure(folder: Path, stem: str, title: str, caption: str, alt: str) -> PageFigure:
    """Read one figure of a folder; ``BadInput`` or ``ValueError`` where there is none."""
    text = read_text(folder / "figures" / f"{stem}.svg")
    if (size := _SIZE.search(text)) is None:
        raise ValueError(f"{stem}.svg is no SVG with a view box")
    text = _COORDINATES.sub(lambda found: _LONG.sub("", found[0]), text).replace("\n", " ")
    source = "data:image/svg+xml," + quote(text, safe=" :/;=,().-")
    return PageFigure(stem, title, caption, alt, source, float(size[1]), float(size[2]))


def page_figures(
    folder: Path, figures: Iterable[Declared], captions: Mapping[str, str]
) -> dict[str, list[PageFigure]]:
    """Read the figures that the folder has, by section of the page.

    ``captions``, by stem, come before what a figure declares of itself. What a figure says to who
    cannot see it is its caption: the numbers are in the page's tables.
    """
    sections: dict[str, list[PageFigure]] = {section: [] for section in get_args(Section)}
    for one in figures:
        # not every caption is written down
        caption = captions.get(one.stem, one.caption if isinstance(one.caption, str) else "")
        alt = f"{one.title}. {caption}".strip()
        try:
            sections[one.section].append(page_figure(folder, one.stem, one.title, caption, alt))
        except (BadInput, ValueError):
            continue
    return sections
