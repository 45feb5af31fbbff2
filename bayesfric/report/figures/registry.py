"""Declarations of figures, and the registry of those of this folder.

A figure of a run is one file of this folder that holds a :class:`RunFigure`; files, captions and
the page's sections follow from that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from typing import Any, Literal, get_args

from matplotlib.figure import Figure

from bayesfric.inference.fitting import Fit
from bayesfric.mechanism.quantities import effort_words
from bayesfric.report.summary.record import Summary

# Of the page of a run, in their order, and of a comparison.
Section = Literal[
    "methods", "ridge", "prediction", "roll-out", "friction", "posterior", "side-by-side",
]  # fmt: skip


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """Data of a run's figures and captions."""

    fit: Fit
    summary: Summary


@dataclass(frozen=True)
class Declared:
    """One figure."""

    stem: str  # its files' name
    title: str
    section: Section  # of the page
    draw: Callable[[Any], Figure | None]  # gives `None` where there is nothing to show
    # text, or a function of what is drawn
    caption: str | Callable[[Any], str]

    def caption_of(self, drawn: Any) -> str:
        """Give the caption of one drawing."""
        return self.caption if isinstance(self.caption, str) else self.caption(drawn)


class RunFigure(Declared):
    """A figure of a :class:`FinishedRun`."""


@cache
def run_figures() -> dict[str, Declared]:
    """Find the figures of a run, by stem in the order of the page."""
    folder = import_module(__package__)
    modules = (import_module(f"{__package__}.{m.name}") for m in iter_modules(folder.__path__))
    figures = {x for m in modules for x in vars(m).values() if isinstance(x, RunFigure)}
    order = get_args(Section)
    ranked = sorted(figures, key=lambda figure: (order.index(figure.section), figure.stem))
    return {figure.stem: figure for figure in ranked}


def captions(run: FinishedRun, figures: Sequence[Declared]) -> str:
    """Write the captions of a run's figures as Markdown, one line each."""
    lines = (f"**{figure.stem}**: {figure.caption_of(run)}\n" for figure in figures)
    return effort_words("\n".join(lines), run.fit.chain.motor_motion)


def read_captions(markdown: str) -> dict[str, str]:
    """Read back what :func:`captions` wrote, by stem."""
    lines = (line[2:].partition("**: ") for line in markdown.splitlines() if line[:2] == "**")
    return {stem: caption for stem, _, caption in lines if caption}
