"""Coordinates in which the posterior is sampled.

A walker lives in unconstrained coordinates ``u``; a target turns ``u`` into
parameters and adds the logarithm of the Jacobian determinant, so that priors are
stated, and results reported, in physical parameters.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_expit, ndtr, ndtri

Array = NDArray[np.float64]

# Between two bounds, a posterior wider than this share of them feels both.
_WIDE = 0.1


class Coordinates(ABC):
    """A one-to-one map between ``u`` and the free parameters."""

    description: str  # in words, for the record

    @property
    def bends(self) -> bool:
        """Whether there are others, in which a posterior that is bent here is straight."""
        return False

    @property
    @abstractmethod
    def apart(self) -> tuple[slice, NDArray[np.intp], BoundedCoordinates]:
        """Coordinates of parameters that go each by itself, which these are, and how."""

    def straighten(self, u: Array) -> tuple[Array, Array]:
        """Map ``(n, d)`` to those, with the log Jacobian of that ``(n,)``."""
        return u, np.zeros(len(u))

    def bend(self, v: Array) -> Array:
        """Map back; rows without a counterpart are not finite."""
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

    A parameter above a bound is ``lower + w softplus(u)``: a straight line where
    the posterior lies several widths ``w`` above the bound, a logarithm next to it.
    A posterior that keeps away from the bound stays normal, one that leans on it
    needs no wall. (A plain logarithm would give the first a long left tail, in
    which walkers get lost.) Of a parameter between two bounds that are not far apart the
    normal quantile of its place between them is sampled: next to a bound a posterior is flat,
    and its quantile normal. (A logit would have a long tail there, in which walkers hang on.)

    ``widths`` ``(d,)`` are about the posterior sds; plain logarithms if they are not known yet.
    """

    def __init__(
        self, lower: Sequence[float], upper: Sequence[float], widths: Array | None = None
    ) -> None:
        self._bend = widths is not None
        self.description = "logarithm or normal quantile of each parameter between its bounds"
        if self._bend:
            self.description = "each parameter by itself, bent where it comes near a bound"
        self.lower, self.upper = np.array(lower, dtype=float), np.array(upper, dtype=float)
        low, high = np.isfinite(self.lower), np.isfinite(self.upper)
        span = np.where(low & high, self.upper - self.lower, np.inf)
        self._widths = np.ones(self.lower.size) if widths is None else widths
        self._between = low & high & ((self._widths > _WIDE * span) | (not self._bend))
        self._above = low & ~self._between
        self._below = ~low & high
        self._span = np.where(self._between, span, 1.0)
        self._low = np.where(low, self.lower, 0.0)
        self._high = np.where(high, self.upper, 0.0)

    def to_parameters(self, u: Array) -> tuple[Array, Array]:
        """See :class:`Coordinates`."""
        if self._bend:
            distance, log_slope = np.logaddexp(0.0, u), log_expit(u)
        else:
            # exp saturates far out; the density there is zero anyway
            distance, log_slope = np.exp(np.clip(u, -700.0, 700.0)), u
        distance = self._widths * distance
        x = np.where(self._above, self._low + distance, u)
        x = np.where(self._below, self._high - distance, x)
        x = np.where(self._between, self._low + self._span * ndtr(u), x)
        slope = np.where(self._above | self._below, np.log(self._widths) + log_slope, 0.0)
        slope = np.where(self._between, np.log(self._span) + log_normal(u), slope)
        # so far out that rounding puts a parameter on its bound, where a noise model may end
        on_bound = (x <= self.lower) | (x >= self.upper)
        return x, np.where(on_bound.any(axis=1), -np.inf, slope.sum(axis=1))

    def from_parameters(self, parameters: Array) -> Array:
        """See :class:`Coordinates`."""
        # every branch is computed for every parameter, and each fails on the others' numbers
        with np.errstate(all="ignore"):
            u = np.where(self._above, self._unbent(parameters - self._low), parameters)
            u = np.where(self._below, self._unbent(self._high - parameters), u)
            share = (parameters - self._low) / self._span
            return np.where(self._between, ndtri(share), u)

    @property
    def apart(self) -> tuple[slice, NDArray[np.intp], BoundedCoordinates]:
        """See :class:`Coordinates`: these are all."""
        return slice(0, self.lower.size), np.arange(self.lower.size), self

    def unbounded(self, u: Array) -> Array:
        """Give values ``(n, d)`` that a bound cuts off, instead of bending towards it.

        Those between two bounds that are near stay quantiles.
        """
        return np.where(self._between, u, self.to_parameters(u)[0])

    def from_unbounded(self, x: Array) -> Array:
        """Undo :meth:`unbounded`; not finite beyond a bound."""
        return np.where(self._between, x, self.from_parameters(x))

    def ends(self) -> tuple[Array, Array]:
        """Give the bounds of unbounded values, ``(d,)`` each."""
        between = self._between
        return np.where(between, -np.inf, self.lower), np.where(between, np.inf, self.upper)

    def _unbent(self, distance: Array) -> Array:
        scaled = distance / self._widths
        if not self._bend:
            return np.asarray(np.log(scaled))
        # log(expm1(y)) without overflow
        return np.asarray(scaled + np.log(-np.expm1(-scaled)))


def log_normal(u: Array) -> Array:
    """Log density of a standard normal: the log slope of its distribution function."""
    with np.errstate(over="ignore"):  # minus infinity is right then
        return np.asarray(-0.5 * u**2 - 0.5 * math.log(2.0 * math.pi))
