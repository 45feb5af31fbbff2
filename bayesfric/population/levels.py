r"""Spread between joints and within a joint, and a trend, of runs that say a normal each.

``y_r = b0 + b1 x_r + B_joint + W_r + error``, with ``B ~ N(0, between^2)`` and
``W ~ N(0, within^2)``, the error of the run's own sd. Coefficients are flat and integrated in
closed form (generalised least squares and the restricted likelihood), the two spreads are on a
grid; their priors are half-Cauchy of the sd of all values, which leave three values as open as they
are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesfric.population.population import Interval, interval

Array = NDArray[np.float64]

# Grid of each spread, in the sd of all values; then as fine where the posterior is.
_SPREADS = np.geomspace(3e-3, 10.0, 40)
_FAR = 12.0
_DRAWS = 8000
# Fewer joints, or fewer repetitions in all, have no spread to speak of; fewer values no trend.
_JOINTS, _REPEATED, _VALUES = 3, 2, 4


@dataclass(frozen=True)
class Levels:
    """Where a quantity's spread comes from; ``None`` where the fleet is not made to tell."""

    between: Interval | None  # sd between joints
    within: Interval | None  # sd of one joint from unit to unit
    slope: Interval | None  # change per unit of what it is looked at over


def levels(
    values: Array,
    sds: Array,
    joints: Sequence[str] | None = None,
    over: Array | None = None,
    level: float = 0.9,
    seed: int = 0,
) -> Levels:
    """Split a spread, and look for a trend, ``(n,)`` each."""
    y_scale, middle = float(values.std()), float(values.mean())
    if len(values) < _VALUES or not y_scale > 0.0:
        return Levels(None, None, None)
    y, s = (values - middle) / y_scale, sds / y_scale
    columns = [np.ones_like(y)]
    x_scale = 0.0 if over is None else float(over.std())
    if over is not None and x_scale > 0.0:
        columns.append((over - over.mean()) / x_scale)
    x = np.stack(columns, axis=1)
    group = np.unique(joints, return_inverse=True)[1] if joints else np.arange(len(y))
    count = int(group.max()) + 1
    split = count >= _JOINTS and len(y) - count >= _REPEATED
    if not split:
        group, count = np.arange(len(y)), len(y)
    # without a split all spread is one
    within, between = _SPREADS, _SPREADS if split else np.zeros(1)
    log, *_ = _posterior(y, s, x, group, count, within, between)
    within = _finer(within, log.max(axis=1))
    between = _finer(between, log.max(axis=0))
    log, best, root = _posterior(y, s, x, group, count, within, between)
    chance = np.exp(log - log.max()).ravel()
    rng = np.random.default_rng(seed)
    row, column = np.divmod(rng.choice(chance.size, _DRAWS, p=chance / chance.sum()), between.size)

    def jittered(grid: Array, index: NDArray[np.int_]) -> Array:
        step = np.log(grid[1] / grid[0])
        return np.asarray(grid[index] * np.exp((rng.random(_DRAWS) - 0.5) * step))

    slope = None
    if x.shape[1] == 2:
        draws = best[row, column, 1] + root[row, column] * rng.standard_normal(_DRAWS)
        slope = interval(draws, level, unit=y_scale / x_scale)
    if not split:
        return Levels(None, None, slope)
    return Levels(
        interval(jittered(between, column), level, unit=y_scale),
        interval(jittered(within, row), level, unit=y_scale),
        slope,
    )


def _finer(grid: Array, log: Array) -> Array:
    """Take as many spreads where the posterior is; one alone stays."""
    near = np.flatnonzero(log > log.max() - _FAR)
    if grid.size == 1:
        return grid
    low, high = grid[max(near[0] - 1, 0)], grid[min(near[-1] + 1, grid.size - 1)]
    return np.geomspace(low, high, grid.size)


def _posterior(
    y: Array, s: Array, x: Array, group: NDArray[np.int_], count: int, grid: Array, between: Array
) -> tuple[Array, Array, Array]:
    """Log density of ``(within, between)``, coefficients there, and the sd of the last one."""
    shape = (grid.size, between.size)
    log, best, root = np.empty(shape), np.empty((*shape, x.shape[1])), np.empty(shape)
    prior_between = np.log(between / (1.0 + between**2)) if between.size > 1 else np.zeros(1)
    for i, within in enumerate(grid):
        w = 1.0 / (s**2 + within**2)
        in_group = np.bincount(group, w, count)
        data = np.column_stack([x, y])
        sums = np.stack([np.bincount(group, w * one, count) for one in data.T], axis=1)
        # each joint's own value takes this share of its sums away
        taken = between[:, None] ** 2 / (1.0 + between[:, None] ** 2 * in_group)
        cross = data.T @ (w[:, None] * data) - np.einsum("bg,gi,gj->bij", taken, sums, sums)
        normal, right = cross[:, :-1, :-1], cross[:, :-1, -1]
        found = np.linalg.solve(normal, right[..., None])[..., 0]
        left = cross[:, -1, -1] - (right * found).sum(axis=1)
        volume = -np.log(w).sum() + np.log1p(between[:, None] ** 2 * in_group).sum(axis=1)
        log[i] = -0.5 * (left + volume + np.linalg.slogdet(normal)[1])
        log[i] += np.log(within / (1.0 + within**2)) + prior_between
        best[i], root[i] = found, np.sqrt(np.linalg.inv(normal)[:, -1, -1])
    return log, best, root
