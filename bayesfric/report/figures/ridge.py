"""The ridge: everything behind a gearbox scales with its alphas, and no torque tells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesfric.estimates.torque import filtered_torque
from bayesfric.inference.fitting import Fit
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.parameter import Parameter
from bayesfric.mechanism.quantities import CHOICES, QUANTITIES
from bayesfric.mechanism.scaling import Scaling, scalings
from bayesfric.report.figures import style
from bayesfric.report.figures.over_time import broken
from bayesfric.report.figures.registry import RunFigure
from bayesfric.report.figures.style import Array, Look, axis_label, few_ticks, power_of_ten

_MOST_DRAWS = 1500
# Below this, in N m, a difference is rounding.
ROUNDING = 1e-10
# Where nothing ends the line (mu_2 of one or more) it is drawn down to this share.
_NO_END = 0.05
_SECONDS = 3.0
_HEIGHT = 4.3
_LINE = style.PALETTE[0]
_ENDS = (r"end $\alpha_2 = 1$", r"end $\alpha_1 = 1$")
_MARKER: Look = {
    "linestyle": "none", "markerfacecolor": "white", "markeredgecolor": _LINE,
    "markeredgewidth": 0.9,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Ridge:
    """The line of equal torque through a posterior."""

    scaling: Scaling  # what is multiplied together
    values: Array  # `(n_parameters,)` where the line is taken from: the posterior's median
    # smallest and largest factor, `1/alpha_2 <= k <= 1/alpha_1`; the smallest is zero where `mu_2`
    # is one or more
    bounds: tuple[float, float]
    line: Array  # `(101, n_parameters)` vectors from one end to the other
    # predicted motor torque at the lower end, in the middle and at the upper end, `(3, n_outputs)`
    # a recording
    torque: tuple[Array, ...]

    @property
    def differences(self) -> tuple[float, ...]:
        """Largest difference between the ends' torque and the middle's, by recording."""
        return tuple(float(np.abs(t - t[1]).max()) for t in self.torque)


def ridge(fit: Fit) -> Ridge | None:
    """Follow the first scaling of a fit's chain through the posterior's median.

    ``None`` for a chain without an element of two load losses.
    """
    found = scalings(fit.chain)
    if not found:
        return None
    scaling = found[0]
    values = np.median(fit.chain_draws(), axis=0)
    low, high = scaling.bounds(values)
    factors = np.geomspace(max(low, _NO_END * high), high, 101)
    line = scaling.scaled(values, factors)
    torque = tuple(filtered_torque(fit.chain, o, line[[0, 50, 100]]) for o in fit.observations)
    return Ridge(scaling, values, (low, high), line, torque)


def ridge_figure(fit: Fit) -> Figure | None:
    """Draw the scale that no torque tells: posterior, exact line, and the torque along it.

    Above, ``alpha_1`` against first moment, load inertia and ``alpha_2`` (what of these the chain
    has): posterior draws, the exact scaling line through the posterior's median and its ends, where
    a passive gearbox would have ``alpha_2 = 1`` and ``alpha_1 = 1``. Below, the torque predicted in
    the middle and at the ends of that line. A recording with a known
    mass tells the ends apart; the posterior is a spot on the line then. A page wide; ``None`` for a
    chain that has no such scaling.
    """
    found = ridge(fit)
    if found is None:
        return None
    names = [*siblings(fit.chain, found.scaling), found.scaling.back]
    with style.paper_figure(style.PAGE, _HEIGHT) as figure:
        halves = figure.add_gridspec(2, 1, height_ratios=(1.5, 1.0))
        for ax, name in zip(
            style.panel_grid(figure, len(names), len(names), halves[0]), names, strict=True
        ):
            _pair(ax, fit, found, name)
        _torque(figure.add_subplot(halves[1]), fit, found)
        style.legend_above(figure, _handles(found))
    return figure


def siblings(chain: Joint, scaling: Scaling) -> list[str]:
    """Name two torques behind the gearbox: what only loads have, then as the table lists them."""
    table = [*QUANTITIES]

    def rank(p: Parameter) -> tuple[bool, int, bool]:
        place = table.index(p.quantity) if p.quantity in QUANTITIES else len(table)
        return p.row.option in CHOICES, place, p.owner != "load"

    behind = [p for p in chain.parameters if p.name in scaling.behind and p.row.role == "own"]
    return [p.name for p in sorted(behind, key=rank)[:2]]


def _pair(ax: Axes, fit: Fit, found: Ridge, name: str) -> None:
    ax.set_gid(name)
    draws = fit.chain_draws(_MOST_DRAWS)
    pairs = [(found.scaling.drive, ax.xaxis), (name, ax.yaxis)]
    points, line = (
        np.stack([_shown(fit, found, of, v) for of, _ in pairs]) for v in (draws, found.line)
    )
    for k, (of, axis) in enumerate(pairs):
        seen = np.concatenate([points[k], line[k]])
        exponent = power_of_ten(float(np.nanmin(seen)), float(np.nanmax(seen)))
        for values in (points, line):
            values[k] /= 10.0**exponent
        alpha = {found.scaling.drive: r"\alpha_1", found.scaling.back: r"\alpha_2"}.get(of)
        (p,) = (p for p in fit.chain.parameters if p.name == of)
        unit = "" if alpha else p.unit
        axis.set_label_text(axis_label(alpha or p.symbol, of, exponent, unit))
        few_ticks(axis, 5)
    dots: Look = {"linestyle": "none", "marker": ".", "markersize": 2.2, "markeredgewidth": 0.0}
    dots |= {"color": style.POSTERIOR, "alpha": 0.25, "rasterized": True, "zorder": 2}
    ax.plot(*points, gid="posterior", **dots)
    ax.plot(*line, color=_LINE, zorder=3, gid="line")
    for k, marker in _marked(found):
        ax.plot(*line[:, k], marker=marker, markersize=5.0, zorder=4, gid=f"end {k}", **_MARKER)


def _shown(fit: Fit, found: Ridge, name: str, values: Array) -> Array:
    """Read a column of parameter vectors; of a load loss, 1/alpha = 1 + mu_1 or 1 - mu_2, alpha."""
    x = values[:, fit.chain.names.index(name)]
    sign = {found.scaling.drive: 1.0, found.scaling.back: -1.0}.get(name)
    if sign is None:
        return x.copy()
    # an irreversible gearbox has no alpha_2
    return np.divide(1.0, 1.0 + sign * x, out=np.full_like(x, np.nan), where=1.0 + sign * x > 0.0)


def _marked(found: Ridge) -> list[tuple[int, str]]:
    """Rows of the line that are its ends, with their markers."""
    return ([(0, "s")] if found.bounds[0] > 0.0 else []) + [(found.line.shape[0] - 1, "^")]


def _torque(ax: Axes, fit: Fit, found: Ridge) -> None:
    """Draw the torque along the line, of the recording in which it differs most."""
    differences = found.differences
    r = int(np.argmax(differences)) if max(differences) > ROUNDING else 0
    o, torque = fit.observations[r], found.torque[r]
    kind, unit = ("torque", "N m") if fit.chain.motor_motion == "rotary" else ("force", "N")
    time, low, middle, high = broken(o, *torque)
    look: Look = {"color": style.PALETTE[3], "linewidth": 2.4, "gid": "torque middle"}
    ax.plot(time, middle, label="middle", **look)
    ax.plot(time, low, label=_ENDS[0], color=_LINE, linestyle=style.DASHED, gid="torque")
    look = {"color": style.PALETTE[2], "linestyle": style.DOTTED, "gid": "torque"}
    ax.plot(time, high, label=_ENDS[1], **look)
    begin = float(o.time.min())
    ax.set_xlim(begin, min(begin + _SECONDS, max(float(o.time.max()), begin + 1e-9)))
    ax.set_xlabel("time (s)")
    ax.set_ylabel(f"motor {kind} ({unit})")
    few_ticks(ax.xaxis, 8)
    few_ticks(ax.yaxis, 4)
    span = float(np.ptp(torque))
    ax.set_ylim(float(torque.min()) - 0.08 * span, float(torque.max()) + 0.35 * span)
    ax.legend(loc="upper left", ncols=3, handlelength=2.2)
    told = f"{style.shortened(o.name, 24)}: differs by at most {differences[r]:.2g} {unit}"
    look = {"ha": "right", "va": "top", "fontsize": style.SMALL, "gid": "largest"}
    ax.text(0.99, 0.96, told, transform=ax.transAxes, **look).set_in_layout(False)


def _handles(found: Ridge) -> list[Artist]:
    same = max(found.differences) <= ROUNDING
    dots: Look = {"linestyle": "none", "marker": ".", "markersize": 4.0}
    handles: list[Artist] = [
        Line2D([], [], color=style.POSTERIOR, label="posterior", **dots),
        Line2D([], [], color=_LINE, label="no torque changes" if same else "same torque unloaded"),
    ]
    for k, marker in _marked(found):
        which, end, factor = (
            (2, _ENDS[0], found.bounds[0]) if k == 0 else (1, _ENDS[1], found.bounds[1])
        )
        label = rf"{end}, $k = 1/\alpha_{which} = {factor:.2f}$"
        handles.append(Line2D([], [], marker=marker, markersize=4.5, label=label, **_MARKER))
    return handles


FIGURE = RunFigure(
    stem="ridge",
    title="The ridge: what can be scaled together without changing any torque",
    section="ridge",
    draw=lambda run: ridge_figure(run.fit),
    caption=(
        "Draws of the posterior against the line along which no torque changes, between the ends "
        "that a passive gearbox sets. Below: the torque at both ends of the line and in its "
        "middle, of the recording in which they differ most."
    ),
)
