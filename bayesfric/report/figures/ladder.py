"""How well models with more and more terms predict motion that they were not fitted to."""

from __future__ import annotations

import textwrap

from matplotlib.artist import Artist
from matplotlib.figure import Figure

from bayesfric.explain.explanation import Explanation
from bayesfric.report.figures import style
from bayesfric.report.figures.registry import JudgedRun, RunFigure
from bayesfric.report.figures.style import Look, few_ticks, legend_above, paper_figure

# Inches of a line of words, of a model beyond its words, and of axis and legend.
_WORDS, _BESIDE, _REST = 0.115, 0.1, 0.62
_LETTERS = 26


def ladder_figure(found: Explanation) -> Figure:
    """Draw what models leave of motion fitted and not fitted, a column wide.

    From the model as it is, above, to the last that the recordings ask for; then, with a square,
    those that cannot be told from it. Bars are one standard error over what was left out in turn.
    """
    names = [textwrap.wrap(m.name, _LETTERS) for m in found.models]
    rooms = [_BESIDE + _WORDS * len(lines) for lines in names]
    middles = [-sum(rooms[:k]) - room / 2.0 for k, room in enumerate(rooms)]
    with paper_figure(style.COLUMN, sum(rooms) + _REST) as figure:
        ax = figure.add_subplot()
        fitted: Look = {"marker": "o", "markerfacecolor": "white", "linestyle": "none"}
        held: Look = {"capsize": 2.0, "linestyle": "none", "elinewidth": 0.9}
        first: list[Artist] = []
        for model, y in zip(found.models, middles, strict=True):
            colour = style.PALETTE[2] if model.rival else style.PALETTE[1]
            marker = "s" if model.rival else "o"
            bar = ax.errorbar(
                model.held_out, y, xerr=model.held_out_error, color=colour, marker=marker,
                markersize=4.0, gid="held-out", **held,
            )  # fmt: skip
            bar.lines[0].set_label("not fitted")
            (open_,) = ax.plot(
                model.rms, y, color=style.MEASURED, markersize=3.5, gid="fitted", label="fitted",
                **fitted,
            )  # fmt: skip
            first = first or [bar.lines[0], open_]
        ax.set_yticks(middles, ["\n".join(lines) for lines in names])
        ax.tick_params(axis="y", length=0.0)
        ax.set_ylim(-sum(rooms), 0.0)
        ax.set_xlim(left=0.0)
        few_ticks(ax.xaxis, 5)
        kind = "force" if found.unit == "N" else "torque"
        ax.set_xlabel(f"what is left of the {kind}, rms ({found.unit})")
        legend_above(figure, first)
    return figure


def _words(judged: JudgedRun) -> str:
    found = judged.summary.explanation
    if found is None:
        return ""
    rows = (
        f"{m.name}: {m.rms:.3g} fitted, {m.held_out:.3g} ± {m.held_out_error:.2g} not fitted"
        for m in found.models
    )
    return f"Rms in {found.unit}. {'; '.join(rows)}."


FIGURE = RunFigure(
    stem="ladder",
    title="What the model lacks",
    section="lacking",
    draw=lambda run: ladder_figure(run.summary.explanation) if run.summary.explanation else None,
    caption="What is left of the torque under the model as it is, and with terms added one after "
    "the other: of all outputs when fitted to all (open), and of motion that was not fitted "
    "(filled; one standard error over what was left out in turn). Squares are models that cannot "
    "be told from the last.",
    alternative=_words,
)
