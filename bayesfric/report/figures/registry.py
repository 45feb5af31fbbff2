"""What a figure declares of itself, and how the figures of this folder are found.

A figure of a run is one file of this folder that holds a :class:`RunFigure`; files, captions and
the page's words and sections follow from that.
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
from bayesfric.mechanism.parameter import effort_words
from bayesfric.report.summary.record import Summary

# Of the page of a run, in their order, and of a comparison.
Section = Literal[
    "methods", "ridge", "prediction", "roll-out", "friction", "posterior", "side-by-side",
]  # fmt: skip


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """What a run's figures and captions are made of."""

    fit: Fit
    summary: Summary


@dataclass(frozen=True)
class Declared:
    """All that is known of one figure, which is drawn of one thing."""

    stem: str  # its files' name
    # what the page calls it, and where it stands there
    title: str
    section: Section
    draw: Callable[[Any], Figure | None]  # gives `None` where there is nothing to show
    # what is drawn, and what it says; words where it is the same for all
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
    figures = {one for m in modules for one in vars(m).values() if isinstance(one, RunFigure)}
    order = get_args(Section)
    ranked = sorted(figures, key=lambda one: (order.index(one.section), one.stem))
    return {one.stem: one for one in ranked}


def captions(run: FinishedRun, figures: Sequence[Declared]) -> str:
    """Write the captions of a run's figures as Markdown, one line each."""
    lines = (f"**{one.stem}**: {one.caption_of(run)}\n" for one in figures)
    return effort_words("\n".join(lines), run.fit.chain.motor_motion)


def read_captions(markdown: str) -> dict[str, str]:
    """Read back what :func:`captions` wrote, by stem."""
    lines = (line[2:].partition("**: ") for line in markdown.splitlines() if line[:2] == "**")
    return {stem: caption for stem, _, caption in lines if caption}
