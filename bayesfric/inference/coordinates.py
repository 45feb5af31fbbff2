"""Coordinates in which the posterior is searched and sampled.

Priors are given and results reported in physical parameters. The search for the mode and the
sampler work in coordinates in which the posterior is closer to a normal; a target adds the log
Jacobian determinant.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

Array = NDArray[np.float64]

# Width of the posterior, over the distance of two bounds, from which both truncate it.
_WIDE = 0.1


class Coordinates(ABC):
    """A one-to-one map between coordinates ``u`` and the ``d`` free parameters.

    There may be a second set in which the torque is linear; the sampler moves walkers in both.
    """

    @property
    def is_nonlinear(self) -> bool:
        """Whether the torque is nonlinear in ``u`` and linear in the second set."""
        return False

    @property
    @abstractmethod
    def represents(self) -> NDArray[np.intp]:
        """Index ``(d,)`` of the free parameter whose torque each linear coordinate represents."""

    def to_linear(self, u: Array) -> tuple[Array, Array]:
        """Map ``(n, d)`` to linear coordinates, with ``log|dv/du|`` ``(n,)``."""
        return u, np.zeros(len(u))

    def from_linear(self, v: Array) -> Array:
        """Map linear coordinates ``(n, d)`` back; impossible rows are not finite."""
        return v

    @abstractmethod
    def to_parameters(self, u: Array) -> tuple[Array, Array]:
        """Map ``(n, d)`` to parameters and the log Jacobian ``(n,)``, ``-inf`` if impossible."""

    @abstractmethod
    def from_parameters(self, parameters: Array) -> Array:
        """Map parameters ``(n, d)`` to coordinates ``(n, d)``."""


class BoundedCoordinates(Coordinates):
    """Each parameter separately, with bounds and posterior widths ``(d,)``, nan if not known.

    Without widths, for the search, a parameter with one bound is the logarithm of its distance from
    it, one with two bounds the normal quantile of its relative position. With widths, for the
    sampler, a parameter represents itself, as the torque is linear in it and the bound truncates
    the posterior; only bounds closer than ten widths are mapped by the quantile.
    """

    def __init__(
        self, lower: Sequence[float], upper: Sequence[float], widths: Array | None = None
    ) -> None:
        self.lower, self.upper = np.array(lower, dtype=float), np.array(upper, dtype=float)
        low, high = np.isfinite(self.lower), np.isfinite(self.upper)
        span = np.where(low & high, self.upper - self.lower, np.inf)
        widths = np.full(low.size, np.nan) if widths is None else widths
        unknown = np.isnan(widths)
        self._above, self._below = unknown & low & ~high, unknown & high & ~low
        self._between = low & high & (unknown | (widths > _WIDE * span))
        self._span = np.where(self._between, span, 1.0)
        self._low = np.where(low, self.lower, 0.0)
        self._high = np.where(high, self.upper, 0.0)

    def to_parameters(self, u: Array) -> tuple[Array, Array]:
        """See :class:`Coordinates`."""
        # exp saturates; the density there is zero
        distance = np.exp(np.clip(u, -700.0, 700.0))
        x = np.where(self._above, self._low + distance, u)
        x = np.where(self._below, self._high - distance, x)
        x = np.where(self._between, self._low + self._span * ndtr(u), x)
        slope = np.where(self._above | self._below, u, 0.0)
        slope = np.where(self._between, np.log(self._span) + log_normal(u), slope)
        # rounding may place a parameter on its bound, where a noise model may be undefined
        outside = (x <= self.lower) | (x >= self.upper)
        return x, np.where(outside.any(axis=1), -np.inf, slope.sum(axis=1))

    def from_parameters(self, parameters: Array) -> Array:
        """See :class:`Coordinates`."""
        # all branches are evaluated for all parameters, and fail on the others' values
        with np.errstate(all="ignore"):
            u = np.where(self._above, np.log(parameters - self._low), parameters)
            u = np.where(self._below, np.log(self._high - parameters), u)
            return np.where(self._between, ndtri((parameters - self._low) / self._span), u)

    @property
    def represents(self) -> NDArray[np.intp]:
        """See :class:`Coordinates`."""
        return np.arange(self.lower.size)


def log_normal(u: Array) -> Array:
    """Log density of a standard normal."""
    with np.errstate(over="ignore"):
        return np.asarray(-0.5 * u**2 - 0.5 * math.log(2.0 * math.pi))
