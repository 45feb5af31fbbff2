"""Priors of all parameters at once: one pass over the array for all common families."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayesfric.inference.prior.priors import Prior

Array = NDArray[np.float64]
Columns = NDArray[np.int64]


class JointPrior:
    """Independent priors of several parameters, none of them fixed, evaluated together.

    A step of the sampler asks for the density of some hundred vectors. One parameter at a
    time, the calls alone cost more than the likelihood of a long recording.
    """

    def __init__(self, priors: Sequence[Prior]) -> None:
        self._lower = np.array([p.lower for p in priors])
        self._upper = np.array([p.upper for p in priors])
        self._constant = 0.0
        # Every common family is, up to a constant, -z²/2 - L with z of x or of its logarithm
        # L, and one of the two missing in some.
        straight: list[tuple[int, float, float]] = []
        logarithmic: list[tuple[int, float, float]] = []
        falling: list[tuple[int, float, float]] = []
        self._others: list[tuple[int, Prior]] = []
        for j, prior in enumerate(priors):
            family = prior.distribution.dist.name
            shapes, loc, scale = prior.distribution.dist._parse_args(
                *prior.distribution.args, **prior.distribution.kwds
            )
            half_log = 0.5 * math.log(2.0 * math.pi)
            if family in ("norm", "halfnorm"):
                straight.append((j, loc, scale))
                self._constant -= math.log(scale) + half_log
                self._constant += math.log(2.0) if family == "halfnorm" else 0.0
            elif family == "lognorm":
                logarithmic.append((j, math.log(scale), float(shapes[0])))
                falling.append((j, loc, 1.0))
                self._constant -= math.log(shapes[0]) + half_log
            elif family == "loguniform":
                falling.append((j, loc, 1.0))
                self._constant -= math.log(math.log(shapes[1] / shapes[0]))
            elif family == "uniform":
                self._constant -= math.log(scale)
            else:
                self._others.append((j, prior))
                continue
            self._constant -= math.log(prior.mass)
        self._straight = _columns(straight)
        self._falling = _columns(falling)
        places = {j: i for i, (j, _, _) in enumerate(falling)}
        self._logarithmic = _columns([(places[j], m, s) for j, m, s in logarithmic])

    def log_density(self, x: Array) -> Array:
        """Log of the joint density at ``(n, d)``, ``(n,)``; ``-inf`` outside a support."""
        with np.errstate(all="ignore"):
            total = np.full(x.shape[0], self._constant)
            columns, loc, scale = self._straight
            if columns.size:
                total -= 0.5 * np.sum(((x[:, columns] - loc) / scale) ** 2, axis=1)
            columns, loc, _ = self._falling
            if columns.size:
                logs = np.log(x[:, columns] - loc)
                total -= np.sum(logs, axis=1)
                columns, middle, sd = self._logarithmic
                if columns.size:
                    total -= 0.5 * np.sum(((logs[:, columns] - middle) / sd) ** 2, axis=1)
            inside = np.all((x >= self._lower) & (x <= self._upper), axis=1)
            # at the very edge some closed forms are 0 - inf - inf: no number, no density
            total = np.where(inside & ~np.isnan(total), total, -np.inf)
            for j, prior in self._others:
                total = total + prior.log_density(x[:, j])
        return np.asarray(total)


def _columns(rows: Sequence[tuple[float, float, float]]) -> tuple[Columns, Array, Array]:
    """Turn rows that begin with a column's number into arrays, the numbers whole."""
    if not rows:
        return (np.empty(0, dtype=np.int64), np.empty(0), np.empty(0))
    table = np.array(rows, dtype=np.float64)
    return table[:, 0].astype(np.int64), table[:, 1], table[:, 2]
