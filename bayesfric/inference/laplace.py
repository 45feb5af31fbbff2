"""Where to start: the posterior's mode and a normal around it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LogDensity = Callable[[Array], Array]

# A density that falls by this much is one standard deviation away.
_ONE_SD = 0.5
# Candidates that are followed to their peak.
_CLIMBS = 5


@dataclass(frozen=True)
class Laplace:
    """Normal approximation at the mode, in sampling coordinates.

    Attributes
    ----------
    mode
        ``(d,)``
    covariance
        ``(d, d)``
    log_density
        At the mode.
    """

    mode: Array
    covariance: Array
    log_density: float

    def draw_starts(
        self, n: int, log_density: LogDensity, rng: np.random.Generator, *, spread: float = 1.5
    ) -> Array:
        """Draw over-dispersed starts of non-zero probability, ``(n, d)``.

        Starts at zero probability are redrawn, closer in each time: emcee would
        take one and keep that walker stuck for ever.

        Raises
        ------
        RuntimeError
            If no start of non-zero probability is found beside the mode.
        """
        root = np.linalg.cholesky(self.covariance)
        starts = np.empty((n, self.mode.size))
        missing = np.arange(n)
        for _ in range(60):
            z = rng.standard_normal((missing.size, self.mode.size))
            stretch = np.sqrt(8.0 / rng.chisquare(8.0, size=missing.size))
            starts[missing] = self.mode + spread * stretch[:, None] * (z @ root.T)
            missing = missing[~np.isfinite(log_density(starts[missing]))]
            if missing.size == 0:
                return starts
            spread *= 0.9
        raise RuntimeError("no start of non-zero probability beside the posterior's mode")


def laplace(log_density: LogDensity, candidates: Array, *, max_steps: int = 60) -> Laplace:
    """Climb to the mode from the best of several candidates.

    Newton steps with a Hessian by finite differences, damped as Levenberg and
    Marquardt do. Steps of the differences adapt to where the density has fallen
    by half a unit, which averages over the kinks that direction-dependent losses
    leave in it.

    Parameters
    ----------
    log_density
        ``(n, d)`` to ``(n,)``, ``-inf`` allowed.
    candidates
        ``(n, d)`` places to start from.

    Raises
    ------
    ValueError
        If every candidate has zero probability.
    """
    heights = log_density(candidates)
    if not np.isfinite(heights).any():
        raise ValueError("every starting point has zero probability")
    # Direction-dependent losses make several peaks, and the highest candidate need
    # not stand at the foot of the highest one.
    order = [i for i in np.argsort(-heights)[:_CLIMBS] if np.isfinite(heights[i])]
    climbs = [_climb(log_density, candidates[i], heights[i], max_steps) for i in order]
    x, height, steps = max(climbs, key=lambda climb: climb[1])
    _, hessian = _derivatives(log_density, x, height, steps)
    # Flat or rising directions get the width that the difference steps found there.
    scaled = -hessian * np.outer(steps, steps)
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2.0)
    inverse = (vectors / np.clip(values, 0.05, None)) @ vectors.T
    return Laplace(x, inverse * np.outer(steps, steps), height)


def _climb(
    log_density: LogDensity, x: Array, height: float, max_steps: int
) -> tuple[Array, float, Array]:
    damping = 1.0
    steps = _difference_steps(log_density, x, height, np.full(x.size, 0.1) * (np.abs(x) + 1e-3))
    for _ in range(max_steps):
        steps = _difference_steps(log_density, x, height, steps)
        gradient, hessian = _derivatives(log_density, x, height, steps)
        gradient, curvature = gradient * steps, -hessian * np.outer(steps, steps)
        values, vectors = np.linalg.eigh((curvature + curvature.T) / 2.0)
        rotated = vectors.T @ gradient
        dampings = damping * 10.0 ** np.arange(-3.0, 5.0)
        moves = np.array(
            [vectors @ (rotated / (np.clip(values, 1e-3, None) + d)) for d in dampings]
        )
        trials = x + moves * steps
        heights = log_density(trials)
        best = int(np.argmax(heights))
        gain = heights[best] - height
        if not gain > 0.0:
            if damping > 1e8:
                break
            damping *= 1e3
            continue
        x, height = trials[best], float(heights[best])
        damping = float(np.clip(dampings[best], 1e-6, 1e6))
        if gain < 1e-3:
            break
    return x, height, steps


def _difference_steps(log_density: LogDensity, x: Array, height: float, steps: Array) -> Array:
    """Widths over which the density changes by about half a unit, ``(d,)``."""
    steps = steps.copy()
    for _ in range(20):
        trials = np.concatenate([x + np.diag(steps), x - np.diag(steps)])
        fall = np.abs(log_density(trials) - height).reshape(2, -1).max(axis=0)
        narrow, wide = fall < 0.2 * _ONE_SD, ~(fall < 8.0 * _ONE_SD)
        # nothing moves the density at all: leave a unit step rather than grow for ever
        narrow &= steps < 1e3 * (np.abs(x) + 1.0)
        if not (narrow | wide).any():
            break
        steps[narrow] *= 2.0
        steps[wide] /= 3.0
    return steps


def _derivatives(
    log_density: LogDensity, x: Array, height: float, steps: Array
) -> tuple[Array, Array]:
    """Gradient ``(d,)`` and Hessian ``(d, d)`` by central differences, in one batch."""
    d = x.size
    one = np.concatenate([x + np.diag(steps), x - np.diag(steps)])
    rows, columns = np.triu_indices(d, 1)
    pair = np.zeros((rows.size, d))
    pair[np.arange(rows.size), rows] = steps[rows]
    pair[np.arange(rows.size), columns] = steps[columns]
    values = log_density(np.concatenate([one, x + pair, x - pair]))
    # a difference that steps out of the support says: steeply down
    values = np.where(np.isfinite(values), values, height - 50.0)
    up, down = values[:d], values[d : 2 * d]
    both, neither = values[2 * d : 2 * d + rows.size], values[2 * d + rows.size :]
    gradient = (up - down) / (2.0 * steps)
    hessian = np.diag((up - 2.0 * height + down) / steps**2)
    curvature = up + down
    mixed = (both + neither + 2.0 * height - curvature[rows] - curvature[columns]) / 2.0
    hessian[rows, columns] = hessian[columns, rows] = mixed / (steps[rows] * steps[columns])
    return gradient, hessian
