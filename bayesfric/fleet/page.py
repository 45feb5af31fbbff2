"""``fleet.html``: the page of a fleet, one file that fetches nothing."""

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
from bayesfric.fleet.fleet_population import OUTLIER, FleetPopulation, FleetQuantity
from bayesfric.fleet.fleet_units import Unit
from bayesfric.fleet.results import COLUMNS, FAILED
from bayesfric.report.figures import style
from bayesfric.report.figures.style import save
from bayesfric.report.page.rendering import PageFigure, page_figure, render
from bayesfric.report.summary.record import Summary
from bayesfric.results.reported import Reported

# Columns of the units that there is room for.
_MOST = 6


@dataclass(frozen=True)
class Line:
    """A unit's line in the table."""

    unit: Unit
    outcome: str
    error: str  # why it failed
    findings: Sequence[str]
    rows: Mapping[str, Reported]  # by quantity
    link: str  # its page, or its folder
    probability: float | None  # of being an outlier
    where: str  # the quantity


def _draw(folder: Path, found: FleetPopulation) -> list[PageFigure]:
    """Write the figure into ``figures/``, if there is one, and give it for the page."""
    quantities = shown(found)
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
        f"{one.name}: mean {one.pool.mean.median:.4g}, sd between units "
        f"{one.pool.spread.median:.2g}{f' {one.told.unit}' if one.told.unit else ''}. "
        for one in quantities
    ]
    words = f"{title}. {''.join(means)}".rstrip()
    return [page_figure(folder, "distribution", title, caption, words)]


def fleet_page(
    folder: Path,
    units: Sequence[Unit],
    runs: Mapping[str, Summary],
    errors: Mapping[str, str],
    found: FleetPopulation,
) -> str:
    """Write the page, and its figure into ``folder``; units' folders are in ``units/``."""
    lines = list(_lines(folder, units, runs, errors, found))
    columns = [name for name in units[0].values if name not in COLUMNS][:_MOST]
    told: dict[str, Any] = {
        "title": folder.name,
        "found": found,
        "lines": lines,
        "columns": columns,
        "quantities": shown(found),
        "failed": [one for one in lines if one.error],
        "outliers": [one for one in lines if (one.probability or 0.0) >= OUTLIER],
        "figures": _draw(folder, found),
        "version": __version__,
    }
    return render("fleet.html.j2", **told)


def _lines(
    folder: Path,
    units: Sequence[Unit],
    runs: Mapping[str, Summary],
    errors: Mapping[str, str],
    found: FleetPopulation,
) -> Iterator[Line]:
    """Order units: outliers first, then as ranked, those without a rank last."""
    ranked = {unit: (p, name) for unit, p, name in found.outliers}
    place = {unit: k for k, unit in enumerate(ranked)}
    for unit in sorted(units, key=lambda one: place.get(one.name, len(place))):
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
            findings=[] if summary is None else [one.kind for one in summary.findings],
            rows={name: row.reported for name, row in rows.items() if row.reported is not None},
            link=link.as_posix(),
            probability=p,
            where=where,
        )


# Panels beside each other and in all; inches of one.
_ACROSS, _PANELS, _HIGH = 2, 8, 1.5
# More points than this are a picture inside the drawing.
_VECTOR = 300


def shown(found: FleetPopulation) -> Sequence[FleetQuantity]:
    """Pick parameters and what no scaling changes; totals say the same in other words."""
    told = [one for one in found.quantities if not one.name.startswith("total.")]
    return (told or list(found.quantities))[:_PANELS]


def _distribution(quantities: Sequence[FleetQuantity]) -> Figure:
    """Draw each quantity over the units by rank, a panel each."""
    rows = math.ceil(len(quantities) / _ACROSS)
    with style.paper_figure(style.PAGE, rows * _HIGH + 0.3) as figure:
        axes = style.panel_grid(figure, len(quantities), _ACROSS)
        handles: list[Artist] = []
        for ax, one in zip(axes, quantities, strict=True):
            drawn = _panel(ax, one)
            handles = drawn if len(drawn) > len(handles) else handles
        for ax in axes[-_ACROSS:]:
            ax.set_xlabel("units by rank")
        style.legend_above(figure, handles)
    return figure


def _panel(ax: Axes, one: FleetQuantity) -> list[Artist]:
    names = sorted(one.units, key=lambda name: one.units[name].value)
    x = np.arange(1.0, len(names) + 1.0)
    ends = np.array([(told.low, told.high) for told in (one.units[name].printed for name in names)])
    exponent = style.power_of_ten(float(ends.min()), float(ends.max()))
    scale = 10.0**exponent
    y = np.array([one.units[name].value for name in names]) / scale
    out = np.array([one.outlying[name] >= OUTLIER for name in names])
    many = len(names) > _VECTOR
    low, high = (ends / scale).T
    ax.vlines(x, low, high, colors="#b4b4b4", linewidths=0.5, rasterized=many)
    dots: dict[str, Any] = {"ms": 1.8, "rasterized": many, "label": "unit"}
    drawn: list[Artist] = list(ax.plot(x[~out], y[~out], "o", color=style.POSTERIOR, **dots))
    mean, spread = one.pool.mean.median / scale, one.pool.spread.median / scale
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
    ax.set_ylabel(style.axis_label(one.told.symbol, one.name, exponent, one.told.unit))
    return drawn
