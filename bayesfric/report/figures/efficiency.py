"""Efficiency of the gearbox over the load, driving and back-driven, eq. (4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesfric.estimates.torque import typical_load
from bayesfric.inference.fit import Fit
from bayesfric.mechanism.derived import derive
from bayesfric.report.figures.curve_band import CurveBand, CurveJudge, Flags, joined
from bayesfric.report.figures.friction_curve import covered, load_reach
from bayesfric.report.figures.style import (
    COLUMN,
    MEASURED,
    OPEN_HATCH,
    PAGE,
    PALETTE,
    Array,
    few_ticks,
    margins,
    paper_style,
)
from bayesfric.report.summary.summary import LEVEL

_POINTS = 40
_DRAWS = 500
_MOST = 2
_HEIGHT, _BOTTOM, _LEFT, _RIGHT = 2.6, 0.38, 0.48, 0.08
# Of the legend, and of each of its lines.
_ABOVE, _LINE = 0.10, 0.135
_SIDES = {"drive": ("motor drives", PALETTE[1], "o"), "back": ("load drives", PALETTE[2], "s")}
_SYMBOLS = {"drive": r"\eta_m", "back": r"\eta_r"}
_OUTSIDE = (0, (3.0, 2.0))


@dataclass(frozen=True, eq=False)
class EfficiencyCurve:
    """Efficiency of one element in one direction of power.

    Attributes
    ----------
    name
        Of the derived quantity, such as ``gearbox.efficiency_drive``.
    side
        ``drive`` or ``back``.
    load
        ``(N,)`` torque of the load at the joint, N m or N.
    band
        Of the efficiency; without a value where half of the draws call the transmission
        irreversible.
    covered
        ``(N,)`` whether recordings had such loads in this direction of power.
    """

    name: str
    side: str
    load: Array
    band: CurveBand
    covered: Flags


def efficiency_curves(fit: Fit) -> tuple[EfficiencyCurve, ...]:
    """Evaluate eq. (4) over the loads of the recordings.

    The definition is that of :func:`bayesfric.mechanism.derived.derive`: constant losses in
    and behind the element count, viscous ones do not. Unlike friction at the motor it is
    of the load at the joint, which scaling leg and alpha together does change: where that
    scale is open, so are efficiencies.

    Parameters
    ----------
    fit
        A finished fit.

    Returns
    -------
    tuple of EfficiencyCurve
        Two for each element with a load loss; none where there is no load.
    """
    chain = fit.chain
    elements = [element.name for element in chain.elements if element.load_loss != "none"]
    if not elements:
        return ()
    judge = CurveJudge(fit)
    place = covered(fit, judge.median, open_scale=False)
    joint = place.load / float(load_reach(chain, judge.median[None], open_scale=False)[0])
    top = float(np.quantile(np.abs(joint), 0.995))
    if not top > 0.0:
        return ()
    load = np.linspace(top / _POINTS, top, _POINTS)
    found = []
    for name in elements:
        for side, sign in (("drive", 1.0), ("back", -1.0)):
            quantity = f"{name}.efficiency_{side}"

            def curve(values: Array, quantity: str = quantity) -> Array:
                at = [
                    next(q.values for q in derive(chain, values, float(x)) if q.name == quantity)
                    for x in load
                ]
                return np.stack(at, axis=1)

            band = judge.band(curve, gauge_free=False, draws=_DRAWS)
            found.append(
                EfficiencyCurve(quantity, side, load, band, _near(load, np.sort(sign * joint)))
            )
    return tuple(found)


def _near(load: Array, seen: Array) -> Flags:
    """Tell which loads at least three outputs were near."""
    reach = 1.5 * (load[1] - load[0])
    count = np.searchsorted(seen, load + reach) - np.searchsorted(seen, load - reach)
    return np.asarray(count >= 3)


def efficiency_figure(fit: Fit, summary: Mapping[str, Any]) -> Figure | None:
    """Draw efficiency over load, with references where the configuration gives any.

    A panel for each of at most two elements with load losses. Where the data do not
    determine it, the band is hatched; where no recording had such a load, there is only
    a dashed median. A reference stands at the load the summary states efficiencies for.

    Parameters
    ----------
    fit
        A finished fit.
    summary
        From :func:`bayesfric.report.summary.summary.summarise`, for its references.

    Returns
    -------
    matplotlib.figure.Figure or None
        A column wide, or a page for two elements; ``None`` where no element has a load
        loss, or nothing loads it.
    """
    curves = efficiency_curves(fit)
    if not curves:
        return None
    panels = [curves[i : i + 2] for i in range(0, len(curves), 2)][:_MOST]
    width = COLUMN if len(panels) == 1 else PAGE
    median = fit.target.chain_values(fit.posterior.median[None])[0]
    stated = typical_load(fit.chain, fit.observations, median)
    references = summary.get("references", {})
    with paper_style():
        handles = _handles(curves) + _reference_handles(panels, references)
        columns = 2 if width == COLUMN else len(handles)
        above = _ABOVE + _LINE * -(-len(handles) // columns)
        figure = Figure(figsize=(width, _HEIGHT))
        axes = figure.subplots(
            1,
            len(panels),
            squeeze=False,
            gridspec_kw={
                **margins(figure, left=_LEFT, right=_RIGHT, bottom=_BOTTOM, top=above),
                "wspace": 0.18,
            },
        )[0]
        for ax, panel in zip(axes, panels, strict=True):
            _panel(ax, fit, panel, several=len(panels) > 1)
            _references(ax, panel, references, stated)
        figure.legend(
            handles=handles,
            loc="upper left",
            ncols=columns,
            bbox_to_anchor=(0.04 / width, 1.0),
            borderaxespad=0.2,
            borderpad=0.2,
            columnspacing=1.2,
            handlelength=1.8,
            labelspacing=0.25,
        )
    return figure


def _panel(ax: Axes, fit: Fit, panel: tuple[EfficiencyCurve, ...], *, several: bool) -> None:
    for curve in panel:
        _, colour, mark = _SIDES[curve.side]
        b = curve.band
        present = np.isfinite(b.median)
        for open_ in (False, True):
            where = present & curve.covered & (b.determined != open_)
            if where.any():
                ax.fill_between(
                    curve.load,
                    b.low,
                    b.high,
                    where=joined(where, present & curve.covered).tolist(),
                    facecolor="none" if open_ else colour,
                    edgecolor=colour if open_ else "none",
                    alpha=1.0 if open_ else 0.3,
                    # the other way round for the other direction of power
                    hatch=(OPEN_HATCH if curve.side == "drive" else OPEN_HATCH.replace("/", "\\"))
                    if open_
                    else None,
                    linewidth=0.4 if open_ else 0.0,
                    gid="open" if open_ else "band",
                )
        outside: dict[str, Any] = {"linestyle": _OUTSIDE, "linewidth": 0.6}
        ax.plot(curve.load, b.median, color=colour, gid="outside", **outside)
        ax.plot(
            curve.load,
            np.where(curve.covered, b.median, np.nan),
            color=colour,
            marker=mark,
            markersize=2.6,
            markevery=6,
            gid="median",
        )
    unit = "N m" if fit.chain.load.motion == "rotary" else "N"
    kind = "torque" if fit.chain.load.motion == "rotary" else "force"
    ax.set_xlabel(rf"load {kind} at the joint $|\Gamma|$ ({unit})")
    element = panel[0].name.rpartition(".")[0]
    ax.set_ylabel(f"efficiency of {element} (–)" if several else "efficiency (–)")
    ax.set_xlim(0.0, float(panel[0].load[-1]))
    ax.set_ylim(0.0, 1.0)
    few_ticks(ax.xaxis, 6)
    few_ticks(ax.yaxis, 6)


def _marked(side: str) -> dict[str, Any]:
    """Look of a reference."""
    look = {"color": MEASURED, "markersize": 4.0, "markerfacecolor": "white"}
    return look | {"marker": _SIDES[side][2], "linestyle": "none"}


def _references(
    ax: Axes, panel: tuple[EfficiencyCurve, ...], references: Mapping[str, Any], stated: float
) -> None:
    for curve in panel:
        if (given := references.get(curve.name)) is not None:
            ax.errorbar(
                [stated],
                [given["value"]],
                yerr=[given["sd"]] if given.get("sd") else None,
                capsize=2.0,
                elinewidth=0.8,
                zorder=3.0,
                gid="reference",
                **_marked(curve.side),
            )


def _reference_handles(
    panels: Sequence[Sequence[EfficiencyCurve]], references: Mapping[str, Any]
) -> list[Line2D | Patch]:
    said = {
        (given["source"], curve.side): None
        for panel in panels
        for curve in panel
        if (given := references.get(curve.name)) is not None
    }
    return [
        Line2D([], [], label=f"{source}, {_SIDES[side][0]}".replace("$", r"\$"), **_marked(side))
        for source, side in said
    ]


def _handles(curves: Sequence[EfficiencyCurve]) -> list[Line2D | Patch]:
    handles: list[Line2D | Patch] = []
    for side, (words, colour, mark) in _SIDES.items():
        look: dict[str, Any] = {"color": colour, "marker": mark, "markersize": 2.6}
        handles.append(Line2D([], [], label=rf"{words}, ${_SYMBOLS[side]}$", **look))
    shown = [c.covered & np.isfinite(c.band.median) for c in curves]
    if any((seen & c.band.determined).any() for seen, c in zip(shown, curves, strict=True)):
        words = f"{100 * LEVEL:.0f} % band"
        handles.append(Patch(facecolor=PALETTE[1], alpha=0.3, label=words))
    if any((seen & ~c.band.determined).any() for seen, c in zip(shown, curves, strict=True)):
        look = {"facecolor": "none", "edgecolor": MEASURED, "linewidth": 0.0}
        words = "NOT determined by the data"
        handles.append(Patch(hatch=OPEN_HATCH, label=words, **look))
    if any((~c.covered & np.isfinite(c.band.median)).any() for c in curves):
        look = {"color": MEASURED, "linestyle": _OUTSIDE, "linewidth": 0.6}
        handles.append(Line2D([], [], label="not recorded there", **look))
    return handles
