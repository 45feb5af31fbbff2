"""``fleet.html``: the page of a fleet, a single file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayesfric.base import __version__
from bayesfric.estimates.point_estimate import HALF
from bayesfric.fleet.plan import COLUMNS, FAILED, Unit
from bayesfric.fleet.results import OUTLIER, FleetPopulation, FleetQuantity
from bayesfric.report.figures import style
from bayesfric.report.figures.style import save
from bayesfric.report.page.rendering import PageFigure, page_figure, render
from bayesfric.report.summary.record import Summary
from bayesfric.results.reported import Reported

# Columns of the units that fit on the page.
_UNIT_COLUMNS = 6


@dataclass(frozen=True)
class Line:
    """Line of a unit in the table."""

    unit: Unit
    outcome: str
    error: str  # why it failed
    findings: Sequence[str]
    rows: Mapping[str, Reported]  # by quantity
    link: str  # its page, or its folder
    probability: float | None  # of being an outlier
    where: str  # the quantity


def _figures(folder: Path, population: FleetPopulation) -> list[PageFigure]:
    """Write the figure, if there is one, into ``figures/`` and return it for the page."""
    quantities = _shown(population)
    if not quantities:
        return []
    (folder / "figures").mkdir(exist_ok=True)
    save(_distribution(quantities), folder / "figures", "distribution")
    title = "Each quantity over the units"
    caption = (
        "Units by rank, each with its own 90 % interval, the population’s mean (line) and its "
        "central 90 % (dashed), outliers apart. Diamonds: likelier an outlier than not."
    )
    means = [
        f"{x.name}: mean {x.pool.mean.median:.4g}, sd between units "
        f"{x.pool.spread.median:.2g}{f' {x.row.unit}' if x.row.unit else ''}. "
        for x in quantities
    ]
    words = f"{title}. {''.join(means)}".rstrip()
    return [page_figure(folder, "distribution", title, caption, words)]


def fleet_page(
    folder: Path,
    units: Sequence[Unit],
    runs: Mapping[str, Summary],
    errors: Mapping[str, str],
    population: FleetPopulation,
) -> str:
    """Render the page, and write its figure into ``folder``; runs are in ``units/``."""
    lines = list(_lines(folder, units, runs, errors, population))
    columns = [name for name in units[0].values if name not in COLUMNS][:_UNIT_COLUMNS]
    content: dict[str, Any] = {
        "title": folder.name,
        "found": population,
        "lines": lines,
        "columns": columns,
        "quantities": _shown(population),
        "failed": [line for line in lines if line.error],
        "outliers": [line for line in lines if (line.probability or 0.0) >= OUTLIER],
        "figures": _figures(folder, population),
        "version": __version__,
    }
    return render("fleet.html.j2", **content)


def _lines(
    folder: Path,
    units: Sequence[Unit],
    runs: Mapping[str, Summary],
    errors: Mapping[str, str],
    population: FleetPopulation,
) -> Iterator[Line]:
    """List units by their probability of being an outlier, those without one last."""
    ranked = {unit: (p, name) for unit, p, name in population.outliers}
    rank = {unit: k for k, unit in enumerate(ranked)}
    for unit in sorted(units, key=lambda x: rank.get(x.name, len(rank))):
        run = Path("units", unit.name)
        page = run / "report.html"
        p, where = ranked.get(unit.name, (None, ""))
        link = page if (folder / page).is_file() else run
        summary = runs.get(unit.name)
        rows = {} if summary is None else summary.rows
        yield Line(
            unit=unit,
            outcome=FAILED if summary is None else summary.verdict.outcome,
            error=errors.get(unit.name, ""),
            findings=[] if summary is None else [finding.kind for finding in summary.findings],
            rows={name: row.reported for name, row in rows.items()},
            link=link.as_posix(),
            probability=p,
            where=where,
        )


# Panels in a row and in all; height of a panel in inches.
_ACROSS, _PANELS, _HEIGHT = 2, 8, 1.5
# Above so many points they are rasterised.
_VECTOR = 300


def _shown(population: FleetPopulation) -> Sequence[FleetQuantity]:
    """Select the quantities that are not totals, which are redundant, if there are any."""
    quantities = [x for x in population.quantities if not x.name.startswith("total.")]
    return (quantities or list(population.quantities))[:_PANELS]


def _distribution(quantities: Sequence[FleetQuantity]) -> Figure:
    """Draw each quantity over the units by rank, a panel each."""
    rows = math.ceil(len(quantities) / _ACROSS)
    with style.paper_figure(style.PAGE, rows * _HEIGHT + 0.3) as figure:
        axes = style.panel_grid(figure, len(quantities), _ACROSS)
        handles: list[Artist] = []
        for ax, quantity in zip(axes, quantities, strict=True):
            drawn = _panel(ax, quantity)
            handles = drawn if len(drawn) > len(handles) else handles
        for ax in axes[-_ACROSS:]:
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
    many = len(names) > _VECTOR
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
