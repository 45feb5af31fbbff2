"""Sizes of effects that a model lacks, by Gibbs sampling with a horseshoe prior.

Candidates (:mod:`bayesfric.diagnostics.candidates`) are a few columns each. Each kind has one of
its shapes and a size of unknown scale, half Cauchy around one scale for all kinds, so that most are
nothing and one may be large rather than several collinear ones (Carvalho, Polson and Scott, "The
horseshoe estimator for sparse signals", Biometrika 97 (2010) 465-480); and with some probability
none is present. Given the scales, sizes are normal and integrated out; scales and shapes are on a
grid and drawn by Gibbs sampling from one Gram matrix, independent of the length of the recordings.

Columns only approximate the true effect; we allow a column error of 20 %, normal like the noise.
Otherwise nearly collinear candidates cancel with huge coefficients.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import expit, logsumexp

from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

Index = NDArray[np.intp]

# Scales of a candidate over the torque's rms: smallest, largest, and number.
_SMALLEST, _LARGEST, _SCALES = 3e-5, 0.5, 24
# Relative error of a column.
_COLUMN_ERROR = 0.2
# Scale of the half-Cauchy prior of the common scale.
_TYPICAL = 0.003
# Prior probability that something is missing; if the posterior one is less, intervals are not
# widened.
CHANCE = 0.1
# Sweeps of the Gibbs sampler, burn-in, draws of sizes in each sweep, and candidates included at the
# start.
_SWEEPS, _BURN, _DRAWS_A_SWEEP, _INITIAL = 300, 100, 20, 4
# Least share of the residual's power that is noise.
_LEAST = 1e-4
# Variance of a candidate over the noise's below which it does not affect the others.
_NEGLIGIBLE = 1e-4


@dataclass(frozen=True, eq=False)
class Missing:
    """Candidates of what the model lacks, as regression columns."""

    observations: tuple[Observation, ...]  # the recordings or subsamples
    # (M, m) filtered columns, N m or N, scaled to the torque's rms, or for friction to the model's
    # losses: an effect of size one is as large as that
    columns: Array
    # indices of the columns of each shape, by kind
    kinds: dict[str, tuple[tuple[int, ...], ...]]
    # Gram matrix (m, m), scores (m,) and power of whitened columns and residual, the model's own
    # projected out; scores of right models are subtracted
    gram: Array
    scores: Array
    column_errors: Array  # (m,) mean squares of columns over the noise's relative variance
    power: float
    # (m,) standard deviation of a right model's scores over that of white noise, at least one
    spread: Array
    free: int  # outputs less the model's parameters
    # (m,) whether a column biases friction in full: significant, and no function of speed
    biases_friction: NDArray[np.bool_]


def _grid() -> Array:
    """Return the scales ``(n,)`` that a candidate's size may have."""
    return np.geomspace(_SMALLEST, _LARGEST, _SCALES)


def chance_missing(missing: Missing) -> float:
    """Return the probability that any candidate is present, each tested separately.

    The Bayes factor of a candidate of standard deviation ``s`` is that of a linear regression with
    a normal size, the noise's variance integrated out, averaged over ``s``, shapes and kinds. Prior
    odds are 1 to 9.
    """
    variance = missing.power / missing.free
    scores = missing.scores / missing.spread
    grid, kind_factors = _grid(), []
    for shapes in missing.kinds.values():
        log_factors = []
        for columns in shapes:
            power, vectors = np.linalg.eigh(missing.gram[np.ix_(columns, columns)])
            rotated = vectors.T @ scores[list(columns)]
            size = grid[:, None] ** 2
            total = variance + size * np.clip(power, 0.0, None)
            gain = (rotated**2 * size / total).sum(axis=1) / missing.power
            log_gain = -0.5 * missing.free * np.log(np.maximum(1.0 - gain, 1e-12))
            log_factors.append(log_gain - 0.5 * np.log(total / variance).sum(axis=1))
        kind_factors.append(float(logsumexp(log_factors)) - math.log(np.size(log_factors)))
    if not kind_factors:
        return 0.0
    factor = float(logsumexp(kind_factors)) - math.log(len(kind_factors))
    odds: float = factor + math.log(CHANCE / (1.0 - CHANCE))
    return float(expit(odds))


@dataclass(frozen=True, eq=False)
class _Kind:
    """Shapes of one candidate; a column of zeros pads those of fewer columns."""

    shapes: Index  # (shapes, width) indices of columns
    columns: Index
    places: Index  # (shapes, width) indices into ``columns``

    @classmethod
    def of(cls, shapes: tuple[tuple[int, ...], ...], width: int, zero: int) -> _Kind:
        padded = np.array([shape + (zero,) * (width - len(shape)) for shape in shapes])
        widest = padded[:, : max(map(len, shapes))]
        columns, places = np.unique(widest, return_inverse=True)
        return cls(padded, columns, places.reshape(widest.shape))


@njit(cache=True)
def _evidence(grid, gram, scores, columns, places, active, sd):  # type: ignore[no-untyped-def]
    """Log evidence ``(shapes, scales)`` of a kind's shapes.

    Given ``active`` columns of sds ``sd``; ``places`` ``(shapes, width)`` index the kind's
    ``columns``.
    """
    m, a = columns.size, active.size
    precision, cross = np.empty((m, m + 1)), np.empty((a, m + 1))
    for i in range(m):
        precision[i, m] = scores[columns[i]]
        for j in range(m):
            precision[i, j] = gram[columns[i], columns[j]]
    if a:
        inner = np.empty((a, a))
        for i in range(a):
            cross[i, m] = sd[i] * scores[active[i]]
            for j in range(m):
                cross[i, j] = sd[i] * gram[active[i], columns[j]]
            for j in range(a):
                inner[i, j] = sd[i] * gram[active[i], active[j]] * sd[j]
            inner[i, i] += 1.0
        precision -= np.ascontiguousarray(cross[:, :m].T) @ np.linalg.solve(inner, cross)
    shapes, width = places.shape
    out, shape_gram = np.zeros((shapes, grid.size)), np.empty((width, width))
    for s in range(shapes):
        for i in range(width):
            for j in range(width):
                shape_gram[i, j] = precision[places[s, i], places[s, j]]
        power, vectors = np.linalg.eigh(shape_gram)
        for i in range(width):
            rotated = 0.0
            for j in range(width):
                rotated += vectors[j, i] * precision[places[s, j], m]
            for k in range(grid.size):
                size = grid[k] ** 2
                total = 1.0 + size * max(power[i], 0.0)
                out[s, k] += 0.5 * (size * rotated**2 / total - math.log(total))
    return out


class Sizes:
    """Gibbs sampler of candidates' shapes and scales; sizes are integrated out."""

    def __init__(self, missing: Missing) -> None:
        zero, shapes = missing.scores.size, missing.kinds.values()
        self.grid = _grid()
        width = max(len(shape) for kind_shapes in shapes for shape in kind_shapes)
        self.gram, self.scores = np.pad(missing.gram, (0, 1)), np.pad(missing.scores, (0, 1))
        self.rough_gram = self.gram + _COLUMN_ERROR**2 * np.diag(
            np.pad(missing.column_errors, (0, 1))
        )
        self.power, self.free = missing.power, missing.free
        self.kinds = [_Kind.of(kind_shapes, width, zero) for kind_shapes in shapes]
        self.included = np.array([kind.shapes[0] for kind in self.kinds])
        self.scale = np.zeros(len(self.kinds), dtype=np.intp)
        self._set_variance(missing.power / missing.free)

    def _set_variance(self, variance: float) -> None:
        """Set the noise variance."""
        self.variance, self.scaled_gram, self.scaled_scores = (
            variance,
            self.rough_gram / variance,
            self.scores / variance,
        )

    def drawn(self, rng: np.random.Generator) -> Array:
        """Draw sizes ``(n, m)`` of all candidates."""
        grid = self.grid
        ratio = grid[:, None] / grid
        log_prior = np.log(ratio) - np.log1p(ratio**2)  # half Cauchy in the logarithm
        log_prior -= logsumexp(log_prior, axis=0)  # (scale, typical scale)
        x = grid / _TYPICAL
        prior, typical_index = np.log(x / (1.0 + x * x)), 0
        # several kinds may sum to one, and no step leads back: the best is included first
        for _ in range(_INITIAL):
            evidence = [
                self._log_evidence(g) + log_prior[:, typical_index] for g in range(len(self.kinds))
            ]
            best = int(
                np.argmax(
                    [log_evidence.max() - log_evidence[:, 0].max() for log_evidence in evidence]
                )
            )
            self._select(best, int(np.argmax(evidence[best])))
            mean, _, active = self._conditional()
            self._set_variance(self._residual_power(active, mean) / self.free)
        sizes = np.zeros((_SWEEPS, _DRAWS_A_SWEEP, self.scores.size))
        for sweep in sizes:
            for g in range(len(self.kinds)):
                self._select(
                    g,
                    _categorical(
                        (self._log_evidence(g) + log_prior[:, typical_index]).ravel(), rng
                    ),
                )
            typical_index = _categorical(prior + log_prior[self.scale].sum(axis=0), rng)
            mean, root, active = self._conditional()
            drawn = mean[:, None] + root @ rng.standard_normal((active.size, _DRAWS_A_SWEEP))
            self._set_variance(
                self._residual_power(active, drawn[:, 0]) / float(rng.chisquare(self.free))
            )
            sweep[:, active] = drawn.T
        return sizes[_BURN:, :, :-1].reshape(-1, self.scores.size - 1)

    def _select(self, g: int, place: int) -> None:
        shape, self.scale[g] = divmod(place, self.grid.size)
        self.included[g] = self.kinds[g].shapes[shape]

    def _log_evidence(self, g: int) -> Array:
        """Return the log evidence of a kind's shapes at each scale, given all other kinds."""
        kind, (active, sd) = self.kinds[g], self._active(without=g)
        members = kind.columns, kind.places
        return np.asarray(
            _evidence(self.grid, self.scaled_gram, self.scaled_scores, *members, active, sd)
        )

    def _active(self, without: int | None = None) -> tuple[Index, Array]:
        """Return indices and sds of the included columns that are not negligible."""
        sd = np.repeat(self.grid[self.scale], self.included.shape[1]).reshape(self.included.shape)
        power = sd**2 * np.diagonal(self.scaled_gram)[self.included]
        if without is None:
            return self.included[power > 0.0], sd[power > 0.0]
        power[without] = 0.0
        matter = power > _NEGLIGIBLE
        return self.included[matter], sd[matter]

    def _inner(self, active: Index, sd: Array) -> Array:
        """Return the precision ``(active, active)`` of sizes over their standard deviations."""
        inner = sd[:, None] * self.scaled_gram[active[:, None], active] * sd
        inner[np.diag_indices(active.size)] += 1.0
        return np.asarray(inner)

    def _conditional(self) -> tuple[Array, Array, Index]:
        """Return mean ``(active,)`` and root ``(active, active)`` of sizes given their scales."""
        active, sd = self._active()
        root = sd[:, None] * np.linalg.inv(np.linalg.cholesky(self._inner(active, sd))).T
        return root @ (root.T @ self.scaled_scores[active]), root, active

    def _residual_power(self, active: Index, size: Array) -> float:
        """Return the power of the residual for given sizes."""
        power = self.power - 2.0 * size @ self.scores[active]
        power += size @ self.gram[active[:, None], active] @ size
        return max(float(power), _LEAST * self.power)


def _categorical(log_weights: Array, rng: np.random.Generator) -> int:
    weights = np.cumsum(np.exp(log_weights - log_weights.max()))
    return int(np.searchsorted(weights, rng.uniform() * weights[-1]))
