"""``fleet.html``: the page of a fleet, a single file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
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
    rows = _unit_rows(folder, units, runs, errors, population)
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
        means = [
            f" {x.name}: mean {x.pool.mean.median:.4g}, sd between units "
            f"{x.pool.spread.median:.2g}{x.row.unit and f' {x.row.unit}'}."
            for x in quantities
        ]
        words = f"{title}.{''.join(means)}"
        figures = [page_figure(folder, "distribution", title, caption, words)]
    return render(
        "fleet.html.j2",
        title=folder.name,
        population=population,
        rows=rows,
        columns=[name for name in units[0].values if name not in COLUMNS][:6],
        quantities=quantities,
        failed=[row for row in rows if row["error"]],
        outliers=[row for row in rows if (row["probability"] or 0.0) >= OUTLIER],
        figures=figures,
        version=__version__,
    )


def _unit_rows(
    folder: Path,
    units: Sequence[Unit],
    runs: Mapping[str, Summary],
    errors: Mapping[str, str],
    population: Sequence[FleetQuantity],
) -> list[dict[str, Any]]:
    """List units by their probability of being an outlier, those without one last."""
    ranked = ranked_units(population)
    rank = {unit: k for k, unit in enumerate(ranked)}
    rows = []
    for unit in sorted(units, key=lambda x: rank.get(x.name, len(rank))):
        run = Path("units", unit.name)
        page = run / "report.html"
        p, where = ranked.get(unit.name, (None, ""))
        summary = runs.get(unit.name)
        results = {} if summary is None else summary.rows
        rows.append(
            {
                "unit": unit,
                "outcome": FAILED if summary is None else summary.verdict.outcome,
                "error": errors.get(unit.name, ""),
                "findings": [x.kind for x in summary.findings] if summary else [],
                "reported": {name: x.reported for name, x in results.items()},
                "link": (page if (folder / page).is_file() else run).as_posix(),
                "probability": p,
                "where": where,  # the quantity
            }
        )
    return rows


def _distribution(quantities: Sequence[FleetQuantity], across: int = 2) -> Figure:
    """Draw each quantity over the units by rank, a panel each."""
    rows = math.ceil(len(quantities) / across)
    with style.paper_figure(style.PAGE, rows * 1.5 + 0.3) as figure:
        axes = style.panel_grid(figure, len(quantities), across)
        handles: list[Artist] = []
        for ax, quantity in zip(axes, quantities, strict=True):
            drawn = _panel(ax, quantity)
            handles = drawn if len(drawn) > len(handles) else handles
        for ax in axes[-across:]:
            ax.set_xlabel("units by rank")
        style.legend_above(figure, handles)
    return figure


def _panel(ax: Axes, quantity: FleetQuantity) -> list[Artist]:
    names = sorted(quantity.units, key=lambda name: quantity.units[name].value)
    x = np.arange(1.0, len(names) + 1.0)
    ends = np.array([(x.low, x.high) for x in (quantity.units[name].reported for name in names)])
    exponent = style.power_of_ten(float(ends.min()), float(ends.max()))
    scale = 10.0**exponent
    y = np.array([quantity.units[name].value for name in names]) / scale
    out = np.array([quantity.outlying[name] >= OUTLIER for name in names])
    many = len(names) > 300  # too many points for a vector graphic
    low, high = (ends / scale).T
    ax.vlines(x, low, high, colors="#b4b4b4", linewidths=0.5, rasterized=many)
    dots: dict[str, Any] = {"ms": 1.8, "rasterized": many, "label": "unit"}
    drawn: list[Artist] = list(ax.plot(x[~out], y[~out], "o", color=style.POSTERIOR, **dots))
    mean, spread = quantity.pool.mean.median / scale, quantity.pool.spread.median / scale
    drawn.append(ax.axhline(mean, color=style.MEASURED, label="population mean"))
    for end in (mean - HALF * spread, mean + HALF * spread):
        line = ax.axhline(end, color=style.MEASURED, ls=style.DASHED, lw=0.7)
    line.set_label("90 % of the population")
    drawn.append(line)
    if out.any():
        drawn += ax.plot(x[out], y[out], "D", color=style.PALETTE[2], ms=3.2, label="outlier")
    ax.margins(x=0.02, y=0.06)
    style.few_ticks(ax.yaxis, 4)
    style.few_ticks(ax.xaxis, 5)
    ax.set_ylabel(style.axis_label(quantity.row.symbol, quantity.name, exponent, quantity.row.unit))
    return drawn
