"""Priors: a number fixes, a range is uniform, a distribution is SciPy's by name.

What may a configuration say of a parameter, is it possible, and what density, mean and interval
does it stand for? Distributions are cut to the parameter's support and normalised there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal

import numpy as np
from scipy import stats

from bayesfric.base.errors import BadInput, nearest
from bayesfric.mechanism.parameter import TURN, turned
from bayesfric.recordings.arrays import Array

# What a configuration may say: 3.3e-4, [0, 1] or {distribution = "norm", loc = 1, scale = 2}.
PriorText = float | Sequence[float] | Mapping[str, Any]

# A range this much wider or narrower than a turn is a turn, rad: nobody types all digits of pi, and
# a gap of a degree that 3.14 or 6.3 leaves nobody means.
_TURN_TYPED = 0.02
# Below this share of its mass inside the parameter's support a prior is taken for a mistake.
_LEAST_MASS = 1e-6
# Sd over value of a told prior that is there because the value is known.
KNOWN = 0.2

# Distributions of scipy.stats that a prior may be: of closed form, quick whatever the arguments.
DISTRIBUTIONS = (
    "norm", "halfnorm", "lognorm", "loguniform", "uniform", "expon", "triang", "truncnorm", "t",
    "cauchy", "halfcauchy", "laplace", "logistic", "gamma", "invgamma", "beta", "weibull_min",
)  # fmt: skip
# The largest number in a prior; it can still be squared.
_LARGEST = 1e100

Side = Literal["lower", "upper"]


def bound_of(x: Array, low: float, high: float) -> Side | None:
    """Say which end of its support a sample leans on.

    Shapes: ``x`` (n,).
    """
    first, last = np.quantile(x, [0.05, 0.95])
    near = 0.2 * x.std()
    if first - low < near:
        return "lower"
    return "upper" if high - last < near else None


@dataclass(frozen=True)
class Prior:
    """What is believed of one parameter before the recording is looked at."""

    text: str  # As printed: fixed at 0.33, uniform(0, 1), halfnorm(loc=0, scale=0.5)
    distribution: Any  # SciPy's frozen distribution, None where the parameter is fixed
    value: float  # The fixed value, nan where the parameter is free; SI units, as all others
    # Support: the distribution's, cut to the parameter's
    lower: float
    upper: float
    mass: float = 1.0  # Of the distribution inside the support; the density is divided by it
    default: bool = False  # Whether the package chose it
    circular: bool = False  # Whether values a turn apart are the same

    @property
    def fixed(self) -> bool:
        """Whether the parameter is held at one value."""
        return self.distribution is None

    @property
    def whole_turn(self) -> bool:
        """Whether every angle is as likely: then nothing says where the circle is cut."""
        return (
            self.circular
            and not self.fixed
            and self.distribution.dist.name == "uniform"
            and self.upper - self.lower > TURN - _TURN_TYPED
        )

    @property
    def limits(self) -> tuple[float, float]:
        """Ends of the support that mean something: the cut of a whole turn is none."""
        return (-math.inf, math.inf) if self.whole_turn else (self.lower, self.upper)

    def cut_opposite(self, value: float) -> Prior:
        """Make the same prior, a whole turn cut where it is farthest from a value."""
        if not self.whole_turn:
            return self
        low = value - TURN / 2.0
        whole = stats.uniform(low, TURN)
        return replace(self, distribution=whole, lower=low, upper=low + TURN, mass=1.0)

    def turned(self, x: Array) -> Array:
        """Bring angles ``(n,)``, rad, by whole turns to the turn the support lies on.

        Others than circular parameters stay as they are.
        """
        return turned(x, (self.lower + self.upper) / 2.0) if self.circular else x

    def log_density(self, x: Array) -> Array:
        """Log of the density at ``(n,)`` values, ``-inf`` outside the support."""
        with np.errstate(all="ignore"):
            density = self.distribution.logpdf(x) - math.log(self.mass)
        # at the very edge some closed forms are 0 - inf - inf: no number, no density
        inside = (x >= self.lower) & (x <= self.upper) & ~np.isnan(density)
        return np.where(inside, density, -np.inf)

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """Draw ``n`` values by inversion, inside the support."""
        if self.fixed:
            return np.full(n, self.value)
        return self._quantiles(rng.random(n))

    def interval(self, level: float) -> tuple[float, float]:
        """Give the central interval of a probability."""
        if self.fixed:
            return self.value, self.value
        low, high = self._quantiles(np.array([0.5 - level / 2.0, 0.5 + level / 2.0])).tolist()
        return low, high

    def _quantiles(self, shares: Array) -> Array:
        """Values that so much of the distribution inside the support is below."""
        low, high = self.distribution.cdf(self.lower), self.distribution.cdf(self.upper)
        values = self.distribution.ppf(low + (high - low) * shares)
        return np.asarray(np.clip(values, self.lower, self.upper), dtype=np.float64)

    def sd(self) -> float:
        """Return the standard deviation of the cut distribution; 0 where fixed.

        By quadrature in probability where the support cuts the distribution; infinite or nan where
        the whole one has none, as a Cauchy.
        """
        if self.fixed or self.mass > 1.0 - 1e-12:
            return 0.0 if self.fixed else float(self.distribution.std())
        x, weights = self._nodes()
        return float(np.sqrt(weights @ (x - weights @ x) ** 2))

    def mean(self) -> float:
        """Return the mean of the cut distribution, or the fixed value."""
        if self.fixed or self.mass > 1.0 - 1e-12:
            return self.value if self.fixed else float(self.distribution.mean())
        x, weights = self._nodes()
        return float(weights @ x)

    def _nodes(self) -> tuple[Array, Array]:
        """Nodes and weights of a quadrature in probability, inside the support."""
        low, high = self.distribution.cdf(self.lower), self.distribution.cdf(self.upper)
        nodes, weights = _gauss()
        return self.distribution.ppf(low + (high - low) * (nodes + 1.0) / 2.0), weights / 2.0


@cache
def _gauss() -> tuple[Array, Array]:
    return np.polynomial.legendre.leggauss(200)


def fixed(value: float) -> Prior:
    """Hold a parameter at a value, SI units."""
    return Prior(f"fixed at {value:.6g}", None, float(value), float(value), float(value))


def read_prior(
    name: str,
    text: PriorText,
    *,
    lower: float,
    upper: float,
    default: bool = False,
    circular: bool = False,
) -> Prior:
    """Turn what a configuration says of one parameter into a prior."""
    where = f"priors.{name}"
    span = f"{name} {_span(lower, upper)}"
    if isinstance(text, bool):
        raise BadInput(where, "true/false is no prior", "give a number, [low, high] or a table")
    if isinstance(text, int | float):
        value = _finite(text)
        if value is None or not lower <= value <= upper:
            raise BadInput(where, f"{_number(text)} is no possible value", span)
        return fixed(value)
    if isinstance(text, Mapping):
        prior = _named(where, text, lower, upper, span, circular)
    else:
        prior = _range(where, text, lower, upper, span, circular)
    return replace(prior, default=default, circular=circular)


def _range(
    where: str, text: Sequence[float], lower: float, upper: float, span: str, circular: bool
) -> Prior:
    """Read a uniform prior from ``[low, high]``; a range that is a turn but for typing is one.

    BadInput if these are no two rising numbers inside the support, or more than a turn.
    """
    given: object = text
    if isinstance(given, str) or not isinstance(given, Sequence) or len(given) != 2:
        raise BadInput(where, f"{text!r} is no prior", "give a number, [low, high] or a table")
    low, high = _finite(text[0]), _finite(text[1])
    if low is None or high is None:
        shown = f"[{_number(text[0])}, {_number(text[1])}]"
        raise BadInput(where, f"{shown} is no range", "give two finite numbers")
    if not low < high:
        raise BadInput(where, f"[{low:g}, {high:g}] is no range", "put the smaller number first")
    if low < lower or high > upper:
        raise BadInput(where, f"[{low:g}, {high:g}] reaches outside what is possible", span)
    if circular and high - low > TURN + _TURN_TYPED:
        mend = f"give one turn at most, such as [{low:g}, {low + TURN:.6g}]"
        raise BadInput(where, f"[{low:g}, {high:g}] is more than one turn", mend)
    if circular and high - low > TURN - _TURN_TYPED:
        high = low + TURN
    shown = f"uniform({low:.6g}, {high:.6g})"
    return Prior(shown, stats.uniform(low, high - low), math.nan, low, high)


def _named(
    where: str, text: Mapping[str, Any], lower: float, upper: float, span: str, circular: bool
) -> Prior:
    """Read a distribution of :mod:`scipy.stats` and cut it to the support."""
    arguments = dict(text)
    kind = arguments.pop("distribution", None)
    if kind not in DISTRIBUTIONS:
        hint = f"use one of {', '.join(DISTRIBUTIONS)}"
        raise BadInput(where, f"there is no distribution {kind!r}", hint)
    family = getattr(stats, kind)
    shapes = [name.strip() for name in (family.shapes or "").split(",") if name.strip()]
    for key, value in arguments.items():
        if key not in (known := [*shapes, "loc", "scale"]):
            raise BadInput(where, f"{kind} takes no {key!r}", nearest(key, known))
        if _finite(value) is None:
            raise BadInput(f"{where}.{key}", f"got {_number(value)}", "give a finite number")
    if missing := [name for name in shapes if name not in arguments]:
        raise BadInput(where, f"{kind} needs {missing[0]!r}", f"add {missing[0]} = ...")
    shown = ", ".join(f"{key}={_number(value)}" for key, value in arguments.items())
    try:
        with np.errstate(all="ignore"):
            frozen = family(**{key: float(value) for key, value in arguments.items()})
            low, high = frozen.support()
            if circular:
                lower, upper = frozen.median() - TURN / 2.0, frozen.median() + TURN / 2.0
            mass = float(frozen.cdf(upper) - frozen.cdf(lower))
            spread = float(frozen.ppf(0.75) - frozen.ppf(0.25))
    except (TypeError, ValueError, ArithmeticError) as error:
        raise BadInput(where, str(error), f"see scipy.stats.{kind} for its arguments") from None
    if not (math.isfinite(mass) and math.isfinite(spread) and spread > 0.0):
        raise BadInput(where, f"there is no {kind}({shown})", f"see scipy.stats.{kind}")
    if mass < _LEAST_MASS:
        raise BadInput(where, f"{kind}({shown}) lies outside what is possible", span)
    low, high = max(float(low), lower), min(float(high), upper)
    cut = "" if mass > 1.0 - 1e-9 else f" cut to [{low:g}, {high:g}]"
    return Prior(f"{kind}({shown}){cut}", frozen, math.nan, low, high, mass)


def _finite(value: Any) -> float | None:
    """Take a finite number that can still be squared, and nothing else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if abs(value) <= _LARGEST else None


def _number(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    shown = f"{value:.6g}" if isinstance(value, float) else repr(value)
    return shown if len(shown) <= 40 else f"{shown[:40]}..."


def _span(lower: float, upper: float) -> str:
    if math.isfinite(upper):
        return f"lies between {lower:.6g} and {upper:.6g}"
    return f"is {lower:g} or more" if math.isfinite(lower) else "is any finite number"


class JointPrior:
    """Independent priors of several parameters, evaluated together.

    Normal, half-normal and uniform densities, which most parameters have, are one sum over
    columns; the others are evaluated one by one.
    """

    def __init__(self, priors: Sequence[Prior]) -> None:
        self._lower = np.array([prior.lower for prior in priors])
        self._upper = np.array([prior.upper for prior in priors])
        self._constant = 0.0
        # a column whose scale is infinite adds nothing to the sum of squares
        self._loc, self._scale = np.zeros(len(priors)), np.full(len(priors), np.inf)
        self._others: list[tuple[int, Prior]] = []
        for j, prior in enumerate(priors):
            family = prior.distribution.dist.name
            if family not in ("norm", "halfnorm", "uniform"):
                self._others.append((j, prior))
                continue
            loc, scale = _loc_scale(*prior.distribution.args, **prior.distribution.kwds)
            self._constant -= math.log(scale) + math.log(prior.mass)
            if family != "uniform":
                self._loc[j], self._scale[j] = loc, scale
                self._constant -= 0.5 * math.log((2.0 if family == "norm" else 0.5) * math.pi)

    def log_density(self, x: Array) -> Array:
        """Log of the joint density.

        Shapes: ``x`` (n, d), returns (n,).
        """
        inside = np.all((x >= self._lower) & (x <= self._upper) & np.isfinite(x), axis=1)
        with np.errstate(all="ignore"):
            squares = np.sum(((x - self._loc) / self._scale) ** 2, axis=1)
        total = np.where(inside, self._constant - 0.5 * squares, -np.inf)
        for j, prior in self._others:
            total = total + prior.log_density(x[:, j])
        return np.asarray(total)


def _loc_scale(loc: float = 0.0, scale: float = 1.0) -> tuple[float, float]:
    """Take the arguments of a SciPy distribution without shape parameters."""
    return loc, scale
