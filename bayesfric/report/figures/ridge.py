"""The ridge: everything behind a gearbox scales with its alphas, and no torque tells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesfric.estimates.torque import filtered_torque
from bayesfric.inference.fit import Fit
from bayesfric.inference.prior.priors import Prior, fixed
from bayesfric.mechanism.scaling import Scaling, scalings
from bayesfric.report.figures.style import (
    PAGE,
    PALETTE,
    POSTERIOR,
    PRIOR,
    SMALL,
    Array,
    LineStyle,
    few_ticks,
    margins,
    mathtext,
    paper_style,
    power_of_ten,
    scaled_unit,
    shortened,
)

# What stands beside alpha_1, as long as the chain has it; the first two.
_SIBLINGS = ("first_moment", "inertia", "viscous", "coulomb", "coulomb_positive", "quadratic")
_MOST_DRAWS = 1500
# Below this, in N m, a difference is rounding.
ROUNDING = 1e-10
# Where nothing ends the line (mu_2 of one or more) it is drawn down to this share.
_NO_END = 0.05
_MASSES = (0.5, 0.9)
_SECONDS = 3.0
_MOST_NAMED = 3
# First digits of the numbers on logarithmic axes, the fewest that suffice.
_DIGITS = ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0))

_HEIGHT = 4.3
_LEFT, _RIGHT, _BOTTOM, _TOP = 0.58, 0.10, 0.36, 0.30
_LINE = PALETTE[0]
_ENDS: tuple[LineStyle, LineStyle] = ((0, (4.0, 1.5)), (0, (1.0, 1.2)))
_END_WORDS = (r"end $\alpha_2 = 1$", r"end $\alpha_1 = 1$")


@dataclass(frozen=True, eq=False)
class Ridge:
    """The line of equal torque through a posterior.

    Attributes
    ----------
    scaling
        What is multiplied together.
    values
        ``(n_parameters,)`` where the line is taken from: the posterior's median.
    bounds
        Smallest and largest factor, ``1/alpha_2 <= k <= 1/alpha_1``; the smallest is zero
        where ``mu_2`` is one or more.
    line
        ``(101, n_parameters)`` vectors from one end to the other.
    torque
        Predicted motor torque at the lower end, in the middle and at the upper end,
        ``(3, n_outputs)`` a recording.
    """

    scaling: Scaling
    values: Array
    bounds: tuple[float, float]
    line: Array
    torque: tuple[Array, ...]

    @property
    def differences(self) -> tuple[float, ...]:
        """Largest difference between the ends' torque and the middle's, by recording."""
        return tuple(float(np.abs(t - t[1]).max()) for t in self.torque)


def ridge(fit: Fit) -> Ridge | None:
    """Follow the first scaling of a fit's chain through the posterior's median.

    Parameters
    ----------
    fit
        A finished fit.

    Returns
    -------
    Ridge or None
        Nothing for a chain without an element of two load losses.
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

    Above, with logarithmic scales, ``alpha_1`` against first moment, load inertia and
    ``alpha_2`` (what of these the chain has): posterior draws, contours of the prior, the
    exact scaling line through the posterior's median and its ends, where a passive
    gearbox would have ``alpha_2 = 1`` and ``alpha_1 = 1``. Below, the torque predicted in
    the middle and at the ends of that line, and the difference. A recording with a known
    mass tells the ends apart; the posterior is a spot on the line then.

    Parameters
    ----------
    fit
        A finished fit.

    Returns
    -------
    matplotlib.figure.Figure or None
        A page wide; nothing for a chain that has no such scaling.
    """
    found = ridge(fit)
    if found is None:
        return None
    drive, others = _quantities(fit, found.scaling, found.values)
    if not others:
        return None
    with paper_style():
        figure = Figure(figsize=(PAGE, _HEIGHT))
        halves = figure.add_gridspec(
            2,
            1,
            **margins(figure, left=_LEFT, right=_RIGHT, bottom=_BOTTOM, top=_TOP),
            hspace=0.30,
            height_ratios=(1.35, 1.0),
        )
        grid = halves[0].subgridspec(1, len(others), wspace=0.38)
        for j, other in enumerate(others):
            _pair(figure.add_subplot(grid[0, j]), fit, found, drive, other)
        grid = halves[1].subgridspec(1, 2, wspace=0.24)
        _torque(figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1]), fit, found)
        _legend(figure, found)
    return figure


def _same(x: Array) -> Array:
    return x


@dataclass(frozen=True)
class _Quantity:
    """An axis: how to get it from parameter vectors, and its prior in its logarithm."""

    name: str
    symbol: str
    unit: str
    of: Callable[[Array], Array]
    prior: Prior
    from_parameter: Callable[[Array], Array] = _same
    to_parameter: Callable[[Array], Array] = _same
    slope: Callable[[Array], Array] = _same

    def log_density(self, x: Array) -> Array:
        """Log prior density of the logarithm of the quantity at ``x``."""
        return self.prior.log_density(self.to_parameter(x)) + np.log(self.slope(x))

    def known(self) -> float:
        """Value of a fixed one."""
        return float(self.from_parameter(np.asarray(self.prior.value)))

    def draw_prior(self, n: int, rng: np.random.Generator) -> Array:
        """Draw from the prior."""
        return self.from_parameter(self.prior.draw(n, rng))


def _quantities(fit: Fit, scaling: Scaling, values: Array) -> tuple[_Quantity, list[_Quantity]]:
    names = fit.chain.names
    told = dict(zip(fit.posterior.names, fit.posterior.priors, strict=True))
    at = dict(zip(names, values.tolist(), strict=True))
    priors = {name: told.get(name) or fixed(at[name]) for name in scaling.names}

    def alpha(name: str, symbol: str, sign: float) -> _Quantity:
        column = names.index(name)
        # eq. (6): 1/alpha_1 = 1 + mu_1, 1/alpha_2 = 1 - mu_2; d mu / d log alpha = 1/alpha
        return _Quantity(
            name,
            symbol,
            "",
            lambda v: _inverse(1.0 + sign * v[..., column]),
            priors[name],
            lambda mu: _inverse(1.0 + sign * mu),
            lambda x: sign * (1.0 / x - 1.0),
            lambda x: 1.0 / x,
        )

    drive = alpha(scaling.drive, r"$\alpha_1$", 1.0)
    described = {p.name: p for p in fit.chain.parameters}
    others: list[_Quantity] = []
    for quantity in _SIBLINGS:
        # the load's own before those of elements in between
        for name in sorted(scaling.behind, key=lambda n: not n.startswith("load.")):
            p = described[name]
            if p.quantity != quantity or len(others) == 2:
                continue
            of = partial(_column, names.index(name))
            others.append(_Quantity(name, mathtext(p.symbol, name), p.unit, of, priors[name]))
    others.append(alpha(scaling.back, r"$\alpha_2$", -1.0))
    # what is zero, and the alpha_2 of an irreversible gearbox, have no logarithm
    return drive, [q for q in others if float(q.of(values)) > 0.0]


def _column(column: int, values: Array) -> Array:
    return np.asarray(values[..., column])


def _inverse(x: Array) -> Array:
    """One over what is positive; an irreversible gearbox has no alpha_2."""
    return np.where(x > 0.0, 1.0 / np.where(x > 0.0, x, 1.0), np.nan)


def _pair(ax: Axes, fit: Fit, found: Ridge, x: _Quantity, y: _Quantity) -> None:
    ax.set_gid(y.name)
    draws = fit.chain_draws(_MOST_DRAWS)
    points, line = (np.stack([x.of(v), y.of(v)]) for v in (draws, found.line))
    points = points[:, np.all(np.isfinite(points) & (points > 0.0), axis=0)]
    limits = [_limits(p, v) for p, v in zip(points, line, strict=True)]
    exponents = [power_of_ten(*pair) for pair in limits]
    factors = [10.0**e for e in exponents]
    ax.set_xscale("log")
    ax.set_yscale("log")
    _prior(ax, fit, (x, y), limits, factors)
    ax.plot(
        points[0] / factors[0],
        points[1] / factors[1],
        linestyle="none",
        marker=".",
        markersize=2.2,
        markeredgewidth=0.0,
        color=POSTERIOR,
        alpha=0.25,
        rasterized=True,
        zorder=2,
        gid="posterior",
    )
    ax.plot(line[0] / factors[0], line[1] / factors[1], color=_LINE, zorder=3, gid="line")
    for k, marker in _marked(found):
        ax.plot(
            line[0, k] / factors[0],
            line[1, k] / factors[1],
            marker=marker,
            markersize=5.0,
            markerfacecolor="white",
            markeredgecolor=_LINE,
            markeredgewidth=0.9,
            zorder=4,
            gid=f"end {k}",
        )
    for axis, q, pair, exponent in zip(
        (ax.xaxis, ax.yaxis), (x, y), limits, exponents, strict=True
    ):
        low, high = (v / 10.0**exponent for v in pair)
        (ax.set_xlim if axis is ax.xaxis else ax.set_ylim)(low, high)
        _log_ticks(axis, low, high)
        axis.set_label_text(f"{q.symbol} ({scaled_unit(exponent, q.unit)})")


def _marked(found: Ridge) -> list[tuple[int, str]]:
    """Rows of the line that are its ends, with their markers."""
    return ([(0, "s")] if found.bounds[0] > 0.0 else []) + [(found.line.shape[0] - 1, "^")]


def _limits(points: Array, line: Array) -> tuple[float, float]:
    """Nearly all draws, the whole line, and a margin, in logarithms."""
    seen = np.quantile(points, [0.002, 0.998]) if points.size else line
    low, high = (float(np.log(choose([*seen, line.min(), line.max()]))) for choose in (min, max))
    margin = max(0.09 * (high - low), 0.02)
    return float(np.exp(low - margin)), float(np.exp(high + margin))


def _log_ticks(axis: Axis, low: float, high: float) -> None:
    """Put three to six round and plain numbers on a logarithmic axis."""
    axis.set_minor_locator(ticker.NullLocator())
    decades = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1.0)
    for digits in _DIGITS:
        at = np.outer(decades, digits).ravel()
        at = at[(at >= low) & (at <= high)]
        if at.size >= 3:
            axis.set_major_locator(ticker.FixedLocator(at[:: -(-at.size // 6)].tolist()))
            axis.set_major_formatter(ticker.StrMethodFormatter("{x:g}"))
            return
    few_ticks(axis, 4)


def _prior(
    ax: Axes,
    fit: Fit,
    pair: tuple[_Quantity, _Quantity],
    limits: list[tuple[float, float]],
    factors: list[float],
) -> None:
    """Draw where half and nine tenths of the prior lie, or the line on which it is known."""
    style: dict[str, Any] = {"color": PRIOR, "linestyle": (0, (4.0, 1.5)), "linewidth": 0.9}
    if any(q.prior.fixed for q in pair):
        for q, draw, factor in zip(pair, (ax.axvline, ax.axhline), factors, strict=True):
            if q.prior.fixed:
                draw(q.known() / factor, gid="prior", **style)
        return
    rng = np.random.default_rng(np.random.SeedSequence(fit.posterior.seed, spawn_key=(4,)))
    draws = [q.draw_prior(40_000, rng) for q in pair]
    x, y = (_grid(d, *ends) for d, ends in zip(draws, limits, strict=True))
    with np.errstate(divide="ignore", invalid="ignore"):
        density = pair[0].log_density(x)[None, :] + pair[1].log_density(y)[:, None]
        drawn = pair[0].log_density(draws[0]) + pair[1].log_density(draws[1])
    levels = np.quantile(drawn[np.isfinite(drawn)], [1.0 - mass for mass in reversed(_MASSES)])
    # a density, not its logarithm: that would be minus infinity beyond a bound
    height = np.exp(np.where(np.isfinite(density), density, -np.inf) - levels[1])
    x, y = x / factors[0], y / factors[1]
    top = max(float(height.max()), 1.0) * 2.0
    steps = [float(np.exp(levels[0] - levels[1])), 1.0]
    shades = ax.contourf(
        x, y, height, levels=[*steps, top], colors=[PRIOR, PRIOR], alpha=0.10, zorder=0
    )
    shades.set_gid("prior mass")
    edges = ax.contour(
        x,
        y,
        height,
        levels=steps,
        colors=[PRIOR],
        linestyles=[(0, (1.0, 1.2)), (0, (4.0, 1.5))],
        linewidths=[0.7, 0.9],
        zorder=1,
    )
    edges.set_gid("prior")


def _grid(draws: Array, low: float, high: float) -> Array:
    """Points over an axis, and close together wherever a prior is narrow."""
    close = np.quantile(draws[np.isfinite(draws)], np.linspace(0.001, 0.999, 81))
    points = np.concatenate([np.geomspace(low, high, 121), close[(close > low) & (close < high)]])
    return np.unique(points)


def _torque(left: Axes, right: Axes, fit: Fit, found: Ridge) -> None:
    """Draw the torque along the line, of the recording in which it differs most, and the rest."""
    differences = found.differences
    r = int(np.argmax(differences)) if max(differences) > ROUNDING else 0
    o, torque = fit.observations[r], found.torque[r]
    unit = "N m" if fit.chain.motor_motion == "rotary" else "N"
    gaps = np.flatnonzero((np.diff(o.time) > 1.5 * o.period) | (np.diff(o.segment_of) != 0)) + 1
    time = np.insert(o.time, gaps, np.nan)
    low, middle, high = (np.insert(t, gaps, np.nan) for t in torque)
    same = max(differences) <= ROUNDING
    exponent = -10 if same else power_of_ten(0.0, differences[r])
    left.plot(time, middle, color=PALETTE[3], linewidth=2.4, label="middle", gid="torque middle")
    for t, dashes, words, colour in (
        (low, _ENDS[0], _END_WORDS[0], _LINE),
        (high, _ENDS[1], _END_WORDS[1], PALETTE[2]),
    ):
        left.plot(time, t, color=colour, linestyle=dashes, label=words, gid="torque")
        right.plot(
            time, (t - middle) / 10.0**exponent, color=colour, linestyle=dashes, gid="difference"
        )
    reach = 1.0 if same else 1.08 * differences[r] / 10.0**exponent
    right.set_ylim(-1.2 * reach, 1.7 * reach)
    left.set_ylabel(f"motor torque ({unit})" if unit == "N m" else f"motor force ({unit})")
    right.set_ylabel(f"difference ({scaled_unit(exponent, unit)})")
    for ax in (left, right):
        begin = float(o.time.min())
        ax.set_xlim(begin, min(begin + _SECONDS, max(float(o.time.max()), begin + 1e-9)))
        ax.set_xlabel("time (s)")
        few_ticks(ax.xaxis, 6)
        few_ticks(ax.yaxis, 4)
    span = float(np.ptp(torque))
    left.set_ylim(float(torque.min()) - 0.08 * span, float(torque.max()) + 0.35 * span)
    left.legend(loc="upper left", ncols=3, handlelength=2.2, columnspacing=1.2, borderaxespad=0.2)
    lines = [
        f"{shortened(one.name, 24)}: at most {difference:.2g} {unit}"
        for one, difference in zip(fit.observations, differences, strict=True)
    ]
    if len(lines) > _MOST_NAMED:
        lines = [*lines[: _MOST_NAMED - 1], f"and {len(lines) - _MOST_NAMED + 1} more"]
    right.text(
        0.02,
        0.97,
        "\n".join(lines),
        transform=right.transAxes,
        ha="left",
        va="top",
        fontsize=SMALL,
        gid="largest",
    )


def _legend(figure: Figure, found: Ridge) -> None:
    low, high = found.bounds
    ends: dict[str, Any] = {
        "linestyle": "none",
        "markerfacecolor": "white",
        "markeredgecolor": _LINE,
    }
    handles = [
        Line2D([], [], linestyle="none", marker=".", markersize=4.0, color=POSTERIOR),
        Patch(facecolor="#f6e3d6", edgecolor=PRIOR, linestyle=(0, (4.0, 1.5)), linewidth=0.7),
        Line2D([], [], color=_LINE),
    ]
    same = max(found.differences) <= ROUNDING
    labels = [
        "posterior",
        "prior, 50 and 90 %",
        "no torque changes" if same else "same torque unloaded",
    ]
    if low > 0.0:
        handles.append(Line2D([], [], marker="s", markersize=4.5, **ends))
        labels.append(rf"{_END_WORDS[0]}, $k = 1/\alpha_2 = {low:.2f}$")
    handles.append(Line2D([], [], marker="^", markersize=4.5, **ends))
    labels.append(rf"{_END_WORDS[1]}, $k = 1/\alpha_1 = {high:.2f}$")
    figure.legend(
        handles,
        labels,
        loc="upper left",
        ncols=len(labels),
        bbox_to_anchor=(0.02 / PAGE, 1.0),
        borderaxespad=0.2,
        borderpad=0.2,
        columnspacing=1.2,
        handlelength=1.8,
    )
