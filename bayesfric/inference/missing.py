r"""Which candidates are missing from a model, and how large: sizes by Gibbs sampling.

What else may explain the torque stands in a table of candidates
(:mod:`bayesfric.diagnostics.candidates`), each a few columns beside the model's own. Each kind of
candidate has one of its shapes and a size of unknown scale, half Cauchy around one scale for all
kinds, so that most are nothing and one may be large rather than several of the same size that look
like it [1]_; and with some probability none is there at all. Given the scales, sizes are normal and
integrated out; scales and shapes are on a grid and drawn by Gibbs sampling from one Gram matrix,
whatever the length of the recordings.

No column is quite the shape that it stands for. A size is normal, too, with the standard deviation
at which what its column is off by, a fifth of it, is as large as the noise. So candidates that this
motion hardly tells apart do not cancel each other in sizes that only exact shapes would need: else
a model that nothing on the list makes right has room for several times all its friction.

References
----------
.. [1] C. M. Carvalho, N. G. Polson, J. G. Scott, "The horseshoe estimator for sparse signals",
   Biometrika 97 (2010) 465-480.
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

# Scales of a candidate, as shares of the torque's rms: smallest, largest, and how many.
_SMALLEST, _LARGEST, _SCALES = 3e-5, 0.5, 24
# How far a column may be from the shape that it stands for, as a share of itself.
_ROUGH = 0.2
# Scale of the half-Cauchy of the scale that all others are around.
_TYPICAL = 0.003
# Chance that something is missing, before the recording is asked; where it is less afterwards, the
# recording speaks against it, and intervals stay the posterior's own.
CHANCE = 0.1
# Sweeps of the Gibbs sampler, and those left out; sizes drawn in each of the others; candidates
# that are taken in before.
_SWEEPS, _BURN, _EACH, _FIRST = 300, 100, 20, 4
# Share of the residual's power that is noise, at least.
_LEAST = 1e-4
# Variance of a candidate in that of its noise below which it does not matter to the others.
_IDLE = 1e-4


@dataclass(frozen=True, eq=False)
class Missing:
    """Candidates of what the model lacks, as regression columns."""

    observations: tuple[Observation, ...]  # The recordings that were asked, or excerpts of them
    # (M, m) of all their outputs, filtered as they are, N m or N; their largest value is the
    # torque's rms, or for friction what the model loses. A size of one is then as large as that
    columns: Array
    # Names of candidates, and of each the columns of every shape that it may have
    kinds: dict[str, tuple[tuple[int, ...], ...]]
    # (m, m), (m,) and a number: products of what is left of columns and residual beside the model's
    # own, whitened; scores of a right model are taken off
    gram: Array
    scores: Array
    rough: Array  # (m,) mean squares of columns, over the noise's in that of its innovations
    power: float
    spread: Array  # (m,) sd of a right model's scores, in those of white noise; at least one
    free: int  # Outputs beyond the model's own parameters
    # (m,) whether a column biases friction in full: those of candidates that were found and that
    # are no function of speed. What the others do to friction is part of its law
    biases_friction: NDArray[np.bool_]


def _grid() -> Array:
    """Give the scales ``(n,)`` that a candidate's size may have."""
    return np.geomspace(_SMALLEST, _LARGEST, _SCALES)


def chance_missing(missing: Missing) -> float:
    """Give the probability that any candidate is there, each by itself against none.

    Scores beyond what replicates show count in the replicates' own standard deviations.

    For a candidate of sd ``s`` the evidence against none is that of a linear regression with a
    normal size, the noise's variance integrated out, averaged over the grid of ``s``, over its
    shapes, and over kinds. Prior odds are 1 to 9.
    """
    variance = missing.power / missing.free
    scores = missing.scores / missing.spread
    grid, kinds = _grid(), []
    for shapes in missing.kinds.values():
        told = []
        for own in shapes:
            power, vectors = np.linalg.eigh(missing.gram[np.ix_(own, own)])
            turned = vectors.T @ scores[list(own)]
            size = grid[:, None] ** 2
            total = variance + size * np.clip(power, 0.0, None)
            gain = (turned**2 * size / total).sum(axis=1) / missing.power
            log_gain = -0.5 * missing.free * np.log(np.maximum(1.0 - gain, 1e-12))
            told.append(log_gain - 0.5 * np.log(total / variance).sum(axis=1))
        kinds.append(float(logsumexp(told)) - math.log(np.size(told)))
    if not kinds:
        return 0.0
    factor = float(logsumexp(kinds)) - math.log(len(kinds))
    odds: float = factor + math.log(CHANCE / (1.0 - CHANCE))
    return float(expit(odds))


@dataclass(frozen=True, eq=False)
class _Kind:
    """The shapes that one candidate may have; a column of zeros ends those of fewer columns."""

    shapes: Index  # (shapes, width), numbers of columns
    columns: Index  # of all shapes
    places: Index  # (shapes, width), where those stand among these

    @classmethod
    def of(cls, shapes: tuple[tuple[int, ...], ...], width: int, zero: int) -> _Kind:
        padded = np.array([own + (zero,) * (width - len(own)) for own in shapes])
        widest = padded[:, : max(map(len, shapes))]
        columns, places = np.unique(widest, return_inverse=True)
        return cls(padded, columns, places.reshape(widest.shape))


@njit(cache=True)
def _evidence(grid, told, pull, columns, places, active, sd):  # type: ignore[no-untyped-def]
    """Log evidence ``(shapes, scales)`` of a kind's shapes at each scale, beside what is taken.

    ``columns`` are the kind's, ``places`` ``(shapes, width)`` where each shape's stand among them;
    ``active`` is what is taken, of sds ``sd``.
    """
    m, a = columns.size, active.size
    precision, cross = np.empty((m, m + 1)), np.empty((a, m + 1))
    for i in range(m):
        precision[i, m] = pull[columns[i]]
        for j in range(m):
            precision[i, j] = told[columns[i], columns[j]]
    if a:
        inner = np.empty((a, a))
        for i in range(a):
            cross[i, m] = sd[i] * pull[active[i]]
            for j in range(m):
                cross[i, j] = sd[i] * told[active[i], columns[j]]
            for j in range(a):
                inner[i, j] = sd[i] * told[active[i], active[j]] * sd[j]
            inner[i, i] += 1.0
        precision -= np.ascontiguousarray(cross[:, :m].T) @ np.linalg.solve(inner, cross)
    shapes, width = places.shape
    out, own = np.zeros((shapes, grid.size)), np.empty((width, width))
    for s in range(shapes):
        for i in range(width):
            for j in range(width):
                own[i, j] = precision[places[s, i], places[s, j]]
        power, vectors = np.linalg.eigh(own)
        for i in range(width):
            turned = 0.0
            for j in range(width):
                turned += vectors[j, i] * precision[places[s, j], m]
            for k in range(grid.size):
                size = grid[k] ** 2
                total = 1.0 + size * max(power[i], 0.0)
                out[s, k] += 0.5 * (size * turned**2 / total - math.log(total))
    return out


class Sizes:
    """Gibbs sampler of candidates' shapes and scales; sizes are integrated out."""

    def __init__(self, missing: Missing) -> None:
        zero, shapes = missing.scores.size, missing.kinds.values()
        self.grid = _grid()
        width = max(len(own) for each in shapes for own in each)
        self.gram, self.scores = np.pad(missing.gram, (0, 1)), np.pad(missing.scores, (0, 1))
        self.seen = self.gram + _ROUGH**2 * np.diag(np.pad(missing.rough, (0, 1)))
        self.power, self.free = missing.power, missing.free
        self.kinds = [_Kind.of(each, width, zero) for each in shapes]
        self.taken = np.array([kind.shapes[0] for kind in self.kinds])
        self.scale = np.zeros(len(self.kinds), dtype=np.intp)
        self._heard(missing.power / missing.free)

    def _heard(self, variance: float) -> None:
        """Take the noise to be so large."""
        self.variance, self.told, self.pull = variance, self.seen / variance, self.scores / variance

    def drawn(self, rng: np.random.Generator) -> Array:
        """Draw sizes of all candidates together.

        Shapes: returns (n, m).
        """
        grid = self.grid
        ratio = grid[:, None] / grid
        around = np.log(ratio) - np.log1p(ratio**2)  # half Cauchy, a logarithm's
        around -= logsumexp(around, axis=0)  # (scale, typical scale)
        x = grid / _TYPICAL
        prior, typical = np.log(x / (1.0 + x * x)), 0
        # several kinds together may look like one, and no step leads back: the best goes first
        for _ in range(_FIRST):
            asked = [self._asked(g) + around[:, typical] for g in range(len(self.kinds))]
            best = int(np.argmax([one.max() - one[:, 0].max() for one in asked]))
            self._take(best, int(np.argmax(asked[best])))
            mean, _, active = self._given()
            self._heard(self._rest(active, mean) / self.free)
        sizes = np.zeros((_SWEEPS, _EACH, self.scores.size))
        for sweep in sizes:
            for g in range(len(self.kinds)):
                self._take(g, _drawn((self._asked(g) + around[:, typical]).ravel(), rng))
            typical = _drawn(prior + around[self.scale].sum(axis=0), rng)
            mean, root, active = self._given()
            drawn = mean[:, None] + root @ rng.standard_normal((active.size, _EACH))
            self._heard(self._rest(active, drawn[:, 0]) / float(rng.chisquare(self.free)))
            sweep[:, active] = drawn.T
        return sizes[_BURN:, :, :-1].reshape(-1, self.scores.size - 1)

    def _take(self, g: int, place: int) -> None:
        shape, self.scale[g] = divmod(place, self.grid.size)
        self.taken[g] = self.kinds[g].shapes[shape]

    def _asked(self, g: int) -> Array:
        """Give the log evidence of a kind's shapes at each scale, beside all the others."""
        kind, (active, sd) = self.kinds[g], self._active(without=g)
        own = kind.columns, kind.places
        return np.asarray(_evidence(self.grid, self.told, self.pull, *own, active, sd))

    def _active(self, without: int | None = None) -> tuple[Index, Array]:
        """Give the numbers of columns that are taken, and their sds; those that matter to one."""
        sd = np.repeat(self.grid[self.scale], self.taken.shape[1]).reshape(self.taken.shape)
        power = sd**2 * np.diagonal(self.told)[self.taken]
        if without is None:
            return self.taken[power > 0.0], sd[power > 0.0]
        power[without] = 0.0
        matter = power > _IDLE
        return self.taken[matter], sd[matter]

    def _inner(self, active: Index, sd: Array) -> Array:
        """Give the precision of sizes over their sds, ``(active, active)``."""
        inner = sd[:, None] * self.told[active[:, None], active] * sd
        inner[np.diag_indices(active.size)] += 1.0
        return np.asarray(inner)

    def _given(self) -> tuple[Array, Array, Index]:
        """Give mean ``(active,)`` and root ``(active, active)`` of sizes given their scales."""
        active, sd = self._active()
        root = sd[:, None] * np.linalg.inv(np.linalg.cholesky(self._inner(active, sd))).T
        return root @ (root.T @ self.pull[active]), root, active

    def _rest(self, active: Index, size: Array) -> float:
        """Give the power that sizes leave of the residual."""
        left = self.power - 2.0 * size @ self.scores[active]
        left += size @ self.gram[active[:, None], active] @ size
        return max(float(left), _LEAST * self.power)


def _drawn(log_weights: Array, rng: np.random.Generator) -> int:
    weights = np.cumsum(np.exp(log_weights - log_weights.max()))
    return int(np.searchsorted(weights, rng.uniform() * weights[-1]))
