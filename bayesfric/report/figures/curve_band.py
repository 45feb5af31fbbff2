"""Curves of the posterior: median, 90 % band, and where the data determine them at all.

For friction the joint runs at constant speed against a constant load. With ``T`` the true motor
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
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.spatial import cKDTree

from bayesfric.estimates.torque import load_at_outputs
from bayesfric.identifiability.local import LocalInformation, local_information, verdict
from bayesfric.inference.fitting import Fit
from bayesfric.mechanism import kernels
from bayesfric.mechanism.inverse import load_reach
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import State
from bayesfric.recordings.arrays import Flags
from bayesfric.recordings.inputs import AT_ROOM
from bayesfric.report.figures.style import OPEN_HATCH, Array, Look
from bayesfric.report.summary.derived_quantities import LEVEL, around_median, prior_values

# Of the recorded range of speed, and of load: outputs so near to a place cover it.
NEAR = 0.08

# Joint parameters (n, n_parameters) to the curve's points (n, N)
Of = Callable[[Array], Array]

# Outputs that must be near a place for it to count as recorded.
FEWEST = 3
# A quantile of so many draws is known to a fortieth of the band's width.
_DRAWS = 1000
_PRIOR_DRAWS = 500
_OUTSIDE: Look = {"linestyle": (0, (3.0, 2.0)), "linewidth": 0.6}


@dataclass(frozen=True, eq=False)
class Curve:
    """A function of the parameters at ``N`` places, ``(N,)`` each."""

    speed: Array  # the motor's; none of an efficiency
    load: Array  # loss-free, see the module
    # of the posterior, with the ends of its central 90 % interval, over the draws that have a
    # value; `nan` where fewer than half of them do
    median: Array
    low: Array
    high: Array
    determined: Flags  # whether the data had a say: false where the verdict is `prior`
    covered: Flags  # whether `FEWEST` outputs were near

    @property
    def shown(self) -> Flags:
        """Where there is a band to see."""
        return np.asarray(self.covered & np.isfinite(self.median))

    def part(self, where: Flags, sign: float = 1.0) -> Curve:
        """Take some of the places, the curve times plus or minus one."""
        median, low, high = (sign * x[where] for x in (self.median, self.low, self.high))
        speed = self.speed[where] if self.speed.size else self.speed
        flags = self.determined[where], self.covered[where]
        return Curve(speed, self.load[where], median, low, high, *flags)


@dataclass(frozen=True)
class CurveLook:
    """How a curve is told from others; ``every`` point so many has a marker, as of ``start``.

    ``width`` is the line's, in points.
    """

    colour: str
    marker: str
    hatch: str = OPEN_HATCH
    start: int = 0
    every: int = 6
    width: float = 0.9


class CurveJudge:
    """What is needed to judge any number of curves of one fit.

    Parameters
    ----------
    fit
        A finished fit.

    Attributes
    ----------
    local
        What the data alone determine at the posterior median.
    median
        ``(n_parameters,)`` chain parameters at the posterior median.
    """

    def __init__(self, fit: Fit) -> None:
        sampled = fit.posterior.median
        self._fit = fit
        self.local: LocalInformation = local_information(fit.target, sampled)
        self.median: Array = fit.target.chain_values(sampled[None])[0]
        self._moved, self._steps = around_median(fit)
        self._prior = prior_values(fit, _PRIOR_DRAWS, 4)

    @property
    def open_scale(self) -> bool:
        """Whether theory leaves a scale between leg and alpha open."""
        return self.local.from_theory > 0

    def band(
        self, curve: Of, *, gauge_free: bool, draws: int = _DRAWS
    ) -> tuple[Array, Array, Array, Flags]:
        """Give median, ends and ``determined`` of a curve over ``draws`` of the posterior.

        Points are judged as single quantities are in ``summary.json``: by the posterior's
        sd against the prior's and the one that the data alone would leave. The curve is ``nan``
        where a draw has no value; ``gauge_free`` is whether, by theory, no scaling of leg and
        alpha changes it.
        """
        with np.errstate(all="ignore"), warnings.catch_warnings():
            # points that no draw has are nan, and say so by that
            warnings.simplefilter("ignore", RuntimeWarning)
            values = _finite(curve(self._fit.chain_draws(draws)))
            prior = _finite(curve(self._prior))
            moved = curve(self._moved)
            sd, prior_sd = _robust_sd(values), _robust_sd(prior)
            ends = [0.5 - LEVEL / 2, 0.5, 0.5 + LEVEL / 2]
            low, middle, high = np.nanquantile(values, ends, axis=0)
        k = self._steps.size
        gradients = (moved[:k] - moved[k:]) / (2.0 * self._steps[:, None])
        undefined = np.isnan(values).mean(axis=0)
        for part in (low, middle, high):
            part[undefined > 0.5] = np.nan
        determined = [
            bool(np.isfinite(gradient).all())
            and verdict(one, before, self.local.data_sd_of(gradient, gauge_free=gauge_free))
            != "prior"
            for one, before, gradient in zip(sd, prior_sd, gradients.T, strict=True)
        ]
        return middle, low, high, np.array(determined, dtype=np.bool_)


def draw_curve(ax: Axes, x: Array, curve: Curve, look: CurveLook, label: str | None = None) -> None:
    """Draw median and band where recordings were, and beyond that a dashed median alone.

    Where the data do not determine the curve its band is hatched.
    """
    shown = curve.shown
    for open_ in (False, True):
        where = shown & (curve.determined != open_)
        if where.any():
            area = _area(look.colour, look.hatch if open_ else None)
            inside = _joined(where, shown).tolist()
            gid = "open" if open_ else "band"
            ax.fill_between(x, curve.low, curve.high, where=inside, gid=gid, **area)
    ax.plot(x, curve.median, color=look.colour, gid="outside", **_OUTSIDE)
    seen = np.where(_joined(shown, np.isfinite(curve.median)), curve.median, np.nan)
    marks: Look = {"marker": look.marker, "markersize": 2.6, "markevery": (look.start, look.every)}
    ax.plot(x, seen, color=look.colour, linewidth=look.width, label=label, gid="median", **marks)


def curve_handles(curves: Sequence[Curve], band: str, other: str) -> list[Artist]:
    """List what a legend explains of curves; colours of the band and of the rest."""
    handles: list[Artist] = []
    if any((c.shown & c.determined).any() for c in curves):
        handles.append(Patch(label=f"{100 * LEVEL:.0f} % band", **_area(band, None)))
    if any((~c.covered & np.isfinite(c.median)).any() for c in curves):
        handles.append(
            Line2D([], [], color=other, label=f"fewer than {FEWEST} outputs near", **_OUTSIDE)
        )
    if any((c.shown & ~c.determined).any() for c in curves):
        handles.append(Patch(label="NOT determined by the data", **_area(other, OPEN_HATCH)))
    return handles


def _area(colour: str, hatch: str | None) -> Look:
    if hatch is None:
        return {"facecolor": colour, "edgecolor": "none", "alpha": 0.3, "linewidth": 0.0}
    return {"facecolor": "none", "edgecolor": colour, "hatch": hatch, "linewidth": 0.4}


def _joined(flags: Flags, within: Flags) -> Flags:
    """Grow by one neighbour, so that parts of a band meet."""
    grown = flags.copy()
    grown[1:] |= flags[:-1]
    grown[:-1] |= flags[1:]
    return grown & within


def _finite(x: Array) -> Array:
    return np.where(np.isfinite(x), x, np.nan)


def _robust_sd(x: Array) -> Array:
    """Sds from quartiles: what divides by 1 - mu_2 has no finite one under many priors."""
    low, high = np.nanquantile(x, [0.25, 0.75], axis=0)
    return np.asarray((high - low) / 1.349)


def friction_torque(
    chain: Joint, values: Array, speed: Array, load: Array, *, open_scale: bool
) -> Array:
    """Friction of the whole joint at constant speed, seen at the motor.

    ``speed`` ``(N,)`` is the motor's, not zero, where friction has no one value; ``load`` ``(N,)``
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
    return np.asarray(sign * torque - load)


@dataclass(frozen=True, eq=False)
class Covered:
    """Where the recordings were."""

    speed: Array  # `(M,)` of the motor at every output, rad/s or m/s
    # `(M,)` loss-free torque of the load at the motor at the posterior median, its inertia
    # included; positive where it resists the motion
    load: Array

    def near(self, speed: Array, load: Array | None) -> Flags:
        """Tell which places ``(N,)`` have ``FEWEST`` outputs near; all loads count if ``None``."""
        mine, places = [self.speed], [speed]
        if load is not None:
            mine.append(self.load)
            places.append(load)
        spans = np.array([max(float(np.ptp(x)), 1e-300) for x in mine])
        # nine tenths of the outputs, or one jerk would stretch what counts as near
        inner = np.array([float(np.subtract(*np.quantile(x, [0.95, 0.05]))) for x in mine])
        spans = np.where(inner > 0.0, inner / 0.9, spans)
        tree = cKDTree(np.stack(mine, axis=1) / spans)
        distance, _ = tree.query(
            np.stack(places, axis=1) / spans, k=min(FEWEST, self.speed.size), p=np.inf
        )
        return np.asarray(np.reshape(distance, (speed.size, -1))[:, -1] <= NEAR)


def covered(fit: Fit, median: Array, *, open_scale: bool) -> Covered:
    """Collect speeds of all outputs, and their loads at the chain parameters ``median``."""
    reach = float(load_reach(fit.chain, median[None], open_scale=open_scale)[0])
    speeds, loads = [], []
    for o in fit.observations:
        gamma = load_at_outputs(fit.chain, o, median)
        speeds.append(fit.chain.ratio * o.speed)
        loads.append(reach * gamma * np.sign(o.speed))
    return Covered(np.concatenate(speeds), np.concatenate(loads))
