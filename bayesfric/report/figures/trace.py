"""The log density along the steps, an ensemble a line: where sampling went."""

from __future__ import annotations

from matplotlib.figure import Figure

from bayesfric.report.figures import style
from bayesfric.report.figures.registry import FinishedRun, RunFigure


def trace_figure(run: FinishedRun) -> Figure:
    """Draw the mean log density of each ensemble's walkers, a column wide."""
    with style.paper_figure(style.COLUMN, 1.6) as figure:
        ax = figure.subplots()
        for k, density in enumerate(run.fit.posterior.log_density.mean(axis=1)):
            ax.plot(density, linewidth=0.5, color=style.PALETTE[k % len(style.PALETTE)])
        ax.set(xlabel="kept step", ylabel="log density")
    return figure


FIGURE = RunFigure(
    stem="trace",
    title="Log density along the steps",
    section="posterior",
    draw=trace_figure,
    caption="Mean log density of the walkers of each ensemble along the kept steps.",
)
