"""A fleet's figures: each quantity over its units, and over time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bayesfric.fleet.population import OUTLIER, FleetPopulation, FleetQuantity
from bayesfric.report.figures import style

Array = NDArray[np.float64]

# Panels beside each other and in all; inches of one.
_ACROSS, _MOST, _HIGH = 2, 8, 1.5
# More points than this are a picture inside the drawing.
_VECTOR = 300
# Share of the population between the lines.
_CENTRAL, _REACH = "90 %", 1.645


@dataclass(frozen=True)
class FleetFigure:
    """What a figure of a fleet says of itself."""

    stem: str
    title: str
    caption: str
    draw: Callable[[FleetPopulation], Figure | None]
    alternative: Callable[[FleetPopulation], str]


def shown(found: FleetPopulation) -> Sequence[FleetQuantity]:
    """Pick parameters and what no scaling changes; totals say the same in other words."""
    told = [one for one in found.quantities if not one.name.startswith("total.")]
    return (told or list(found.quantities))[:_MOST]


def distribution(found: FleetPopulation) -> Figure | None:
    """Draw each quantity's units by rank; ``None`` where there is none."""

    def places(one: FleetQuantity) -> dict[str, float]:
        order = sorted(one.units, key=lambda name: one.units[name].middle)
        return {name: float(rank) for rank, name in enumerate(order, start=1)}

    return _panels(found, places, "units by rank", trend=False)


def control_chart(found: FleetPopulation) -> Figure | None:
    """Draw each quantity over time or what else is named; ``None`` where nothing is."""
    if len(set(found.over.values())) < 2:
        return None

    def places(one: FleetQuantity) -> dict[str, float]:
        return {name: found.over[name] for name in one.units if name in found.over}

    per = "days since the first" if found.per == "day" else found.per
    return _panels(found, places, style.shortened(per), trend=True)


def _panels(
    found: FleetPopulation,
    places: Callable[[FleetQuantity], Mapping[str, float]],
    label: str,
    *,
    trend: bool,
) -> Figure | None:
    quantities = shown(found)
    if not quantities:
        return None
    rows = math.ceil(len(quantities) / _ACROSS)
    with style.paper_figure(style.PAGE, rows * _HIGH + 0.3) as figure:
        axes = style.panel_grid(figure, len(quantities), _ACROSS)
        handles: list[Artist] = []
        for ax, one in zip(axes, quantities, strict=True):
            drawn = _panel(ax, one, places(one), trend=trend)
            handles = drawn if len(drawn) > len(handles) else handles
        for ax in axes[-_ACROSS:]:
            ax.set_xlabel(label)
        style.legend_above(figure, handles)
    return figure


def _panel(
    ax: Axes, one: FleetQuantity, places: Mapping[str, float], *, trend: bool
) -> list[Artist]:
    names = list(places)
    x = np.array([places[name] for name in names])
    ends = np.array([one.units[name].told_interval for name in names])
    exponent = style.power_of_ten(float(ends.min()), float(ends.max()))
    ends = ends / 10.0**exponent
    y = np.array([one.units[name].middle for name in names]) / 10.0**exponent
    out = np.array([one.outlying[name] >= OUTLIER for name in names])
    many = len(names) > _VECTOR
    bars = LineCollection(
        [[(a, low), (a, high)] for a, (low, high) in zip(x, ends, strict=True)],
        colors="#b4b4b4", linewidths=0.5, rasterized=many,
    )  # fmt: skip
    ax.add_collection(bars)
    drawn: list[Artist] = list(
        ax.plot(x[~out], y[~out], "o", color=style.POSTERIOR, ms=1.8, rasterized=many, label="unit")
    )
    mean, spread = (v.median / 10.0**exponent for v in (one.pool.mean, one.pool.spread))
    drawn += ax.plot(
        [0.0, 1.0], [mean, mean], color=style.MEASURED, transform=ax.get_yaxis_transform(),
        label="population mean",
    )  # fmt: skip
    for k, end in enumerate((mean - _REACH * spread, mean + _REACH * spread)):
        line = ax.axhline(end, color=style.MEASURED, ls=style.DASHED, lw=0.7)
        if k == 0:
            line.set_label(f"{_CENTRAL} of the population")
            drawn.append(line)
    slope = one.levels.slope
    if trend and slope is not None:
        middle = float(np.mean(x[~out])) if (~out).any() else 0.0
        reach = np.array([x.min(), x.max()])
        drawn += ax.plot(
            reach, mean + slope.median / 10.0**exponent * (reach - middle),
            color=style.PALETTE[3], ls=style.DOTTED, lw=1.4, label="trend",
        )  # fmt: skip
    if out.any():
        drawn += ax.plot(x[out], y[out], "D", color=style.PALETTE[2], ms=3.2, label="outlier")
    ax.margins(x=0.02, y=0.06)
    style.few_ticks(ax.yaxis, 4)
    style.few_ticks(ax.xaxis, 5)
    ax.set_ylabel(style.axis_label(one.told.symbol, one.name, exponent, one.told.unit))
    return drawn


def _means(found: FleetPopulation) -> str:
    said = (
        f"{one.name}: mean {one.pool.mean.median:.4g}, sd between units "
        f"{one.pool.spread.median:.2g}{f' {one.told.unit}' if one.told.unit else ''}"
        for one in shown(found)
    )
    return f"{'. '.join(said)}."


def _trends(found: FleetPopulation) -> str:
    said = (
        f"{one.name}: trend {s.median:.3g} from {s.low:.3g} to {s.high:.3g} "
        f"{one.told.unit} per {found.per}"
        for one in shown(found)
        if (s := one.levels.slope) is not None
    )
    return f"{'. '.join(said)}."


FIGURES = (
    FleetFigure(
        "distribution",
        "Each quantity over the units",
        "Units by rank, each with its own 90 % interval, the population’s mean (line) and its "
        "central 90 % (dashed), outliers apart. Diamonds: likelier an outlier than not.",
        distribution,
        _means,
    ),
    FleetFigure(
        "control-chart",
        "Each quantity over time",
        "Units with their own 90 % intervals, the population’s mean (line) and its central 90 % "
        "(dashed), and the trend (dotted), outliers apart.",
        control_chart,
        _trends,
    ),
)
