"""The ridge: everything behind a gearbox scales with its alphas, and no torque tells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesfric.inference.fitting import Fit
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.parameter import Parameter
from bayesfric.mechanism.quantities import CHOICES, QUANTITIES
from bayesfric.mechanism.scaling import Scaling, scalings
from bayesfric.report.figures import style
from bayesfric.report.figures.registry import RunFigure
from bayesfric.report.figures.style import Array, Look, axis_label, few_ticks, power_of_ten

_MOST_DRAWS = 1500
# Where nothing ends the line (mu_2 of one or more) it is drawn down to this share.
_NO_END = 0.05
_HEIGHT = 2.7
_LINE = style.PALETTE[0]
_DOTS: Look = {
    "linestyle": "none", "marker": ".", "markersize": 2.2, "color": style.POSTERIOR, "alpha": 0.25,
}  # fmt: skip
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

    @property
    def ends(self) -> list[tuple[int, str, str]]:
        """Rows of the line that are its ends, with marker and words."""
        told = [(0, "s", 2), (len(self.line) - 1, "^", 1)]
        return [
            (k, marker, rf"end $\alpha_{which} = 1$, $k = 1/\alpha_{which} = {factor:.2f}$")
            for (k, marker, which), factor in zip(told, self.bounds, strict=True)
            if factor > 0.0
        ]


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
    return Ridge(scaling, values, (low, high), scaling.scaled(values, factors))


def ridge_figure(fit: Fit) -> Figure | None:
    """Draw the scale that no torque tells: the posterior and the exact line.

    ``alpha_1`` against first moment, load inertia and ``alpha_2`` (what of these the chain has):
    posterior draws, the exact scaling line through the posterior's median and its ends, where a
    passive gearbox would have ``alpha_2 = 1`` and ``alpha_1 = 1``. Where a recording with a known
    mass tells the ends apart, the posterior is a spot on the line. A page wide; ``None`` for a
    chain that has no such scaling.
    """
    found = ridge(fit)
    if found is None:
        return None
    names = [*siblings(fit.chain, found.scaling), found.scaling.back]
    with style.paper_figure(style.PAGE, _HEIGHT) as figure:
        for ax, name in zip(style.panel_grid(figure, len(names), len(names)), names, strict=True):
            _pair(ax, fit, found, name)
        dots = Line2D([], [], **_DOTS | {"markersize": 4.0, "alpha": 1.0}, label="posterior")
        line = Line2D([], [], color=_LINE, label="same torque, without added mass")
        ends = [
            Line2D([], [], marker=marker, markersize=4.5, label=label, **_MARKER)
            for _, marker, label in found.ends
        ]
        style.legend_above(figure, [dots, line, *ends])
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
        alpha = {found.scaling.drive: r"\alpha_1", found.scaling.back: r"\alpha_2"}.get(of)
        (p,) = (p for p in fit.chain.parameters if p.name == of)
        unit = "" if alpha else p.unit
        axis.set_label_text(axis_label(alpha or p.symbol, of, exponent, unit))
        few_ticks(axis, 5, exponent=exponent)
    ax.plot(*points, gid="posterior", markeredgewidth=0.0, rasterized=True, zorder=2, **_DOTS)
    ax.plot(*line, color=_LINE, zorder=3, gid="line")
    for k, marker, _ in found.ends:
        ax.plot(*line[:, k], marker=marker, markersize=5.0, zorder=4, gid=f"end {k}", **_MARKER)


def _shown(fit: Fit, found: Ridge, name: str, values: Array) -> Array:
    """Read a column of parameter vectors; of a load loss, 1/alpha = 1 + mu_1 or 1 - mu_2, alpha."""
    x = values[:, fit.chain.names.index(name)]
    sign = {found.scaling.drive: 1.0, found.scaling.back: -1.0}.get(name)
    if sign is None:
        return x.copy()
    # an irreversible gearbox has no alpha_2
    return np.divide(1.0, 1.0 + sign * x, out=np.full_like(x, np.nan), where=1.0 + sign * x > 0.0)


FIGURE = RunFigure(
    stem="ridge",
    title="The ridge: what can be scaled together without changing any torque",
    section="ridge",
    draw=lambda run: ridge_figure(run.fit),
    caption=(
        "Draws of the posterior against the line along which no torque changes, between the ends "
        "that a passive gearbox sets. Only a known mass tells them apart."
    ),
)
