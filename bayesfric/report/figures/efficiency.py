"""Efficiency of the gearbox over the load, driving and back-driven, eq. (4)."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesfric.inference.fitting import Fit
from bayesfric.mechanism.derived import derive
from bayesfric.recordings.arrays import Flags
from bayesfric.report.figures import style
from bayesfric.report.figures.curve_band import (
    FEWEST,
    Curve,
    CurveJudge,
    CurveLook,
    covered,
    curve_handles,
    draw_curve,
)
from bayesfric.report.figures.registry import RunFigure
from bayesfric.report.figures.style import Array, Look, few_ticks, legend_above, paper_figure
from bayesfric.report.summary.derived_quantities import LEVEL

_POINTS = 40
_DRAWS = 500
_MOST = 2
_HEIGHT = 2.6
_SAID = {"drive": r"motor drives, $\eta_m$", "back": r"load drives, $\eta_r$"}
# hatched the other way round for the other direction of power
_LOOKS = {
    # wide below and thin above, so that both are seen where they agree
    "drive": CurveLook(style.PALETTE[1], "o", width=2.4),
    "back": CurveLook(style.PALETTE[2], "s", hatch=style.OPEN_HATCH_BACK, start=3),
}


# Curves by element and direction of power, `drive` or `back`.
Curves = Mapping[tuple[str, str], Curve]


def efficiency_curves(fit: Fit) -> dict[tuple[str, str], Curve]:
    """Evaluate eq. (4) over the loads of the recordings, two curves an element with a load loss.

    Without a value where half of the draws call the transmission irreversible.

    The definition is that of :func:`bayesfric.mechanism.derived.derive`: constant losses in
    and behind the element count, viscous ones do not. Unlike friction at the motor it is
    of the load at the joint, which scaling leg and alpha together does change: where that
    scale is open, so are efficiencies. None where there is no load.
    """
    chain = fit.chain
    elements = [element.name for element in chain.elements if element.load_loss != "none"]
    if not elements:
        return {}
    judge = CurveJudge(fit)
    place = covered(fit, judge.median, open_scale=False)
    joint = chain.ratio * place.load
    top = float(np.quantile(np.abs(joint), 0.995))
    if not top > 0.0:
        return {}
    load = np.linspace(top / _POINTS, top, _POINTS)

    def of(element: str, side: str, sign: float) -> Curve:
        def curve(values: Array) -> Array:
            derived = ({q.name: q.values for q in derive(chain, values, float(x))} for x in load)
            return np.stack([known[f"{element}.efficiency_{side}"] for known in derived], axis=1)

        band = judge.band(curve, gauge_free=False, draws=_DRAWS)
        return Curve(np.empty(0), load, *band, _near(load, np.sort(sign * joint)))

    sides = (("drive", 1.0), ("back", -1.0))
    return {(one, side): of(one, side, sign) for one in elements for side, sign in sides}


def _near(load: Array, seen: Array) -> Flags:
    """Tell which loads ``FEWEST`` outputs were near."""
    reach = 1.5 * (load[1] - load[0])
    count = np.searchsorted(seen, load + reach) - np.searchsorted(seen, load - reach)
    return np.asarray(count >= FEWEST)


def efficiency_figure(fit: Fit) -> Figure | None:
    """Draw efficiency over load.

    A panel for each of at most two elements with load losses, a column wide or a page; ``None``
    where there is none, or nothing loads it. Where the data do not determine it, the band is
    hatched; where no recording had such a load, there is only a dashed median.
    """
    curves = dict(list(efficiency_curves(fit).items())[: 2 * _MOST])
    if not curves:
        return None
    elements = list(dict.fromkeys(element for element, _ in curves))
    panels = [{side: curves[one, side] for side in _LOOKS} for one in elements]
    width = style.COLUMN if len(panels) == 1 else style.PAGE
    kind, unit = ("torque", "N m") if fit.chain.load.motion == "rotary" else ("force", "N")
    with paper_figure(width, _HEIGHT) as figure:
        axes = figure.subplots(1, len(panels), squeeze=False)[0]
        for ax, element, panel in zip(axes, elements, panels, strict=True):
            for side, curve in panel.items():
                draw_curve(ax, curve.load, curve, _LOOKS[side])
            ax.set_xlabel(rf"load {kind} at the joint $|\Gamma|$ ({unit})")
            ax.set_ylabel(f"efficiency of {element} (–)")
            ax.set_xlim(0.0, float(curve.load[-1]))
            ax.set_ylim(_bottom(panel.values()), 1.0)
            few_ticks(ax.xaxis, 6)
            few_ticks(ax.yaxis, 6)
        handles: list[Artist] = []
        for side, look in _LOOKS.items():
            mark: Look = {"marker": look.marker, "markersize": 2.6, "linewidth": look.width}
            handles.append(Line2D([], [], color=look.colour, label=_SAID[side], **mark))
        handles += curve_handles(list(curves.values()), style.PALETTE[1], style.MEASURED)
        legend_above(figure, handles, 2 if width == style.COLUMN else None)
    return figure


def _bottom(panel: Collection[Curve]) -> float:
    """Begin the axis at zero, or where all that is drawn lies in its upper half below that."""
    drawn = [x for curve in panel for x in (curve.median, curve.low[curve.shown])]
    lost = 1.0 - float(np.nanmin(np.concatenate([np.ones(1), *drawn])))
    return 0.0 if lost > 0.4 else 1.0 - max(1.25 * lost, 0.02)


def _caption(found: Curves) -> str:
    """Say what the curves are, and only of what is drawn how it is drawn."""
    curves = found.values()
    said = [
        "Efficiency of eq. (4) of one element over the load at the joint: posterior median and "
        f"{100 * LEVEL:.0f} % band, constant losses in and behind the element counted, viscous "
        "ones and all that stands before it, as the motor's own loss, not."
    ]
    if not all(curve.covered.all() for curve in curves):
        said.append(f"Dashed where fewer than {FEWEST} compared outputs had about such loads.")
    if any((curve.shown & ~curve.determined).any() for curve in curves):
        said.append("Hatched where the data do not determine it.")
    return " ".join(said)


FIGURE = RunFigure(
    stem="efficiency",
    title="Efficiency against load",
    section="efficiency",
    draw=lambda run: efficiency_figure(run.fit.wide),
    caption=lambda run: _caption(efficiency_curves(run.fit.wide)),
)
