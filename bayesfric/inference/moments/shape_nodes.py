"""A term whose shape is unknown, as a sum of columns of known shapes.

A column that depends smoothly on its shape (the speed of a Stribeck rise, the exponent of a power
of speed, a time constant) is a polynomial in it over the range that matters: its values at
Chebyshev nodes, times Lagrange's polynomials [1]_. The torque stays linear in as many coefficients,
and a recording with such a term can be reduced to moments too.

References
----------
.. [1] J.-P. Berrut, L. N. Trefethen, "Barycentric Lagrange interpolation", SIAM Review 46 (2004)
   501-517.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesfric.recordings.arrays import Array

# Error of the interpolated column, relative to the column: 1e-3 of a unit in the log density
# where a term is a thousand times the noise in 10^5 samples.
ACCURACY = 1e-8
# Share of that accuracy below which a sum of the nodes' columns is left out.
_LEFT_OUT = 0.1
# Numbers of nodes that are tried, and how far beyond the draws the range reaches at first.
_NODES = (1, 8, 12, 16, 24, 32)
_BEYOND = 1.3
# Factor by which a range that is too wide shrinks, and how often at most.
_SHRINK, _TIMES = 0.75, 40


@dataclass(frozen=True, eq=False)
class ShapeNodes:
    """Values of one shape at which its columns are made, and the range in which that is enough."""

    index: int  # Of the shape among the mechanism's parameters
    # Range of the shape, SI units
    low: float
    high: float
    nodes: Array  # (K,) values in it
    logarithmic: bool  # Whether the polynomial is in the shape's logarithm
    # (K, r) and its inverse (r, K): columns at nodes lie close together, so few of their sums are
    # enough
    mixed: Array
    unmixed: Array

    @classmethod
    def over(
        cls,
        index: int,
        draws: Array,
        support: tuple[float, float],
        column: Callable[[float], Array],
    ) -> ShapeNodes:
        """Choose range and nodes for draws of the shape.

        Shapes: ``draws`` (n,), ``column`` (samples,).
        """
        logarithmic = support[0] == 0.0 and not np.isfinite(support[1])
        t = np.log(draws[draws > 0.0]) if logarithmic else draws
        middle = float(np.median(t))
        reach = _BEYOND * float(np.abs(t - middle).max())
        ends = (-np.inf, np.inf) if logarithmic else support
        for _ in range(_TIMES):
            low, high = max(middle - reach, ends[0]), min(middle + reach, ends[1])
            for count in _NODES if reach == 0.0 else _NODES[1:]:
                found = cls._at(index, low, high, count, logarithmic=logarithmic)
                known = found.along(column)
                if reach == 0.0 or found._error(column, known) < ACCURACY:
                    return found._of_few(known)
            reach *= _SHRINK
        return cls._at(index, middle, middle, 1, logarithmic=logarithmic)

    @classmethod
    def _at(
        cls, index: int, low: float, high: float, count: int, *, logarithmic: bool
    ) -> ShapeNodes:
        turn = np.cos(np.pi * (np.arange(count) + 0.5) / count)
        nodes = 0.5 * (low + high) + 0.5 * (high - low) * turn
        back = np.exp if logarithmic else np.asarray
        same = np.eye(count)
        return cls(index, float(back(low)), float(back(high)), back(nodes), logarithmic, same, same)

    def _of_few(self, known: Array) -> ShapeNodes:
        """Make the same with as few sums of columns ``(K, n)`` as the accuracy asks for."""
        left, singular, _ = np.linalg.svd(known, full_matrices=False)
        few = singular > _LEFT_OUT * ACCURACY * singular[0]
        return replace(self, mixed=left[:, few], unmixed=left[:, few].T)

    def along(self, column: Callable[[float], Array]) -> Array:
        """Give the columns that :meth:`weights` multiply, ``(r, samples)``."""
        return np.asarray(self.unmixed @ np.stack([column(float(x)) for x in self.nodes]))

    def _error(self, column: Callable[[float], Array], known: Array) -> float:
        """Give the largest relative error at the range's ends and halfway between nodes."""
        between = np.sort(self.nodes)
        between = np.concatenate([[self.low], 0.5 * (between[1:] + between[:-1]), [self.high]])
        guessed = self.weights(between) @ known
        errors = [
            np.linalg.norm(guess - there) / max(float(np.linalg.norm(there)), 1e-300)
            for guess, there in (
                (g, column(float(x))) for g, x in zip(guessed, between, strict=True)
            )
        ]
        return float(max(errors))

    def covers(self, values: Array) -> NDArray[np.bool_]:
        """Say which of parameter vectors ``(n, n_parameters)`` have the shape in the range."""
        shape = values[:, self.index]
        return np.asarray((shape >= self.low) & (shape <= self.high))

    def weights(self, shape: Array) -> Array:
        """Give what multiplies the columns.

        Shapes: ``shape`` (n,), returns (n, r).
        """
        count = self.nodes.size
        if count == 1:
            return np.ones((shape.size, 1))
        scale = np.log if self.logarithmic else np.asarray
        turn = np.pi * (np.arange(count) + 0.5) / count
        # as angles of the Chebyshev points: in the values themselves differences cancel
        with np.errstate(all="ignore"):
            low, high = scale(self.low), scale(self.high)
            x = (2.0 * scale(shape) - low - high) / (high - low)
            apart = x[:, None] - np.cos(turn)
            parts = np.sin(turn) * (-1.0) ** np.arange(count) / apart
            found = parts / parts.sum(axis=1, keepdims=True)
            at = apart == 0.0
            hit = at.any(axis=1)
            found[hit] = at[hit]
            return np.asarray(found @ self.mixed)
