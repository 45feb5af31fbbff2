"""Priors: a number fixes, a range is uniform, a distribution is SciPy's by name.

Distributions are truncated to the parameter's support and normalised there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal, TypeGuard

import numpy as np
from scipy import stats

from bayesfric.base.errors import BadInput, nearest
from bayesfric.estimates.least_squares import sizes_at
from bayesfric.estimates.point_estimate import Knowledge
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import TURN, Parameter, State, TypicalSizes, turned
from bayesfric.recordings.arrays import Array

# 3.3e-4, [0, 1] or {distribution = "norm", loc = 1, scale = 2}
PriorText = float | Sequence[float] | Mapping[str, Any]

# Tolerance, rad, within which a range is a whole turn: pi is rarely typed with all digits.
_TURN_TYPED = 0.02
# Relative standard deviation up to which a prior states a known value.
KNOWN = 0.2

# Distributions of scipy.stats with a closed form.
DISTRIBUTIONS = (
    "norm", "halfnorm", "lognorm", "loguniform", "uniform", "expon", "triang", "truncnorm", "t",
    "cauchy", "halfcauchy", "laplace", "logistic", "gamma", "invgamma", "beta", "weibull_min",
)  # fmt: skip

_gauss_legendre = cache(np.polynomial.legendre.leggauss)


def bound_of(x: Array, low: float, high: float) -> Literal["lower", "upper"] | None:
    """Return the bound that a sample ``(n,)`` is close to."""
    first, last = np.quantile(x, [0.05, 0.95])
    near = 0.2 * x.std()
    if first - low < near:
        return "lower"
    return "upper" if high - last < near else None


@dataclass(frozen=True)
class Prior:
    """Prior of one parameter, SI units."""

    text: str  # such as uniform(0, 1) or halfnorm(loc=0, scale=0.5)
    distribution: Any  # SciPy's frozen distribution, None if fixed
    value: float  # fixed value, nan if free
    # support, truncated to the parameter's
    lower: float
    upper: float
    mass: float = 1.0  # probability of the distribution inside the support
    default: bool = False
    circular: bool = False  # whether values a turn apart are equal

    @property
    def fixed(self) -> bool:
        """Fix a parameter at a value, SI units."""
        return self.distribution is None

    @property
    def whole_turn(self) -> bool:
        """Whether it is uniform over a whole turn."""
        return (
            self.circular
            and not self.fixed
            and self.distribution.dist.name == "uniform"
            and self.upper - self.lower > TURN - _TURN_TYPED
        )

    @property
    def limits(self) -> tuple[float, float]:
        """Bounds of the support; infinite for a whole turn."""
        return (-math.inf, math.inf) if self.whole_turn else (self.lower, self.upper)

    def cut_opposite(self, value: float) -> Prior:
        """Cut a whole turn opposite a value."""
        if not self.whole_turn:
            return self
        low = value - TURN / 2.0
        turn = stats.uniform(loc=low, scale=TURN)
        return replace(self, distribution=turn, lower=low, upper=low + TURN, mass=1.0)

    def turned(self, x: Array) -> Array:
        """Unwrap circular parameters ``(n,)``, rad, to the support's turn."""
        return turned(x, (self.lower + self.upper) / 2.0) if self.circular else x

    def log_density(self, x: Array) -> Array:
        """Log density at values ``(n,)``, ``-inf`` outside the support."""
        return joint_log_density([self])(x[:, None])

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """Draw ``n`` values."""
        if self.fixed:
            return np.full(n, self.value)
        return self._quantiles(rng.random(n))

    def interval(self, level: float) -> tuple[float, float]:
        """Return the central interval of a probability."""
        if self.fixed:
            return self.value, self.value
        low, high = self._quantiles(np.array([0.5 - level / 2.0, 0.5 + level / 2.0])).tolist()
        return low, high

    def _quantiles(self, shares: Array) -> Array:
        """Quantiles of the truncated distribution."""
        low, high = self.distribution.cdf(self.lower), self.distribution.cdf(self.upper)
        values = self.distribution.ppf(low + (high - low) * shares)
        return np.asarray(np.clip(values, self.lower, self.upper), dtype=np.float64)

    def mean(self) -> float:
        """Return the mean, or the fixed value."""
        return self._moments()[0]

    def sd(self) -> float:
        """Return the standard deviation, 0 if fixed; infinite or nan if undefined."""
        return self._moments()[1]

    def _moments(self) -> tuple[float, float]:
        if self.fixed:
            return self.value, 0.0
        if self.mass > 1.0 - 1e-12:
            with np.errstate(all="ignore"):  # inf - inf, such as of a half-Cauchy
                return float(self.distribution.mean()), float(self.distribution.std())
        # by a quadrature in probability, inside the support
        nodes, weights = _gauss_legendre(200)
        x, weights = self._quantiles((nodes + 1.0) / 2.0), weights / 2.0
        mean = float(weights @ x)
        return mean, float(np.sqrt(weights @ (x - mean) ** 2))


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
    """Read the configured prior of one parameter, whose support is from ``lower`` to ``upper``."""
    where, span = f"priors.{name}", f"{name} is any finite number"
    if math.isfinite(upper):
        span = f"{name} lies between {lower:.6g} and {upper:.6g}"
    elif math.isfinite(lower):
        span = f"{name} is {lower:g} or more"
    if isinstance(text, Mapping):
        prior = _distribution(where, text, lower, upper, span, circular)
    elif _is_finite(text):
        if not lower <= text <= upper:
            raise BadInput(where, f"{text:g} is not possible", span)
        prior = fixed(text)
    elif isinstance(text, Sequence) and len(text) == 2 and all(map(_is_finite, text)):
        prior = _range(where, float(text[0]), float(text[1]), lower, upper, span, circular)
    else:
        hint = "give a finite number, [low, high] or a table"
        raise BadInput(where, f"{str(text).lower()[:80]} is not a prior", hint)
    return replace(prior, default=default, circular=circular)


def _is_finite(value: Any) -> TypeGuard[float]:
    """Whether it is a number whose square is finite."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and abs(value) <= 1e100


def _range(
    where: str, low: float, high: float, lower: float, upper: float, span: str, circular: bool
) -> Prior:
    """Read a uniform prior ``[low, high]``."""
    shown = f"[{low:g}, {high:g}]"
    if not low < high:
        raise BadInput(where, f"{shown} is not increasing", "put the smaller number first")
    if low < lower or high > upper:
        raise BadInput(where, f"{shown} exceeds the possible range", span)
    if circular and high - low > TURN + _TURN_TYPED:
        hint = f"give one turn at most, such as [{low:g}, {low + TURN:.6g}]"
        raise BadInput(where, f"{shown} is more than one turn", hint)
    if circular and high - low > TURN - _TURN_TYPED:
        high = low + TURN
    distribution = stats.uniform(loc=low, scale=high - low)
    return Prior(f"uniform({low:.6g}, {high:.6g})", distribution, math.nan, low, high)


def _distribution(
    where: str, text: Mapping[str, Any], lower: float, upper: float, span: str, circular: bool
) -> Prior:
    """Read a distribution of :mod:`scipy.stats` and truncate it to the support."""
    arguments = dict(text)
    kind = arguments.pop("distribution", None)
    if kind not in DISTRIBUTIONS:
        hint = f"use one of {', '.join(DISTRIBUTIONS)}"
        raise BadInput(where, f"there is no distribution {kind!r}", hint)
    family, reference = getattr(stats, kind), f"see scipy.stats.{kind} for its arguments"
    shapes = family.shapes.split(", ") if family.shapes else []
    for key, value in arguments.items():
        if key not in (known := [*shapes, "loc", "scale"]):
            raise BadInput(where, f"{kind} takes no {key!r}", nearest(key, known))
        if not _is_finite(value):
            raise BadInput(f"{where}.{key}", f"got {str(value).lower()}", "give a finite number")
    if missing := [name for name in shapes if name not in arguments]:
        raise BadInput(where, f"{kind} needs {missing[0]!r}", f"add {missing[0]} = ...")
    shown = f"{kind}({', '.join(f'{key}={value:.6g}' for key, value in arguments.items())})"
    with np.errstate(all="ignore"):
        frozen = family(**{key: float(value) for key, value in arguments.items()})
        low, high = frozen.support()
        if circular:
            lower, upper = frozen.median() - TURN / 2.0, frozen.median() + TURN / 2.0
        mass = float(frozen.cdf(upper) - frozen.cdf(lower))
        quartiles = float(frozen.ppf(0.75) - frozen.ppf(0.25))
    if not (math.isfinite(mass) and math.isfinite(quartiles) and quartiles > 0.0):
        raise BadInput(where, f"there is no {shown}", reference)
    if mass < 1e-6:
        raise BadInput(where, f"{shown} is outside the possible range", span)
    low, high = max(float(low), lower), min(float(high), upper)
    cut = "" if mass > 1.0 - 1e-9 else f" cut to [{low:g}, {high:g}]"
    return Prior(shown + cut, frozen, math.nan, low, high, mass)


def joint_log_density(priors: Sequence[Prior]) -> Callable[[Array], Array]:
    """Return the log density ``(n,)`` of independent priors as a function of values ``(n, d)``.

    The usual families are evaluated together, faster than by SciPy.
    """
    constants = {
        "norm": -0.5 * math.log(2.0 * math.pi),
        "halfnorm": 0.5 * math.log(2.0 / math.pi),
        "uniform": 0.0,
    }
    families = [prior.distribution.dist.name for prior in priors]
    usual = [i for i, family in enumerate(families) if family in constants]
    others = [i for i, family in enumerate(families) if family not in constants]
    limits = np.array([(p.lower, p.upper, p.mass) for p in priors]).reshape(-1, 3)
    lower, upper, mass = limits.T
    places = [priors[i].distribution.kwds for i in usual]
    location = np.array([place.get("loc", 0.0) for place in places])
    scale = np.array([place.get("scale", 1.0) for place in places])
    curved = np.array([families[i] != "uniform" for i in usual])
    constant = sum(constants[families[i]] for i in usual) - np.log(scale).sum() - np.log(mass).sum()

    def log_density(x: Array) -> Array:
        with np.errstate(all="ignore"):
            z = np.where(curved, (x[:, usual] - location) / scale, 0.0)
            density = constant - 0.5 * (z**2).sum(axis=1)
            for i in others:
                density = density + priors[i].distribution.logpdf(x[:, i])
            # at the bound some closed forms are nan
            inside = ((x >= lower) & (x <= upper)).all(axis=1) & ~np.isnan(density)
        return np.where(inside, density, -np.inf)

    return log_density


def default_prior(chain: Joint, p: Parameter, scales: TypicalSizes) -> Prior:
    """Choose the default prior of one parameter, weakly informative.

    A term is expected to need at most the largest measured torque: Coulomb friction has a
    half-normal of that scale, viscous friction that torque over the typical speed, an inertia that
    torque over the typical acceleration, each at its element's shaft. Terms that store energy may
    exchange it without the motor, as gravity and inertia of a pendulum: theirs is at least the
    torque that least squares assigns to one with certainty. Sizes are rounded to one digit.
    """
    row = p.row
    if row.stores:
        scales = replace(scales, torque=max(scales.torque, scales.exchanged))
    sizes, scale = sizes_at(chain, p.owner, scales), 1.0
    if row.spread is not None:
        scale = row.spread(sizes)
    elif row.prior != "uniform":
        if row.column is None or row.power is None:
            size = scales.columns[p.name]
        else:  # some losses act in one direction only
            states = [
                State(w, w * sizes.speed, w * sizes.acceleration, w, 0.0) for w in (1.0, -1.0)
            ]
            size = max(abs(row.column(state)) for state in states)
        scale = sizes.torque / size if size > 0.0 else sizes.torque
    text: PriorText
    if row.prior == "uniform":
        text = [-TURN / 2.0, TURN / 2.0] if row.circular else [row.lower, row.upper]
    elif row.prior == "lognorm":
        text = {"distribution": "lognorm", "s": scale}
    else:
        family = row.prior or ("halfnorm" if p.lower == 0.0 else "norm")
        text = {"distribution": family, "scale": float(f"{scale:.0e}")}
    upper = min(p.upper, row.prior_upper)
    return read_prior(p.name, text, lower=p.lower, upper=upper, default=True, circular=p.circular)


def as_knowledge(chain: Joint, priors: Mapping[str, Prior]) -> Knowledge:
    """Convert priors to what point estimates use: known values, bounds, and Gaussian priors.

    A prior with a central value that the user gave enters with its mean and standard deviation;
    default priors only bound.
    """
    fixed, bounds, values = {}, {}, {}
    for name in chain.names:
        prior = priors[name]
        if prior.fixed:
            fixed[name] = prior.value
            continue
        bounds[name] = prior.limits
        # uniform and half-normal distributions have no central value
        if prior.default or prior.distribution.dist.name in ("uniform", "loguniform", "halfnorm"):
            continue
        mean, sd = prior.mean(), prior.sd()
        if np.isfinite(mean) and np.isfinite(sd) and sd > 0.0:
            values[name] = (mean, sd)
    return Knowledge(fixed, bounds, values)
