"""Friction of the whole joint at the motor, over speed and over load."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesfric.inference.fitting import Fit
from bayesfric.recordings.arrays import Flags
from bayesfric.report.figures import style
from bayesfric.report.figures.curve_band import (
    FEWEST,
    NEAR,
    Covered,
    Curve,
    CurveJudge,
    CurveLook,
    covered,
    curve_handles,
    draw_curve,
    friction_torque,
)
from bayesfric.report.figures.registry import RunFigure
from bayesfric.report.figures.style import (
    Array,
    Look,
    few_ticks,
    legend_above,
    paper_figure,
)
from bayesfric.report.summary.derived_quantities import LEVEL

_POINTS = 121
_HEIGHT = 2.4
_MARKS = ("o", "s", "^")


@dataclass(frozen=True, eq=False)
class FrictionCurves:
    """Everything the friction figure shows."""

    open_scale: bool  # whether loads are the mean of what driving and back-driving feel
    over_speed: tuple[Curve, ...]  # at no load, at a driven and at a driving load
    over_load: tuple[Curve, ...]  # at a low and a high speed; empty without load losses


def friction_curves(fit: Fit) -> FrictionCurves:
    """Evaluate the friction curves of a fit where its recordings ran."""
    judge = CurveJudge(fit)
    place = covered(fit, judge.median, open_scale=judge.open_scale)
    lossy = any(element.load_loss != "none" for element in fit.chain.elements)
    lossy = lossy and float(np.ptp(place.load)) > 0.0

    def along(speed: Array, load: Array) -> Curve:
        band = judge.band(
            lambda x: friction_torque(fit.chain, x, speed, load, open_scale=judge.open_scale),
            gauge_free=judge.open_scale,
        )
        near = place.near(speed, load if lossy else None)
        return Curve(speed, load, *band, near)

    low, high = (float(x) for x in (place.speed.min(), place.speed.max()))
    # friction jumps at rest: no point there
    least = 1e-3 * max(-low, high)
    speeds = np.concatenate(
        [np.linspace(low, -least, _POINTS // 2), np.linspace(least, high, _POINTS // 2)]
        if low < 0.0 < high
        else [np.linspace(low, high, _POINTS)]
    )
    loads = [0.0]
    if lossy:
        loads += [load for side in (1.0, -1.0) if (load := _stated(place, speeds, side))]
    over_speed = [along(speeds, np.full_like(speeds, load)) for load in loads]
    over_load = []
    if lossy:
        # nearly all: single jerks would leave the rest no room
        first, last = (float(x) for x in np.quantile(place.load, [0.005, 0.995]))
        grid = np.linspace(first, last, _POINTS)
        top = float(np.quantile(np.abs(place.speed), 0.95))
        way = 1.0 if high > 0.0 else -1.0
        over_load = [
            along(np.full_like(grid, way * _round(share * top)), grid) for share in (0.25, 0.75)
        ]
    return FrictionCurves(judge.open_scale, tuple(over_speed), tuple(over_load))


def _stated(place: Covered, speeds: Array, side: float) -> float:
    """Find the round load of one direction of power that was met at most speeds."""
    mine = side * place.load[side * place.load > 0.0]
    if not mine.size:
        return 0.0
    choices = {_round(float(x)) for x in np.quantile(mine, [0.95, 0.9, 0.75, 0.5, 0.25])}
    # the largest of those that are as good as any, for there the load shows most
    seen = {x: place.near(speeds, np.full_like(speeds, side * x)).mean() for x in choices}
    return side * max(x for x in choices if seen[x] >= 0.8 * max(seen.values()))


def _round(x: float) -> float:
    """Round to one digit."""
    return round(x, -math.floor(math.log10(x))) if x > 0.0 else x


def friction_figure(fit: Fit) -> Figure:
    """Draw friction over speed, and over load where there is a load loss.

    All at the motor, with the posterior median and its 90 % band. Loads left of zero drive
    the motor (back-driving). Where hardly any outputs are near the median goes on dashed,
    without a band; where the data do not determine the curve the band is hatched.
    """
    found = friction_curves(fit)
    alone = not found.over_load
    with paper_figure(style.COLUMN if alone else style.PAGE, _HEIGHT) as figure:
        axes = figure.subplots(1, 1 if alone else 2, squeeze=False)[0]
        _over_speed(axes[0], fit, found)
        if not alone:
            _over_load(axes[1], fit, found)
        median = Line2D([], [], color=style.PALETTE[0], label="posterior median")
        curves = [*found.over_speed, *found.over_load]
        handles = [median, *curve_handles(curves, style.PALETTE[0], style.PALETTE[0])]
        legend_above(figure, handles, 2 if alone else None)
    return figure


def _over_speed(ax: Axes, fit: Fit, found: FrictionCurves) -> None:
    several = len(found.over_speed) > 1
    for k, curve in enumerate(found.over_speed):
        load = float(curve.load[0])
        label = ("no load" if load == 0.0 else _signed(load, _units(fit)[1])) if several else None
        for side in (-1.0, 1.0):
            mine = np.sign(curve.speed) == side
            if mine.any():
                mark = _MARKS[k] if several else ""  # else it looks like a measured point
                _draw(ax, curve, curve.speed, mine, k, side, label, mark)
                label = None
    ax.axhline(0.0, color="0.6", linewidth=0.5, zorder=0.5)
    ax.set_xlabel(rf"motor speed $\dot q_m$ ({_units(fit)[2]})")
    _friction_axis(ax, fit, 6, "at load" if several else "")


def _over_load(ax: Axes, fit: Fit, found: FrictionCurves) -> None:
    for k, curve in enumerate(found.over_load):
        words = _signed(float(curve.speed[0]), _units(fit)[2])
        whole = np.ones(curve.load.size, dtype=np.bool_)
        _draw(ax, curve, curve.load, whole, k, 1.0, words, _MARKS[k])
    ax.axvline(0.0, color="0.6", linewidth=0.5, zorder=0.5)
    low, high = ax.get_ylim()
    low = min(low, 0.0)
    # room for the words above and below
    ax.set_ylim(low - 0.02 * (high - low), high + 0.38 * (high - low))
    said: Look = {"fontsize": style.SMALL, "color": "0.35", "transform": ax.transAxes}
    ax.text(0.03, 0.03, "load helps", ha="left", va="bottom", **said)
    ax.text(0.97, 0.03, "load resists", ha="right", va="bottom", **said)
    ax.set_xlabel(f"load {load_symbol(fit, open_scale=found.open_scale)} ({_units(fit)[1]})")
    _friction_axis(ax, fit, 5, "at motor speed")


def _draw(
    ax: Axes,
    curve: Curve,
    x: Array,
    mine: Flags,
    k: int,
    side: float,
    label: str | None,
    mark: str,
) -> None:
    every = max(1, int(mine.sum()) // 6)
    start = max(0, every // 2 - k * every // 4)
    look = CurveLook(style.PALETTE[k], mark, start=start, every=every)
    draw_curve(ax, x[mine], curve.part(mine, side), look, label)


def _signed(x: float, unit: str) -> str:
    return f"{x:+.3g} {unit}".replace("-", "\N{MINUS SIGN}")


def _units(fit: Fit) -> tuple[str, str, str]:
    """Name torque or force at the motor, its unit, and that of speed."""
    rotary = fit.chain.motor_motion == "rotary"
    return ("torque", "N m", "rad/s") if rotary else ("force", "N", "m/s")


def _friction_axis(ax: Axes, fit: Fit, ticks: int, legend: str) -> None:
    kind, unit, _ = _units(fit)
    ax.set_ylabel(f"friction {kind} $F$ ({unit})")
    few_ticks(ax.xaxis, ticks)
    few_ticks(ax.yaxis, 6)
    if legend:
        ax.legend(loc="upper left", title=legend, title_fontsize=style.SMALL, alignment="left")


def load_symbol(fit: Fit, *, open_scale: bool) -> str:
    """Symbol of the loss-free torque of the load at the motor, ready for Matplotlib."""
    if not open_scale:
        return r"$\Gamma/N$"
    two = [element for element in fit.chain.elements if element.load_loss == "two"]
    return r"$\lambda_1\Gamma/N$" if len(two) == 1 else r"$\overline{\Gamma/\alpha N}$"


def friction_caption(fit: Fit) -> str:
    """Say what load means in the figure, which depends on what the run can tell."""
    start = (
        "Friction of the whole joint at the motor, at constant speed: posterior median and "
        f"{100 * LEVEL:.0f} % band, hatched where the data do not tell. Dashed where fewer than "
        f"{FEWEST} compared outputs are near: within {100 * NEAR:.0f} % of the range of speed"
    )
    true = ""
    if fit.chain.gain:
        true = " Torque is the true one, as in the tables: what was recorded, times drive.gain."
    if all(element.load_loss == "none" for element in fit.chain.elements):
        return start + ". No element has a loss that depends on load." + true
    start = f"Marks on lines tell them apart and are no measurements. {start}"
    start += " and, at once, of load. "
    load = "Load is the torque at the joint over the ratio, positive against the motion."
    if CurveJudge(fit).open_scale:
        load = (
            "Load is the mean of what the motor feels of it while driving and while driven: the "
            "scale between load and gearbox is open, and only this mean is the same for all "
            "parameters that make the same torque."
        )
    return start + load + true


FIGURE = RunFigure(
    stem="friction",
    title="Friction of the joint",
    section="friction",
    draw=lambda run: friction_figure(run.fit.wide),
    caption=lambda run: friction_caption(run.fit.wide),
)
