"""Friction of the whole joint at the motor, over speed and over load."""

from __future__ import annotations

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesfric.inference.fitting import Fit
from bayesfric.recordings.arrays import Flags
from bayesfric.report.figures import style
from bayesfric.report.figures.friction_curves import (
    FEWEST,
    NEAR,
    Curve,
    FrictionCurves,
    friction_curves,
    has_open_scale,
)
from bayesfric.report.figures.registry import RunFigure
from bayesfric.report.figures.style import (
    OPEN_HATCH,
    Array,
    Look,
    few_ticks,
    legend_above,
    paper_figure,
)
from bayesfric.report.summary.derived_quantities import LEVEL

_HEIGHT = 2.4
_OUTSIDE: Look = {"linestyle": (0, (3.0, 2.0)), "linewidth": 0.6}


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
        legend_above(figure, _handles([*found.over_speed, *found.over_load]), 2 if alone else None)
    return figure


def _over_speed(ax: Axes, fit: Fit, found: FrictionCurves) -> None:
    several = len(found.over_speed) > 1
    for k, curve in enumerate(found.over_speed):
        load = float(curve.load[0])
        label = ("no load" if load == 0.0 else _signed(load, _units(fit)[1])) if several else None
        for side in np.unique(np.sign(curve.speed)):
            part = curve.part(np.sign(curve.speed) == side, float(side))
            _draw(ax, part, part.speed, style.PALETTE[k], label)
            label = None
    ax.axhline(0.0, color="0.6", linewidth=0.5, zorder=0.5)
    ax.set_xlabel(rf"motor speed $\dot q_m$ ({_units(fit)[2]})")
    _friction_axis(ax, fit, 6, "at load" if several else "")


def _over_load(ax: Axes, fit: Fit, found: FrictionCurves) -> None:
    for k, curve in enumerate(found.over_load):
        label = _signed(float(curve.speed[0]), _units(fit)[2])
        _draw(ax, curve, curve.load, style.PALETTE[k], label)
    ax.axvline(0.0, color="0.6", linewidth=0.5, zorder=0.5)
    low, high = ax.get_ylim()
    low = min(low, 0.0)
    # room for the words above and below
    ax.set_ylim(low - 0.02 * (high - low), high + 0.38 * (high - low))
    said: Look = {"fontsize": style.SMALL, "color": "0.35", "transform": ax.transAxes}
    ax.text(0.03, 0.03, "load helps", ha="left", va="bottom", **said)
    ax.text(0.97, 0.03, "load resists", ha="right", va="bottom", **said)
    ax.set_xlabel(f"load {_load_symbol(fit, found.open_scale)} ({_units(fit)[1]})")
    _friction_axis(ax, fit, 5, "at motor speed")


def _draw(ax: Axes, curve: Curve, x: Array, colour: str, label: str | None) -> None:
    """Draw median and band where recordings were, and beyond that a dashed median alone."""
    shown, (low, median, high) = curve.shown, curve.ends
    for open_ in (False, True):
        where = shown & (curve.determined != open_)
        if where.any():
            inside, gid = _joined(where, shown).tolist(), "open" if open_ else "band"
            ax.fill_between(x, low, high, where=inside, gid=gid, **_area(colour, open_))
    ax.plot(x, median, color=colour, gid="outside", **_OUTSIDE)
    seen = np.where(_joined(shown, np.isfinite(median)), median, np.nan)
    ax.plot(x, seen, color=colour, label=label, gid="median")


def _area(colour: str, open_: bool) -> Look:
    if open_:
        return {"facecolor": "none", "edgecolor": colour, "hatch": OPEN_HATCH, "linewidth": 0.4}
    return {"facecolor": colour, "edgecolor": "none", "alpha": 0.3, "linewidth": 0.0}


def _joined(flags: Flags, within: Flags) -> Flags:
    """Grow by one neighbour, so that parts of a band meet."""
    grown = flags.copy()
    grown[1:] |= flags[:-1]
    grown[:-1] |= flags[1:]
    return grown & within


def _handles(curves: list[Curve]) -> list[Artist]:
    """List what a legend explains of curves."""
    colour = style.PALETTE[0]
    told = Patch(label=f"{100 * LEVEL:.0f} % band", **_area(colour, False))
    few = Line2D([], [], color=colour, label=f"fewer than {FEWEST} outputs near", **_OUTSIDE)
    left = Patch(label="NOT determined by the data", **_area(colour, True))
    needed = {
        told: any((c.shown & c.determined).any() for c in curves),
        few: any((~c.covered & np.isfinite(c.median)).any() for c in curves),
        left: any((c.shown & ~c.determined).any() for c in curves),
    }
    median = Line2D([], [], color=colour, label="posterior median")
    return [median, *(handle for handle, there in needed.items() if there)]


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


def _load_symbol(fit: Fit, open_scale: bool) -> str:
    """Symbol of the loss-free torque of the load at the motor, ready for Matplotlib."""
    if not open_scale:
        return r"$\Gamma/N$"
    two = [element for element in fit.chain.elements if element.load_loss == "two"]
    return r"$\lambda_1\Gamma/N$" if len(two) == 1 else r"$\overline{\Gamma/\alpha N}$"


def friction_caption(fit: Fit) -> str:
    """Say what load means in the figure, which depends on what the run can tell."""
    said = (
        "Friction of the whole joint at the motor, at constant speed: posterior median and "
        f"{100 * LEVEL:.0f} % band, hatched where the data do not tell. Dashed where fewer than "
        f"{FEWEST} compared outputs are near: within {100 * NEAR:.0f} % of the range of speed"
    )
    if all(element.load_loss == "none" for element in fit.chain.elements):
        said += ". No element has a loss that depends on load."
    elif has_open_scale(fit):
        said += (
            " and, at once, of load. Load is the mean of what the motor feels of it while driving "
            "and while driven: the scale between load and gearbox is open, and only this mean is "
            "the same for all parameters that make the same torque."
        )
    else:
        said += (
            " and, at once, of load. Load is the torque at the joint over the ratio, positive "
            "against the motion."
        )
    if fit.chain.gain:
        said += " Torque is the true one, as in the tables: what was recorded, times drive.gain."
    return said


FIGURE = RunFigure(
    stem="friction",
    title="Friction of the joint",
    section="friction",
    draw=lambda run: friction_figure(run.fit.wide),
    caption=lambda run: friction_caption(run.fit.wide),
)
