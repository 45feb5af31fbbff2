"""``fleet.html``: the page of a fleet, a single file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesfric.base import __version__
from bayesfric.estimates.point_estimate import HALF
from bayesfric.fleet.plan import COLUMNS, FAILED, Unit
from bayesfric.fleet.results import OUTLIER, FleetQuantity, ranked_units
from bayesfric.report.figures import style
from bayesfric.report.page.pages import page_figure, render
from bayesfric.report.summary.record import Summary


def fleet_page(
    folder: Path,
    units: Sequence[Unit],
    runs: Mapping[str, Summary],
    errors: Mapping[str, str],
    population: Sequence[FleetQuantity],
) -> str:
    """Render the page, and write its figure into ``folder``; runs are in ``units/``."""
    # totals are redundant where there is anything else; eight fit on the page
    quantities = [x for x in population if not x.name.startswith("total.")] or population
    quantities = quantities[:8]
    figures = []
    if quantities:
        (folder / "figures").mkdir(exist_ok=True)
        style.save(_distribution(quantities), folder / "figures", "distribution")
        title = "Each quantity over the units"
        caption = (
            "Units by rank, each with its own 90 % interval, the population’s mean (line) and its "
            "central 90 % (dashed), outliers apart. Diamonds: likelier an outlier than not."
        )
        figures = [page_figure(folder, "distribution", title, caption)]
    ranked = ranked_units(population)
    rank = {name: k for k, name in enumerate(ranked)}
    rows = []
    for unit in sorted(units, key=lambda unit: rank.get(unit.name, len(rank))):
        run, summary = Path("units", unit.name), runs.get(unit.name)
        page = run / "report.html"
        rows.append(
            {
                "unit": unit,
                "summary": summary,
                "outcome": FAILED if summary is None else summary.verdict.outcome,
                "error": errors.get(unit.name, ""),
                "link": (page if (folder / page).is_file() else run).as_posix(),
                # of being an outlier, and in which quantity
                "probability": ranked.get(unit.name, (None, ""))[0],
                "where": ranked.get(unit.name, (None, ""))[1],
            }
        )
    return render(
        "fleet.html.j2",
        title=folder.name,
        population=population,
        rows=rows,
        columns=[name for name in units[0].values if name not in COLUMNS][:6],
        quantities=quantities,
        failed=[row for row in rows if row["error"]],
        outliers=[name for name, (p, _) in ranked.items() if p >= OUTLIER],
        figures=figures,
        version=__version__,
    )


def _distribution(quantities: Sequence[FleetQuantity], across: int = 2) -> Figure:
    """Draw each quantity over the units by rank, a panel each."""
    rows = math.ceil(len(quantities) / across)
    with style.paper_figure(style.PAGE, rows * 1.5 + 0.3) as figure:
        axes = style.panel_grid(figure, len(quantities), across)
        for ax, quantity in zip(axes, quantities, strict=True):
            _panel(ax, quantity)
        for ax in axes[-across:]:
            ax.set_xlabel("units by rank")
        style.legend_above(figure)
    return figure


def _panel(ax: Axes, quantity: FleetQuantity) -> None:
    names = sorted(quantity.units, key=lambda name: quantity.units[name].value)
    reported = [quantity.units[name].reported for name in names]
    value, low, high = np.array([(x.value, x.low, x.high) for x in reported]).T
    outlying, x = quantity.outlying, np.arange(1, len(names) + 1)
    out = np.array([outlying[name] >= OUTLIER for name in names])
    pixels: style.Look = {"rasterized": len(names) > 300}  # too many points for a vector graphic
    ax.vlines(x, low, high, colors="#b4b4b4", linewidths=0.5, **pixels)
    ax.plot(x[~out], value[~out], "o", color=style.POSTERIOR, ms=1.8, label="unit", **pixels)
    if out.any():
        ax.plot(x[out], value[out], "D", color=style.PALETTE[2], ms=3.2, label="outlier")
    mean, spread = quantity.pool.mean.median, quantity.pool.spread.median
    ax.axhline(mean, color=style.MEASURED, label="population mean")
    look: style.Look = {"color": style.MEASURED, "linestyle": style.DASHED, "linewidth": 0.7}
    ax.axhline(mean - HALF * spread, label="90 % of the population", **look)
    ax.axhline(mean + HALF * spread, **look)
    ax.margins(x=0.02, y=0.06)
    style.few_ticks(ax.yaxis, 4)
    style.few_ticks(ax.xaxis, 5)
    ax.set_ylabel(style.axis_label(quantity.row.symbol, quantity.name, quantity.row.unit))
