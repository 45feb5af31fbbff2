"""Outputs and columns after noise is made white, and all that moment matrices say of them.

The noise is told from what is left when everything that any candidate could take is taken: a
memory then cannot take what a term explains. Where that leaves next to nothing, as of few outputs,
it would be a noise beside which any term is sure; then it is what the model with the few terms that
most joints have leaves, which is too much where another is missing: fewer are found, none too many.
One noise serves all models, so that their scores compare.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bayesfric.inference.likelihood import autoregression as ar
from bayesfric.inference.moments.residual_moments import follows
from bayesfric.recordings.observation import Observation

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# Most predecessors that noise remembers here.
_ORDER = 4
# Outputs beside a fold that are not fitted while it is predicted.
_GAP = 6
# Pieces of time between which scores are taken to be independent.
_PIECES = 40
# Outputs beyond what all terms together could take, or these tell no noise: its sd within a sixth.
_FREE = 20
# Fewer outputs are no fold.
_LEAST = 20
# What only a fold itself tells cannot be predicted from the others: there it stays where the model
# as it is has it, who counts this much. A term that one fold alone tells then predicts nothing.
_ANCHOR = 0.01
# Singular values below this share of the largest are rounding.
_OPEN = 1e-5
# A term that is missing is taken to have this share of the torque, in root mean square.
_SHARE = 0.1
# With fewer kinds of motion, stretches of time are left out instead.
_FEW, _EIGHTHS = 4, 8
STRETCHES = tuple(f"eighth {k} of the time" for k in range(1, _EIGHTHS + 1))
# Recordings from which on whole ones are left out.
_RECORDINGS = 4


@dataclass(frozen=True, eq=False)
class Columns:
    """All columns beside each other, whitened: base first, then candidates, the target last."""

    white: Array  # (n, k + 1)
    raw: Array  # (n, k + 1) before whitening, in N m or N
    torque: float  # rms of the torque, N m or N
    variance: float  # of the white noise
    memory: Array  # (p,) partial autocorrelations of the noise that was made white
    folds: Index  # (n,) number of the fold of each output
    fold_names: tuple[str, ...]
    pieces: Index  # (n,) number of the piece of time
    base: int  # columns of the model as it is, the first ones

    @cached_property
    def whole(self) -> Array:
        """Moments of everything."""
        return self.white.T @ self.white

    @cached_property
    def of_folds(self) -> list[tuple[Array, Array, Array, int]]:
        """Each fold's moments, white and raw, those of all it may be predicted from, and size."""
        out = []
        for fold in range(len(self.fold_names)):
            inside = self.folds == fold
            near = np.convolve(inside, np.ones(2 * _GAP + 1), mode="same") > 0.0
            rows, beside, raw = self.white[inside], self.white[near], self.raw[inside]
            left = self.whole - beside.T @ beside
            out.append((rows.T @ rows, raw.T @ raw, left, int(inside.sum())))
        return out

    @cached_property
    def of_pieces(self) -> Array:
        """Moments of every piece of time, ``(pieces, k + 1, k + 1)``."""
        numbers = np.unique(self.pieces)
        parts = [self.white[self.pieces == number] for number in numbers]
        return np.stack([part.T @ part for part in parts])


def prepared(
    base: Array,
    others: Array,
    target: Array,
    observations: Sequence[Observation],
    usual: NDArray[np.bool_],
) -> Columns:
    """Whiten ``base`` ``(n, d)``, ``others`` ``(n, m)`` and ``target`` ``(n,)`` by one noise.

    ``usual`` ``(m,)``: those of ``others`` that most joints have.
    """
    raw = np.column_stack([_basis(base), _unit(others), target])
    ends = np.cumsum([o.measured.size for o in observations])[:-1]
    runs = [follows(o) for o in observations]
    first = raw.shape[1] - 1 - others.shape[1]
    taking = np.arange(raw.shape[1] - 1)
    for fewer in (np.append(taking[:first], first + np.flatnonzero(usual)), taking[:first]):
        if target.size - _basis(raw[:, taking]).shape[1] < _FREE:
            taking = fewer
    whole = _basis(raw[:, taking])
    left = target - whole @ (whole.T @ target)
    memory = _memory(np.split(left, ends), runs, target.size)
    white = np.concatenate(
        [
            ar.whitened(part.T, memory, f).T
            for part, f in zip(np.split(raw, ends), runs, strict=True)
        ]
    )
    basis = _basis(white[:, taking])
    rest = white[:, -1] - basis @ (basis.T @ white[:, -1])
    variance = float(rest @ rest) / max(target.size - basis.shape[1], 1)
    folds, names = _folds(observations)
    each = max(_PIECES // len(observations), 2)
    pieces = np.concatenate(
        [
            k * each + np.arange(o.measured.size) * each // max(o.measured.size, 1)
            for k, o in enumerate(observations)
        ]
    )
    torque = np.concatenate([o.measured for o in observations])
    rms = float(np.sqrt(np.mean(torque**2)))
    return Columns(white, raw, rms, variance, memory, folds, names, pieces, first)


def _basis(matrix: Array) -> Array:
    """Orthonormal basis of what columns span.

    From the moments: a singular value decomposition takes twenty times as long, and what is lost
    is far below what counts as open.
    """
    unit = _unit(matrix)
    values, vectors = np.linalg.eigh(unit.T @ unit)
    told = values > _OPEN**2 * values.max(initial=0.0)
    return np.asarray(unit @ (vectors[:, told] / np.sqrt(values[told])))


def _unit(matrix: Array) -> Array:
    """Columns in root mean squares of one."""
    size = np.sqrt(np.mean(matrix**2, axis=0))
    return np.asarray(matrix / np.where(size > 0.0, size, 1.0))


def _memory(left: Sequence[Array], runs: Sequence[NDArray[np.bool_]], n: int) -> Array:
    """Choose the memory of what is left by the Bayesian information criterion."""
    best, found = math.inf, np.zeros(0)
    for order in range(min(_ORDER, n // 50) + 1):
        partial = ar.burg(left, runs, order)
        inner = [ar.whitened(x, partial, f) for x, f in zip(left, runs, strict=True)]
        power = sum(float(x @ x) for x in inner)
        bic = n * math.log(max(power, 1e-300) / n) + order * math.log(n)
        if bic < best:
            best, found = bic, partial
    return found


def _folds(observations: Sequence[Observation]) -> tuple[Index, tuple[str, ...]]:
    """Divide outputs into what is left out at a time, and name it.

    Whole recordings where there are several, else kinds of motion: each way, at thirds of speed,
    speeding up and braking; or stretches of time where there are hardly any.
    """
    sizes = [o.measured.size for o in observations]
    if len(observations) >= _RECORDINGS:
        return np.repeat(np.arange(len(sizes)), sizes), tuple(o.name for o in observations)
    qd = np.concatenate([o.qd[o.filter.centres] for o in observations])
    qdd = np.concatenate([o.acceleration for o in observations])
    speed = np.abs(qd)
    third = np.searchsorted(np.quantile(speed, [1.0 / 3.0, 2.0 / 3.0]), speed)
    number = 6 * (qd < 0.0) + 2 * third + (qd * qdd < 0.0)
    words = [
        f"{way}, {how}, {what}"
        for way in ("forwards", "backwards")
        for how in ("slow", "medium", "fast")
        for what in ("speeding up", "braking")
    ]
    counts = np.bincount(number, minlength=len(words))
    kept = np.flatnonzero(counts >= _LEAST)
    if kept.size < _FEW:
        return np.arange(qd.size) * _EIGHTHS // qd.size, STRETCHES
    place = np.full(len(words), -1)
    place[kept] = np.arange(kept.size)
    return place[number], tuple(words[k] for k in kept)


@dataclass(frozen=True, eq=False)
class Score:
    """How well a set of columns predicts motion that it was not fitted to."""

    rms: float  # of what is left of all outputs when fitted to all, N m or N
    held_out: float  # of what is left of folds that were not fitted, N m or N
    held_out_error: float  # standard error of that over the folds
    folds: Array  # (K,) log density of every fold, but for a constant that all models share


def score(columns: Columns, chosen: Sequence[int]) -> Score:
    """Fit the columns of these numbers ``(c,)`` to all, and to all but each fold."""
    at = np.array(chosen, dtype=np.int64)
    y = columns.white.shape[1] - 1
    fitted = _solved(columns.whole[np.ix_(at, at)], columns.whole[at, y])
    left = columns.raw[:, y] - columns.raw[:, at] @ fitted
    density, power, outputs = [], [], 0
    whole = columns.whole[np.ix_(at, at)]
    plain = np.arange(columns.base)
    without = _solved(columns.whole[np.ix_(plain, plain)], columns.whole[plain, y])
    anchor = _ANCHOR * (columns.whole[np.ix_(at, plain)] @ without)
    for white, raw, rest, size in columns.of_folds:
        moments = rest[np.ix_(at, at)] + _ANCHOR * whole
        there = _solved(moments, rest[at, y] + anchor)
        density.append(-0.5 * _power(white, at, y, there) / columns.variance)
        power.append(_power(raw, at, y, there))
        outputs += size
    held_out = math.sqrt(sum(power) / max(outputs, 1))
    error = math.sqrt(len(power)) * float(np.std(power, ddof=1)) / max(outputs, 1)
    return Score(
        float(np.sqrt(np.mean(left**2))),
        held_out,
        error / (2.0 * held_out) if held_out > 0.0 else 0.0,
        np.array(density),
    )


def _solved(moments: Array, target: Array) -> Array:
    size = np.sqrt(np.diag(moments))
    size[size == 0.0] = 1.0
    values, vectors = np.linalg.eigh(moments / np.outer(size, size))
    told = values > _OPEN**2 * values.max(initial=0.0)
    inverse = vectors[:, told] / values[told]
    return np.asarray(inverse @ (vectors[:, told].T @ (target / size)) / size)


def _power(moments: Array, at: Index, y: int, values: Array) -> float:
    """Sum of squares that values leave."""
    left = moments[y, y] - 2.0 * values @ moments[at, y] + values @ moments[np.ix_(at, at)] @ values
    return max(float(left), 0.0)


@dataclass(frozen=True, eq=False)
class Gain:
    """What one candidate brings beside a model."""

    evidence: float  # logarithm of the Bayes factor, see gain
    plain: float  # the same as if the noise were as white between pieces of time as within
    dimensions: int  # that it adds to what the model can do; zero where it adds none
    direction: Array  # (n,) unit vector of what it takes, whitened


def gain(columns: Columns, chosen: Sequence[int], own: Sequence[int], sign: int) -> Gain:
    """Weigh a candidate's columns ``own`` beside those ``chosen``, in closed form.

    The coefficients' prior is normal and gives each column a tenth of the torque, in root mean
    square; the model's own are flat. The noise is at least as large as its scatter between pieces
    of time says, which need not be as uncorrelated as within.
    """
    at, mine = np.array(chosen, dtype=np.int64), np.array(own, dtype=np.int64)
    y = columns.white.shape[1] - 1
    scale = _SHARE * columns.torque
    beside = np.append(mine, y)
    taken = columns.whole[np.ix_(at, beside)]
    through = np.stack([_solved(columns.whole[np.ix_(at, at)], t) for t in taken.T], axis=1)
    # what the model cannot do of the candidate, and of the target
    inner = columns.whole[np.ix_(beside, beside)] - taken.T @ through
    k = mine.size
    size = np.diag(columns.whole)[mine]
    values, vectors = np.linalg.eigh(inner[:k, :k])
    told = values > _OPEN * size.max(initial=0.0)
    if not told.any():
        return Gain(-math.inf, -math.inf, 0, np.zeros(0))
    rotation, power = vectors[:, told], values[told]
    slope = rotation.T @ inner[:k, k]
    estimate = slope / power
    # scores of every piece of time with the candidate fitted
    used = np.concatenate([at, beside])
    weights = np.concatenate([-through[:, :k] @ rotation, rotation, np.zeros((1, told.sum()))])
    rest = -through[:, k] + through[:, :k] @ (rotation @ estimate)
    left = np.concatenate([rest, -rotation @ estimate, [1.0]])
    scores = (columns.of_pieces[:, used[:, None], used] @ left) @ weights
    rough = (scores**2).sum(axis=0) / power
    pieces = len(scores)
    noise = np.maximum(rough * pieces / max(pieces - at.size, 1), columns.variance)
    t = 0.0
    if sign and told.sum() == 1 and k == 1:
        t = float(estimate[0] * rotation[0, 0] * sign)
    found = []
    for size_of in (noise, np.full_like(noise, columns.variance)):
        precision = scale**2 * power / size_of
        log_factor = 0.5 * slope**2 / power / size_of * precision / (1.0 + precision)
        evidence = float(np.sum(log_factor - 0.5 * np.log1p(precision)))
        if t:
            evidence += math.log(2.0) + float(stats.norm.logcdf(t * np.sqrt(power[0] / size_of[0])))
        found.append(evidence)
    direction = columns.white[:, used] @ (weights @ (estimate if k > 1 else np.ones(1)))
    return Gain(
        found[0], found[1], int(told.sum()), direction / max(np.linalg.norm(direction), 1e-300)
    )
