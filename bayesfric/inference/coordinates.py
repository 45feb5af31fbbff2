"""Coordinates in which the posterior is sampled.

A walker lives in unconstrained coordinates ``u``; a target turns ``u`` into
parameters and adds the logarithm of the Jacobian determinant, so that priors are
stated, and results reported, in physical parameters. Good coordinates make the posterior look
like a normal one: that is what the sampler's proposals follow best.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf, log_ndtr, ndtr, ndtri, ndtri_exp

Array = NDArray[np.float64]

# Between two bounds, a posterior wider than this share of them feels both.
_WIDE = 0.1
# Below this a half-normal's quantile is told to rounding by two terms of its series.
_NEAR = -4.0


class Coordinates(ABC):
    """A one-to-one map between unconstrained ``u`` and the ``d`` free parameters.

    There may be a second set, straight ones ``v``, which bounds cut and in which the torque is
    closer to linear; the sampler moves walkers in both.
    """

    @property
    def bends(self) -> bool:
        """Whether there are straight coordinates, in which a posterior that is bent here is not."""
        return False

    @property
    @abstractmethod
    def stands_for(self) -> NDArray[np.intp]:
        """Index ``(d,)`` of the free parameter whose torque each straight coordinate sums up."""

    def straighten(self, u: Array) -> tuple[Array, Array]:
        """Map to straight coordinates.

        Parameters
        ----------
        u
            ``(n, d)``.

        Returns
        -------
        v, slope
            ``(n, d)`` and ``log|dv/du|`` ``(n,)``; the same and zero where nothing bends.
        """
        return u, np.zeros(len(u))

    def bend(self, v: Array) -> Array:
        """Map straight coordinates ``(n, d)`` back; rows without a counterpart are not finite."""
        return v

    @abstractmethod
    def to_parameters(self, u: Array) -> tuple[Array, Array]:
        """Map ``(n, d)`` to parameters ``(n, d)`` and ``log|d parameters / d u|`` ``(n,)``.

        Rows without a counterpart come back with ``-inf``.
        """

    @abstractmethod
    def from_parameters(self, parameters: Array) -> Array:
        """Map parameters ``(n, d)`` to ``u`` ``(n, d)``."""


class BoundedCoordinates(Coordinates):
    """Each parameter by itself: bounded ones bent, free ones as they are.

    Parameters
    ----------
    lower, upper
        ``(d,)`` bounds, infinite where there are none.
    widths
        ``(d,)`` about the posterior's standard deviations; plain logarithms of the distance from a
        bound if they are not known yet.

    Notes
    -----
    A parameter above a bound is ``lower + w h(u)``, with the half-normal quantile ``h(u) =
    Phi^-1((1 + Phi(u))/2)``: a straight line where the posterior lies several widths ``w`` above
    the bound, a normal's distribution function next to it. So a normal stays one that keeps away
    from the bound, and becomes one that is cut by it in its middle. (A logarithm would give either
    a long left tail, in which walkers hang on.) Of a parameter between two bounds less than ten
    widths apart the normal quantile of its place between them, ``lower + span Phi(u)``, is sampled,
    for the same reason.
    """

    def __init__(
        self, lower: Sequence[float], upper: Sequence[float], widths: Array | None = None
    ) -> None:
        self._bend = widths is not None
        self.lower, self.upper = np.array(lower, dtype=float), np.array(upper, dtype=float)
        low, high = np.isfinite(self.lower), np.isfinite(self.upper)
        span = np.where(low & high, self.upper - self.lower, np.inf)
        self._widths = np.ones(self.lower.size) if widths is None else widths
        self._between = low & high & ((self._widths > _WIDE * span) | (not self._bend))
        self._above = low & ~self._between
        self._below = ~low & high
        self._alone = self._above | self._below  # at one bound
        self._span = np.where(self._between, span, 1.0)
        self._low = np.where(low, self.lower, 0.0)
        self._high = np.where(high, self.upper, 0.0)

    def to_parameters(self, u: Array) -> tuple[Array, Array]:
        """See :class:`Coordinates`."""
        x, slope = self._mapped(u)
        # so far out that rounding puts a parameter on its bound, where a noise model may end
        on_bound = (x <= self.lower) | (x >= self.upper)
        return x, np.where(on_bound.any(axis=1), -np.inf, slope.sum(axis=1))

    def _mapped(self, u: Array) -> tuple[Array, Array]:
        """Give parameters ``(n, d)`` and the log slope of each."""
        if self._bend:
            distance = half_normal(u)
            log_slope = log_normal(u) - log_normal(distance) - math.log(2.0)
        else:
            # exp saturates far out; the density there is zero anyway
            distance, log_slope = np.exp(np.clip(u, -700.0, 700.0)), u
        distance = self._widths * distance
        x = np.where(self._above, self._low + distance, u)
        x = np.where(self._below, self._high - distance, x)
        x = np.where(self._between, self._low + self._span * ndtr(u), x)
        slope = np.where(self._alone, np.log(self._widths) + log_slope, 0.0)
        return x, np.where(self._between, np.log(self._span) + log_normal(u), slope)

    def from_parameters(self, parameters: Array) -> Array:
        """See :class:`Coordinates`."""
        # every branch is computed for every parameter, and each fails on the others' numbers
        with np.errstate(all="ignore"):
            u = np.where(self._above, self._unbent(parameters - self._low), parameters)
            u = np.where(self._below, self._unbent(self._high - parameters), u)
            share = (parameters - self._low) / self._span
            return np.where(self._between, ndtri(share), u)

    @property
    def bends(self) -> bool:
        """See :class:`Coordinates`: towards bounds."""
        return bool(self._alone.any())

    @property
    def stands_for(self) -> NDArray[np.intp]:
        """See :class:`Coordinates`: its own."""
        return np.arange(self.lower.size)

    def straighten(self, u: Array) -> tuple[Array, Array]:
        """See :class:`Coordinates`: values that a bound cuts off, instead of bending towards it.

        Those between two bounds that are near stay quantiles.
        """
        x, slope = self._mapped(u)
        slope = np.where(self._alone, slope, 0.0).sum(axis=1)
        on_bound = self._alone & ((x <= self.lower) | (x >= self.upper))
        return np.where(self._alone, x, u), np.where(on_bound.any(axis=1), -np.inf, slope)

    def bend(self, v: Array) -> Array:
        """See :class:`Coordinates`; not finite beyond a bound."""
        return np.where(self._alone, self.from_parameters(v), v)

    def _unbent(self, distance: Array) -> Array:
        scaled = distance / self._widths
        if not self._bend:
            return np.asarray(np.log(scaled))
        # each where it does not cancel
        near = ndtri(erf(scaled / math.sqrt(2.0)))
        return np.where(scaled < 1.0, near, -ndtri_exp(math.log(2.0) + log_ndtr(-scaled)))


def half_normal(u: Array) -> Array:
    """Give the half-normal variable at the probability of a normal one.

    ``h(u) = Phi^-1((1 + Phi(u))/2)``, of ``u`` of any shape, without cancellation in either tail.
    """
    below = ndtr(u)
    near = math.sqrt(math.pi / 2.0) * (below + math.pi / 12.0 * below**3)
    return np.where(u < _NEAR, near, -ndtri_exp(log_ndtr(-u) - math.log(2.0)))


def log_normal(u: Array) -> Array:
    """Log density of a standard normal: the log slope of its distribution function."""
    with np.errstate(over="ignore"):  # minus infinity is right then
        return np.asarray(-0.5 * u**2 - 0.5 * math.log(2.0 * math.pi))
