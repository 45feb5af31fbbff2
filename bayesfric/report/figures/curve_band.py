"""A curve of the posterior: median, 90 % band, and where the data determine it at all."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from bayesfric.identifiability.local import LocalInformation, local_information, verdict
from bayesfric.inference.fitting import Fit
from bayesfric.report.figures.style import OPEN_HATCH, Array, Look
from bayesfric.report.summary.summary import LEVEL

Flags = NDArray[np.bool_]
# Joint parameters (n, n_parameters) to the curve's points (n, N)
Curve = Callable[[Array], Array]

# Outputs that must be near a place for it to count as recorded.
FEWEST = 3
# A quantile of so many draws is known to a fortieth of the band's width.
_DRAWS = 1000
_PRIOR_DRAWS = 500
_OUTSIDE: Look = {"linestyle": (0, (3.0, 2.0)), "linewidth": 0.6}


@dataclass(frozen=True, eq=False)
class CurveBand:
    """A function of the parameters at ``N`` places."""

    # `(N,)` of the posterior; the ends of its central 90 % interval. Over the draws that have a
    # value; `nan` where fewer than half of them do.
    median: Array
    low: Array
    high: Array
    determined: Flags  # `(N,)` whether the data had a say: false where the verdict is `prior`

    def part(self, where: Flags, sign: float = 1.0) -> CurveBand:
        """Take some of the places, times plus or minus one."""
        median, low, high = (sign * x[where] for x in (self.median, self.low, self.high))
        return CurveBand(median, low, high, self.determined[where])


@dataclass(frozen=True, eq=False)
class LoadCurve:
    """A band over, or at, loads ``(N,)``, and whether ``FEWEST`` outputs were near ``(N,)``."""

    load: Array  # loss-free, see :mod:`bayesfric.report.figures.friction_curve`
    band: CurveBand
    covered: Flags

    @property
    def shown(self) -> Flags:
        """Where there is a band to see."""
        return np.asarray(self.covered & np.isfinite(self.band.median))


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
        posterior, target = fit.posterior, fit.target
        sampled = posterior.median
        self._fit = fit
        self.local: LocalInformation = local_information(target, sampled)
        self.median: Array = target.chain_values(sampled[None])[0]
        k = len(target.free)
        self._steps = 1e-5 * np.maximum(np.abs(sampled[:k]), 1e-9)
        self._moved = target.chain_values(_both_ways(sampled, self._steps))
        rng = np.random.default_rng(np.random.SeedSequence(posterior.seed, spawn_key=(4,)))
        drawn = np.stack([p.draw(_PRIOR_DRAWS, rng) for p in posterior.priors], axis=1)
        self._prior = target.chain_values(drawn)

    @property
    def open_scale(self) -> bool:
        """Whether theory leaves a scale between leg and alpha open."""
        return self.local.from_theory > 0

    def band(self, curve: Curve, *, gauge_free: bool, draws: int = _DRAWS) -> CurveBand:
        """Evaluate a curve over at most ``draws`` of the posterior and judge every point of it.

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
        return CurveBand(middle, low, high, np.array(determined, dtype=np.bool_))


def draw_curve(
    ax: Axes, x: Array, curve: LoadCurve, look: CurveLook, label: str | None = None
) -> None:
    """Draw median and band where recordings were, and beyond that a dashed median alone.

    Where the data do not determine the curve its band is hatched.
    """
    band, shown = curve.band, curve.shown
    for open_ in (False, True):
        where = shown & (band.determined != open_)
        if where.any():
            area = _area(look.colour, look.hatch if open_ else None)
            inside = _joined(where, shown).tolist()
            gid = "open" if open_ else "band"
            ax.fill_between(x, band.low, band.high, where=inside, gid=gid, **area)
    ax.plot(x, band.median, color=look.colour, gid="outside", **_OUTSIDE)
    seen = np.where(_joined(shown, np.isfinite(band.median)), band.median, np.nan)
    marks: Look = {"marker": look.marker, "markersize": 2.6, "markevery": (look.start, look.every)}
    ax.plot(x, seen, color=look.colour, linewidth=look.width, label=label, gid="median", **marks)


def curve_handles(curves: Sequence[LoadCurve], band: str, other: str) -> list[Artist]:
    """List what a legend explains of curves; colours of the band and of the rest."""
    handles: list[Artist] = []
    if any((c.shown & c.band.determined).any() for c in curves):
        handles.append(Patch(label=f"{100 * LEVEL:.0f} % band", **_area(band, None)))
    if any((~c.covered & np.isfinite(c.band.median)).any() for c in curves):
        handles.append(
            Line2D([], [], color=other, label=f"fewer than {FEWEST} outputs near", **_OUTSIDE)
        )
    if any((c.shown & ~c.band.determined).any() for c in curves):
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


def _both_ways(centre: Array, steps: Array) -> Array:
    """Vectors a step to either side in each free parameter, ``(2k, d)``."""
    moves = np.pad(np.diag(steps), ((0, 0), (0, centre.size - steps.size)))
    return np.concatenate([centre + moves, centre - moves])


def _finite(x: Array) -> Array:
    return np.where(np.isfinite(x), x, np.nan)


def _robust_sd(x: Array) -> Array:
    """Sds from quartiles: what divides by 1 - mu_2 has no finite one under many priors."""
    low, high = np.nanquantile(x, [0.25, 0.75], axis=0)
    return np.asarray((high - low) / 1.349)
