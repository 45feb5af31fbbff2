"""Interpolation of a term of unknown shape by columns of known shapes.

A column that depends smoothly on its shape (the speed of a Stribeck rise, the exponent of a power
of speed, a time constant) is a polynomial in it over the relevant range: its values at Chebyshev
nodes, times Lagrange's polynomials (Berrut and Trefethen, "Barycentric Lagrange interpolation",
SIAM Review 46 (2004) 501-517). The torque stays linear in as many coefficients, and a recording can
be reduced to moments.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesfric.recordings.arrays import Array

# Relative error of the interpolated column: 1e-3 in the log density if a term is a thousand times
# the noise in 10^5 samples.
ACCURACY = 1e-8
# Share of that accuracy below which a combination of columns is dropped.
_LEFT_OUT = 0.1
# Numbers of nodes that are tried, and initial margin around the draws.
_NODES = (1, 8, 12, 16, 24, 32)
_MARGIN = 1.3
# Factor by which a too wide range shrinks, and the largest number of times.
_SHRINK, _SHRINKS = 0.75, 40


@dataclass(frozen=True, eq=False)
class ShapeNodes:
    """Nodes of one shape, and the range in which interpolation is accurate."""

    index: int  # of the shape among the parameters
    # range, SI units
    low: float
    high: float
    nodes: Array  # (K,)
    logarithmic: bool  # of the logarithm
    # (K, r) and its inverse (r, K): columns at nodes are collinear, so few combinations suffice
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
        """Choose range and nodes for draws ``(n,)`` of the shape."""
        logarithmic = support[0] == 0.0 and not np.isfinite(support[1])
        t = np.log(draws[draws > 0.0]) if logarithmic else draws
        middle = float(np.median(t))
        reach = _MARGIN * float(np.abs(t - middle).max())
        ends = (-np.inf, np.inf) if logarithmic else support
        for _ in range(_SHRINKS):
            low, high = max(middle - reach, ends[0]), min(middle + reach, ends[1])
            for count in _NODES if reach == 0.0 else _NODES[1:]:
                nodes = cls._at(index, low, high, count, logarithmic=logarithmic)
                columns = nodes.along(column)
                if reach == 0.0 or nodes._error(column, columns) < ACCURACY:
                    return nodes._compressed(columns)
            reach *= _SHRINK
        return cls._at(index, middle, middle, 1, logarithmic=logarithmic)

    @classmethod
    def _at(
        cls, index: int, low: float, high: float, count: int, *, logarithmic: bool
    ) -> ShapeNodes:
        cosine = np.cos(np.pi * (np.arange(count) + 0.5) / count)
        nodes = 0.5 * (low + high) + 0.5 * (high - low) * cosine
        inverse = np.exp if logarithmic else np.asarray
        identity = np.eye(count)
        return cls(
            index,
            float(inverse(low)),
            float(inverse(high)),
            inverse(nodes),
            logarithmic,
            identity,
            identity,
        )

    def _compressed(self, columns: Array) -> ShapeNodes:
        """Reduce the columns ``(K, n)`` to as few combinations as the accuracy allows."""
        left, singular, _ = np.linalg.svd(columns, full_matrices=False)
        kept = singular > _LEFT_OUT * ACCURACY * singular[0]
        return replace(self, mixed=left[:, kept], unmixed=left[:, kept].T)

    def along(self, column: Callable[[float], Array]) -> Array:
        """Return the columns ``(r, samples)`` that :meth:`weights` multiply."""
        return np.asarray(self.unmixed @ np.stack([column(float(x)) for x in self.nodes]))

    def _error(self, column: Callable[[float], Array], columns: Array) -> float:
        """Return the largest relative error at the range's ends and between nodes."""
        test_points = np.sort(self.nodes)
        test_points = np.concatenate(
            [[self.low], 0.5 * (test_points[1:] + test_points[:-1]), [self.high]]
        )
        interpolated = self.weights(test_points) @ columns
        errors = [
            np.linalg.norm(estimate - exact) / max(float(np.linalg.norm(exact)), 1e-300)
            for estimate, exact in (
                (g, column(float(x))) for g, x in zip(interpolated, test_points, strict=True)
            )
        ]
        return float(max(errors))

    def covers(self, values: Array) -> NDArray[np.bool_]:
        """Flag parameter vectors ``(n, n_parameters)`` with the shape in the range."""
        shape = values[:, self.index]
        return np.asarray((shape >= self.low) & (shape <= self.high))

    def weights(self, shape: Array) -> Array:
        """Return the weights ``(n, r)`` of the columns for shapes ``(n,)``."""
        count = self.nodes.size
        if count == 1:
            return np.ones((shape.size, 1))
        scale = np.log if self.logarithmic else np.asarray
        angle = np.pi * (np.arange(count) + 0.5) / count
        # as angles of the Chebyshev points, to avoid cancellation
        with np.errstate(all="ignore"):
            low, high = scale(self.low), scale(self.high)
            x = (2.0 * scale(shape) - low - high) / (high - low)
            differences = x[:, None] - np.cos(angle)
            parts = np.sin(angle) * (-1.0) ** np.arange(count) / differences
            weights = parts / parts.sum(axis=1, keepdims=True)
            at_node = differences == 0.0
            hit = at_node.any(axis=1)
            weights[hit] = at_node[hit]
            return np.asarray(weights @ self.mixed)
