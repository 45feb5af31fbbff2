"""Prior against posterior of every parameter, with the verdict in each panel."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesfric.inference.fitting import Fit
from bayesfric.report.comparison.cell import Cell, posterior_cells
from bayesfric.report.figures import style
from bayesfric.report.figures.marginal import draw_marginal, marginal_handles
from bayesfric.report.figures.quantity import Quantity, not_shown, quantities, which_posterior
from bayesfric.report.figures.registry import JudgedRun, RunFigure
from bayesfric.report.figures.style import corner_words, panel_grid, paper_figure, remark_below
from bayesfric.report.page.values import judgement
from bayesfric.report.summary.record import Summary
from bayesfric.report.summary.rows import PosteriorRow
from bayesfric.report.summary.summary import LEVEL

_COLUMNS = 4
_MOST = 24
# A prior this many times as wide as the posterior would leave it no room.
_WIDEST = 6.0
_ROW, _AROUND = 1.22, 0.3  # inches
_WORDS = {"data": "data", "weak": "weak: prior and data", "prior": "prior: NOT determined"}


def prior_posterior_figure(fit: Fit, summary: Summary) -> Figure:
    """Draw prior and posterior density of each sampled parameter, a page wide.

    Densities are scaled to the panel. A panel shows the whole prior where that is at most
    some times as wide as the posterior, else the posterior with the prior passing through;
    the ratio of the two sds stands beside the verdict. At most twenty-four panels.
    """
    return _drawn(quantities(fit.wide), summary.parameters, posterior_cells(summary))


def _drawn(
    everything: list[Quantity], rows: Mapping[str, PosteriorRow], judged: Mapping[str, Cell]
) -> Figure:
    shown, left_out = everything[:_MOST], everything[_MOST:]
    cells = [judged[q.name] for q in shown]
    with paper_figure(
        style.PAGE, _AROUND + _ROW * -(-len(shown) // _COLUMNS), apart=0.05
    ) as figure:
        panels = panel_grid(figure, len(shown), _COLUMNS)
        for ax, q, cell in zip(panels, shown, cells, strict=True):
            _panel(ax, q, rows[q.name], cell)
        ratio = Line2D([], [], linestyle="none", label="1:n  sd of posterior to prior")
        style.legend_above(figure, [*marginal_handles(cells), ratio])
        remark_below(figure, not_shown(left_out))
    return figure


def _panel(ax: Axes, q: Quantity, row: PosteriorRow, cell: Cell) -> None:
    words = "doubtful" if cell.doubted else _WORDS[row.verdict]
    words = words if cell.converged else "NOT converged"
    # what the data push against a bound they do determine: from the other side
    words = cell.remark if cell.status == "limit" else words
    # room for the verdict
    draw_marginal(ax, q, _range(q), cell=cell, headroom=1.35)
    style.few_ticks(ax.xaxis, 3, inner=True)
    ax.set_xlabel(q.label())
    corner_words(ax, words, "verdict")
    narrowing = row.prior_sd / row.told_sd if row.prior_sd and row.told_sd else 0.0
    if narrowing > _WIDEST:
        corner_words(ax, f"1:{_two_digits(narrowing)}", "ratio", "right")


def _two_digits(x: float) -> str:
    return f"{float(f'{x:.2g}'):.0f}" if x < 1e4 else rf"$10^{{{round(np.log10(x))}}}$"


def _range(q: Quantity) -> tuple[float, float]:
    """All of the posterior, and of the prior as much as leaves that half of the width or so."""
    assert q.prior is not None  # a sampled parameter has one
    low, high = q.nearly_all(0.08)
    drawn = q.prior.draw(1000, np.random.default_rng(np.random.SeedSequence(0))) / q.factor
    first, last = (float(x) for x in np.quantile(drawn, [0.01, 0.99]))
    if last - first < _WIDEST * (high - low):
        low, high = min(low, first), max(high, last)
    return low, high


def _words(judged: JudgedRun) -> str:
    parts = []
    for row in judged.table.rows:
        facts = judged.summary.parameters.get(row.name)
        if facts is not None and facts.narrowing:
            ratio = f"posterior 1:{facts.narrowing:.3g} as wide as its prior"
            parts.append(f"{row.name}: {ratio}, {judgement(row)}")
    return "; ".join(parts) + "."


FIGURE = RunFigure(
    stem="prior_posterior",
    title="Prior and posterior",
    section="posterior",
    draw=lambda run: partial(
        _drawn, quantities(run.fit.wide), run.summary.parameters, posterior_cells(run.summary)
    ),
    caption=lambda run: (
        f"Prior (dashed) and posterior density of each parameter; dotted: {100 * LEVEL:.0f} % "
        "interval; hatched where the data leave the parameter open. 1:n compares the sds of "
        "posterior and prior. A posterior can be far narrower than its prior and open all the "
        "same: then priors and bounds of other parameters confine it."
        + which_posterior(run.summary)
    ),
    alternative=_words,
)
