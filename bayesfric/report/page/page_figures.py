"""A run's figures as a page holds them: drawing, words, and names of their own."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import get_args
from xml.sax.saxutils import escape

from markupsafe import Markup

from bayesfric.report.figures.registry import Declared, Section

_SVG = "http://www.w3.org/2000/svg"
_XLINK = "http://www.w3.org/1999/xlink"
# What may stand in a drawing; everything else is left out, metadata and scripts among it.
_DRAWN = {
    "svg", "g", "defs", "path", "use", "text", "tspan", "rect", "circle", "ellipse", "line",
    "polyline", "polygon", "clipPath", "pattern", "image", "linearGradient", "radialGradient",
    "stop", "title", "desc",
}  # fmt: skip
_REFERENCE = re.compile(r"url\(\s*['\"]?([^)'\"]*)['\"]?\s*\)")
_TARGET = re.compile(r"(?:url\(\s*['\"]?|href=\s*['\"])#([^)'\"]+)")
_LONG = re.compile(r"(?<=\.\d\d)\d+")
_QUOTE = {'"': "&quot;"}
# Coordinates in points: a hundredth is finer than any printer, and halves the page.
_COORDINATES = ("d", "x", "y")

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


@dataclass(frozen=True)
class Drawing:
    """An SVG ready to stand in a page."""

    markup: Markup  # the `svg` element, without names or references of others
    # in points, of its view box
    width: float
    height: float


def inline_svg(text: str, prefix: str, label: str) -> Drawing:
    """Make an SVG, as this package saves it, fit to stand inside a page; else ``ValueError``.

    Matplotlib gives the same names (``figure_1``, clip paths) in every figure; two of
    them in one page would clip each other: ``prefix``, unique in the page, is put before every
    ``id`` that is referred to. ``label`` is what a screen reader says in its place.
    """
    try:
        root = ET.fromstring(text)
        box = [float(v) for v in root.attrib["viewBox"].split()]
        _, _, width, height = box
    except (ET.ParseError, KeyError, ValueError) as error:
        raise ValueError(f"no SVG with a view box: {error}") from None
    referred = set(_TARGET.findall(text))
    if root.tag != f"{{{_SVG}}}svg" or not (width > 0 and height > 0):
        raise ValueError("no SVG with a view box")
    # Matplotlib names groups, some of them twice; only what is referred to needs its name
    for element in root.iter():
        if element.attrib.get("id", "") not in referred:
            element.attrib.pop("id", None)
    for key in ("width", "height"):
        root.attrib.pop(key, None)
    root.attrib.update({"role": "img", "aria-label": label})
    out: list[str] = []
    _write(root, prefix, out)
    return Drawing(Markup("".join(out)), width, height)


def _write(element: ET.Element, prefix: str, out: list[str]) -> None:
    tag = element.tag.removeprefix(f"{{{_SVG}}}") if isinstance(element.tag, str) else ""
    if tag not in _DRAWN:
        return
    kept = (_attribute(key, value, prefix) for key, value in element.attrib.items())
    told = "".join(f' {key}="{escape(value, _QUOTE)}"' for key, value in filter(None, kept))

    def words(text: str | None) -> str:
        return escape((text or "").strip("\n"), _QUOTE) if tag in ("text", "tspan") else ""

    # an svg element of a page is in the right namespace already
    out.append(f"<{tag}{told}>{words(element.text)}")
    for child in element:
        _write(child, prefix, out)
        out.append(words(child.tail))
    out.append(f"</{tag}>")


def _attribute(key: str, value: str, prefix: str) -> tuple[str, str] | None:
    if key == "id":
        return "id", prefix + value
    if key in (f"{{{_XLINK}}}href", "href"):
        if value.startswith("#"):
            return "href", f"#{prefix}{value[1:]}"
        return ("href", "".join(value.split())) if value.startswith("data:image/png;") else None
    if key.startswith("{") or key.lower().startswith("on"):
        return None
    if "url" in value.lower():
        outside = [at for at in _REFERENCE.findall(value) if not at.startswith("#")]
        if outside or "url(" not in value:
            return None
        value = _REFERENCE.sub(lambda m: f"url(#{prefix}{m[1][1:]})", value)
    if key in _COORDINATES:
        value = _LONG.sub("", value.replace("\n", " ").strip())
    return key, value
