"""Friction over speed: median, 90 % band, and where the data determine it at all.

The joint runs at constant speed against a constant load. With ``T`` the true motor
torque (without its constant offset) and ``L`` the loss-free torque of the load, both at the
motor, friction is ``F = T - L``. What is recorded is ``T`` over ``drive.gain``, where that is one.

``L`` is where care is due. A recording tells ``Gamma/N``, the torque of the leg over the
ratio, only up to the scaling of leg parameters and ``alpha_1, alpha_2`` that changes no
torque. ``(1 + mu_1) Gamma/N`` and ``(1 - mu_2) Gamma/N``, what the motor feels of the load
while it drives and while it is driven, are known all the same, and so is their mean,
``lambda_1 Gamma/N`` of eq. (13). Where the scale is open this mean therefore stands for the
load: ``F(speed, L)`` then is the same for all members of the ridge. It is what an
experiment finds that lifts and lowers the load at one speed, calls half the sum of the two
torques load and half their difference friction. Where something fixes the scale (a known
mass, a known parameter of the leg, ``mu_1 = mu_2``), ``L`` is ``Gamma/N`` itself.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.ndimage import binary_dilation

from bayesfric.estimates.torque import load_at_outputs
from bayesfric.identifiability.local import WIDE, local_information
from bayesfric.inference.fitting import Fit
from bayesfric.mechanism import kernels
from bayesfric.mechanism.inverse import load_reach
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import State
from bayesfric.recordings.arrays import Array, Flags
from bayesfric.recordings.inputs import AT_ROOM
from bayesfric.report.figures import style
from bayesfric.report.figures.registry import RunFigure
from bayesfric.report.figures.style import OPEN_HATCH, Look, few_ticks, legend_above, paper_figure
from bayesfric.report.summary.derived_quantities import LEVEL, prior_draws

# Of the recorded range of speed, and of load: outputs so near to a place cover it.
NEAR = 0.08
# Outputs that must be near a place for it to count as recorded.
FEWEST = 3
# A quantile of so many draws is known to a fortieth of the band's width.
_DRAWS = 1000
_PRIOR_DRAWS = 500
_POINTS = 121
_HEIGHT = 2.4
_OUTSIDE: Look = {"linestyle": (0, (3.0, 2.0)), "linewidth": 0.6}


def friction_figure(fit: Fit) -> Figure:
    """Draw friction over speed, at some loads where there is a load loss, a column wide.

    All at the motor, with the posterior median and its 90 % band. Loads below zero drive
    the motor (back-driving). Where hardly any outputs are near the median goes on dashed,
    without a band; where the data do not determine the curve the band is hatched.
    """
    curves = friction_curves(fit)
    rotary = fit.chain.motor_motion == "rotary"
    kind, unit, per = ("torque", "N m", "rad/s") if rotary else ("force", "N", "m/s")
    with paper_figure(style.COLUMN, _HEIGHT) as figure:
        ax = figure.subplots()
        for k, curve in enumerate(curves):
            load = float(curve.load[0])
            label = f"{load:+.3g} {unit}".replace("-", "\N{MINUS SIGN}") if load else "no load"
            _draw(ax, curve, style.PALETTE[k], label)
        ax.axhline(0.0, color="0.6", linewidth=0.5, zorder=0.5)
        ax.set(xlabel=rf"motor speed $\dot q_m$ ({per})", ylabel=f"friction {kind} $F$ ({unit})")
        few_ticks(ax.xaxis, 6)
        few_ticks(ax.yaxis, 6)
        if len(curves) > 1:
            ax.legend(title="at load", title_fontsize=style.SMALL, alignment="left")
        legend_above(figure, style.explained(figure, _handles()), 2)
    return figure


def _draw(ax: Axes, curve: Curve, colour: str, label: str) -> None:
    """Draw median and band where recordings were, and beyond that a dashed median alone."""
    x, shown, (low, median, high) = curve.speed, curve.shown, np.sign(curve.speed) * curve.ends
    for open_ in (False, True):
        where = shown & (curve.determined != open_)
        if where.any():
            # grown by one neighbour, so that parts of a band meet
            inside = (binary_dilation(where) & shown).tolist()
            gid = "open" if open_ else "band"
            ax.fill_between(x, low, high, where=inside, gid=gid, **_area(colour, open_))
    if not shown[np.isfinite(median)].all():
        ax.plot(x, median, color=colour, gid="outside", **_OUTSIDE)
    seen = np.where(binary_dilation(shown), median, np.nan)
    ax.plot(x, seen, color=colour, label=label, gid="median")


def _area(colour: str, open_: bool) -> Look:
    if open_:
        return {"facecolor": "none", "edgecolor": colour, "hatch": OPEN_HATCH, "linewidth": 0.4}
    return {"facecolor": colour, "edgecolor": "none", "alpha": 0.3, "linewidth": 0.0}


def _handles() -> list[Artist]:
    """List what a legend explains of curves."""
    colour, few = style.PALETTE[0], f"fewer than {FEWEST} outputs near"
    return [
        Line2D([], [], color=colour, label="posterior median", gid="median"),
        Patch(label=f"{100 * LEVEL:.0f} % band", gid="band", **_area(colour, False)),
        Line2D([], [], color=colour, label=few, gid="outside", **_OUTSIDE),
        Patch(label="NOT determined by the data", gid="open", **_area(colour, True)),
    ]


def friction_caption(fit: Fit) -> str:
    """Say what load means in the figure, which depends on what the run can tell."""
    said = (
        "Friction of the whole joint at the motor, at constant speed: posterior median and "
        f"{100 * LEVEL:.0f} % band, hatched where the data do not tell. Dashed where fewer than "
        f"{FEWEST} compared outputs are near: within {100 * NEAR:.0f} % of the range of speed"
    )
    load = "the torque at the joint over the ratio, positive against the motion."
    if has_open_scale(fit):
        load = (
            "the mean of what the motor feels of it while driving and while driven: the scale "
            "between load and gearbox is open, and only this mean is the same for all parameters "
            "that make the same torque."
        )
    lossy = any(element.load_loss != "none" for element in fit.chain.elements)
    said += f" and, at once, of load. Load is {load}" if lossy else ". No loss depends on load."
    if fit.chain.gain:
        said += " Torque is the true one, as in the tables: what was recorded, times drive.gain."
    return said


@dataclass(frozen=True, eq=False)
class Curve:
    """Friction at ``N`` places, ``(N,)`` each."""

    speed: Array  # the motor's
    load: Array  # loss-free, see the module
    # `(3, N)`: low end of the central 90 % interval, median and high end, over the draws that have
    # a value; `nan` where fewer than half of them do
    ends: Array
    determined: Flags  # whether the data narrow what the prior has
    covered: Flags  # whether `FEWEST` outputs were near

    @property
    def median(self) -> Array:
        """The posterior's."""
        return np.asarray(self.ends[1])

    @property
    def shown(self) -> Flags:
        """Where there is a band to see."""
        return np.asarray(self.covered & np.isfinite(self.median))


def friction_curves(fit: Fit) -> list[Curve]:
    """Evaluate friction over speed, where recordings ran: without load, driven, and driving."""
    open_scale = has_open_scale(fit)
    place = covered(fit, fit.target.chain_values(fit.posterior.median[None])[0], open_scale)
    lossy = any(element.load_loss != "none" for element in fit.chain.elements)
    ways = [place[1][place[1] > 0.0], place[1][place[1] < 0.0]] if lossy else []
    loads = [float(np.quantile(np.abs(x), 0.9) * np.sign(x[0])) for x in ways if x.size]
    loads = [float(f"{x:.1g}") for x in loads]
    low, high = float(place[0].min()), float(place[0].max())
    least = 1e-3 * max(-low, high)
    sides = [(low, -least)] if low < -least else []
    sides += [(least, high)] if high > least else []
    speed = np.concatenate([np.linspace(*ends, _POINTS // len(sides)) for ends in sides])
    if len(sides) > 1:  # friction jumps at rest, where it has no value
        speed = np.insert(speed, _POINTS // 2, 0.0)
    curves = []
    for load in (np.full(speed.size, x) for x in (0.0, *loads)):
        of = partial(friction_torque, fit.chain, speed=speed, load=load, open_scale=open_scale)
        k = 2 if loads else 1
        seen = near(np.stack([speed, load])[:k], place[:k])
        curves.append(Curve(speed, load, *band(fit, of), seen))
    return curves


def has_open_scale(fit: Fit) -> bool:
    """Whether theory leaves a scale between leg and alpha open."""
    return local_information(fit.target, fit.posterior.median).from_theory > 0


def band(fit: Fit, curve: Callable[[Array], Array]) -> tuple[Array, Flags]:
    """Give ends and median ``(3, N)`` of a curve over draws, and where the data determine it.

    ``curve`` brings parameters ``(n, n_parameters)`` to the curve's points ``(n, N)``, ``nan``
    where a draw has no value. The data determine it where they narrow what the prior has.
    """
    with np.errstate(all="ignore"), warnings.catch_warnings():
        # points that no draw has are nan, and say so by that
        warnings.simplefilter("ignore", RuntimeWarning)
        before = prior_draws(fit, _PRIOR_DRAWS, 4)
        every = [curve(fit.chain_draws(_DRAWS)), curve(fit.target.chain_values(before))]
        drawn, before = (np.where(np.isfinite(x), x, np.nan) for x in every)
        ends = np.nanquantile(drawn, [0.5 - LEVEL / 2, 0.5, 0.5 + LEVEL / 2], axis=0)
        # between quartiles: what divides by 1 - mu_2 has no finite sd under many priors
        width, wide = (
            np.subtract(*np.nanquantile(x, [0.75, 0.25], axis=0)) for x in (drawn, before)
        )
    ends[:, np.isnan(drawn).mean(axis=0) > 0.5] = np.nan
    return ends, np.asarray(np.isfinite(ends[1]) & (width < WIDE * wide))


def friction_torque(
    chain: Joint, values: Array, speed: Array, load: Array, open_scale: bool
) -> Array:
    """Friction of the whole joint at constant speed, seen at the motor.

    ``speed`` ``(N,)`` is the motor's, without a value at zero; ``load`` ``(N,)``
    is its loss-free torque of the load (``open_scale`` says which, see the module), positive where
    it resists the motion. Given as ``(n, N)``, positive against the motion, at 20 degC and as a
    recording begins; at no load it is what
    the constant, viscous and quadratic ``total_drive.*`` of
    :func:`bayesfric.mechanism.derived.derive` sum up, times ``drive.gain``.
    """
    sign = np.sign(speed)
    elements, table, carried = chain.tables(values)
    # a load that weighs what is asked for, and nothing else: the same kernel as everywhere
    table[:] = 0.0
    table[:, kernels.GAIN] = 1.0
    table[:, kernels.GRAVITY] = 1.0
    with np.errstate(divide="ignore"):
        table[:, kernels.FIRST_MOMENT] = 1.0 / load_reach(chain, values, open_scale=open_scale)
    # what pulls at rest, wherever it goes, is no friction
    rest = State(0.0, 0.0, 0.0, 0.0, 0.0)
    for k, term in enumerate(chain.carried):
        if term.row.column is not None and not term.row.shape and term.row.column(rest) != 0.0:
            carried[:, k, 0] = 0.0
    # the sine of the angle is put in place of one: the load is any, not that of a position
    still = np.zeros_like(load)
    # at constant speed the torque stands still too
    samples = chain.samples(still, speed / chain.ratio, still, AT_ROOM, still)
    samples = samples._replace(sin_q=np.ascontiguousarray(sign * load), cos_q=still)
    torque = kernels.inverse_many(elements, table, carried, samples)
    return np.asarray(np.where(sign == 0.0, np.nan, sign * torque - load))


def near(places: Array, recorded: Array) -> Flags:
    """Tell which places ``(k, N)`` have ``FEWEST`` of the outputs ``(k, M)`` near, ``(N,)``."""
    # nine tenths of the outputs, or one jerk would stretch what counts as near
    inner = np.subtract(*np.quantile(recorded, [0.95, 0.05], axis=1)) / 0.9
    reach = NEAR * np.where(inner > 0.0, inner, np.ptp(recorded, axis=1))[:, None]
    apart = (np.abs(recorded - at[:, None]) <= reach for at in places.T)
    return np.array([np.all(one, axis=0).sum() >= FEWEST for one in apart])


def covered(fit: Fit, median: Array, open_scale: bool) -> Array:
    """Give the motor's speed at all outputs and, at the chain parameters ``median``, their loads.

    ``(2, M)``; loads are loss-free, at the motor, and positive where they resist the motion.
    """
    reach = float(load_reach(fit.chain, median[None], open_scale=open_scale)[0])
    speeds, loads = [], []
    for o in fit.observations:
        gamma = load_at_outputs(fit.chain, o, median)
        speeds.append(fit.chain.ratio * o.speed)
        loads.append(reach * gamma * np.sign(o.speed))
    return np.stack([np.concatenate(speeds), np.concatenate(loads)])


FIGURE = RunFigure(
    stem="friction",
    title="Friction of the joint",
    section="friction",
    draw=lambda run: friction_figure(run.fit.wide),
    caption=lambda run: friction_caption(run.fit.wide),
)
