"""Friction over speed: median, 90 % band, and where the data determine it."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.ndimage import binary_dilation

from bayesfric.identifiability.friction_curve import (
    FEWEST,
    NEAR,
    Curve,
    friction_curves,
    has_open_scale,
)
from bayesfric.inference.fitting import Fit
from bayesfric.report.figures import style
from bayesfric.report.figures.style import Look, few_ticks
from bayesfric.results.reported import LEVEL

_OUTSIDE: Look = {"linestyle": (0, (3.0, 2.0)), "linewidth": 0.6, "gid": "outside"}


def friction_figure(fit: Fit) -> Figure:
    """Draw friction at the motor over speed, a column wide, at some loads if it depends on load.

    Loads below zero drive the motor (back-driving). Where hardly any outputs are near, the median
    is dashed, without a band; where the data do not determine the curve the band is hatched.
    """
    curves = friction_curves(fit)
    rotary = fit.chain.motor_motion == "rotary"
    kind, unit, per = ("torque", "N m", "rad/s") if rotary else ("force", "N", "m/s")
    colour = style.PALETTE[0]
    handles = [
        Line2D([], [], color=colour, label="posterior median", gid="median"),
        Patch(label=f"{100 * LEVEL:.0f} % band", **_area(colour, False)),
        Line2D([], [], color=colour, label=f"fewer than {FEWEST} outputs near", **_OUTSIDE),
        Patch(label="NOT determined by the data", **_area(colour, True)),
    ]
    with style.paper_figure(style.COLUMN, 2.4) as figure:
        ax = figure.subplots()
        for colour, curve in zip(style.PALETTE, curves, strict=False):
            load = float(curve.load[0])
            label = f"{load:+.3g} {unit}".replace("-", "\N{MINUS SIGN}") if load else "no load"
            _draw(ax, curve, colour, label)
        ax.axhline(0.0, color="0.6", linewidth=0.5, zorder=0.5)
        ax.set(xlabel=rf"motor speed $\dot q_m$ ({per})", ylabel=f"friction {kind} $F$ ({unit})")
        few_ticks(ax.xaxis, 6)
        few_ticks(ax.yaxis, 6)
        if len(curves) > 1:
            ax.legend(title="at load", title_fontsize=style.SMALL, alignment="left")
        drawn = {artist.get_gid() for artist in ax.get_children()}
        style.legend_above(figure, [h for h in handles if h.get_gid() in drawn], 2)
    return figure


def _draw(ax: Axes, curve: Curve, colour: str, label: str) -> None:
    """Draw median and band where recordings were, and beyond that a dashed median alone."""
    x, shown, (low, median, high) = curve.speed, curve.shown, np.sign(curve.speed) * curve.ends
    for is_open in (False, True):
        where = shown & (curve.determined != is_open)
        if where.any():
            # grown by one neighbour, so that parts of a band meet
            inside = (binary_dilation(where) & shown).tolist()
            ax.fill_between(x, low, high, where=inside, **_area(colour, is_open))
    if not shown[np.isfinite(median)].all():
        ax.plot(x, median, color=colour, **_OUTSIDE)
    near = np.where(binary_dilation(shown), median, np.nan)
    ax.plot(x, near, color=colour, label=label, gid="median")


def _area(colour: str, is_open: bool) -> Look:
    if is_open:
        hatch = {"hatch": style.OPEN_HATCH, "linewidth": 0.4, "gid": "open"}
        return {"facecolor": "none", "edgecolor": colour} | hatch
    return {"facecolor": colour, "edgecolor": "none", "alpha": 0.3, "linewidth": 0.0, "gid": "band"}


def friction_caption(fit: Fit) -> str:
    """Say what load means in the figure, which depends on what the run can determine."""
    caption = (
        "Friction of the whole joint at the motor, at constant speed: posterior median and "
        f"{100 * LEVEL:.0f} % band, hatched where the data do not determine it. Dashed where fewer "
        f"than {FEWEST} compared outputs are near: within {100 * NEAR:.0f} % of the range of speed"
    )
    load = "the torque at the joint over the ratio, positive against the motion."
    if has_open_scale(fit):
        load = (
            "the mean of its torque at the motor while driving and while driven: the scale "
            "between load and gearbox is open, and only this mean is the same for all parameters "
            "that make the same torque."
        )
    lossy = any(element.load_loss != "none" for element in fit.chain.elements)
    caption += (
        f" and, at once, of load. Load is {load}" if lossy else ". No friction depends on load."
    )
    if fit.chain.gain:
        caption += " Torque is the true one, as in the tables: what was recorded, times drive.gain."
    return caption
