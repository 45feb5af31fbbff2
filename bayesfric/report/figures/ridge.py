"""The ridge: everything behind a gearbox scales with its alphas without changing any torque."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from bayesfric.inference.fitting import Fit
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.joint import Joint
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
        ends = [(0, "s", 2), (len(self.line) - 1, "^", 1)]
        return [
            (k, marker, rf"end $\alpha_{which} = 1$, $k = 1/\alpha_{which} = {factor:.2f}$")
            for (k, marker, which), factor in zip(ends, self.bounds, strict=True)
            if factor > 0.0
        ]


def ridge(fit: Fit) -> Ridge | None:
    """Follow the first scaling of a fit's chain through the posterior's median.

    ``None`` for a chain without an element with load-dependent friction by direction.
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
    """Draw the scale that no torque determines: the posterior and the exact line, a page wide.

    ``alpha_1`` against first moment, load inertia and ``alpha_2``: posterior draws, the exact
    scaling line through the posterior's median and its ends, where a passive gearbox would have
    ``alpha_2 = 1`` and ``alpha_1 = 1``. ``None`` for a chain that has no such scaling.
    """
    line = ridge(fit)
    if line is None:
        return None
    # those of the load come last, and are of most interest
    names = [*line.scaling.behind[:-3:-1], f"{line.scaling.element}.alpha_back"]
    with style.paper_figure(style.PAGE, _HEIGHT) as figure:
        for ax, name in zip(style.panel_grid(figure, len(names), len(names)), names, strict=True):
            _pair(ax, fit, line, name)
        dots = Line2D([], [], **_DOTS | {"markersize": 4.0, "alpha": 1.0}, label="posterior")
        drawn = Line2D([], [], color=_LINE, label="same torque, without added mass")
        ends = [
            Line2D([], [], marker=marker, markersize=4.5, label=label, **_MARKER)
            for _, marker, label in line.ends
        ]
        style.legend_above(figure, [dots, drawn, *ends])
    return figure


def _quantities(chain: Joint, values: Array) -> dict[str, tuple[str, str, Array]]:
    """Give symbol, unit and values of parameters and derived quantities."""
    parameters = {p.name: (p.symbol, p.unit, values[:, k]) for k, p in enumerate(chain.parameters)}
    return parameters | {q.name: (q.symbol, q.unit, q.values) for q in derive(chain, values, 0.0)}


def _pair(ax: Axes, fit: Fit, ridge_line: Ridge, name: str) -> None:
    ax.set_gid(name)
    with np.errstate(divide="ignore", invalid="ignore"):  # an irreversible gearbox has no alpha_2
        every = [_quantities(fit.chain, v) for v in (fit.chain_draws(_MOST_DRAWS), ridge_line.line)]
    pairs = [(f"{ridge_line.scaling.element}.alpha_drive", ax.xaxis), (name, ax.yaxis)]
    points, line = (np.stack([q[of][2] for of, _ in pairs]) for q in every)
    for k, (of, axis) in enumerate(pairs):
        shown = np.concatenate([points[k], line[k]])
        exponent = power_of_ten(float(np.nanmin(shown)), float(np.nanmax(shown)))
        symbol, unit, _ = every[0][of]
        axis.set_label_text(axis_label(symbol, of, exponent, unit))
        few_ticks(axis, 5, exponent=exponent)
    ax.plot(*points, gid="posterior", markeredgewidth=0.0, rasterized=True, zorder=2, **_DOTS)
    ax.plot(*line, color=_LINE, zorder=3, gid="line")
    for k, marker, _ in ridge_line.ends:
        ax.plot(*line[:, k], marker=marker, markersize=5.0, zorder=4, gid=f"end {k}", **_MARKER)


FIGURE = RunFigure(
    stem="ridge",
    title="The ridge: what can be scaled together without changing any torque",
    section="ridge",
    draw=lambda run: ridge_figure(run.fit),
    caption=(
        "Draws of the posterior against the line along which no torque changes, between the ends "
        "that a passive gearbox sets. Only a known mass distinguishes them."
    ),
)
