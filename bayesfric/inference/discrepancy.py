r"""Model discrepancy: errors of reported numbers because the model is not exactly right.

A posterior assumes the model; its intervals may then miss parameters that an unmodelled torque
biases (Brynjarsdóttir and O'Hagan, Inverse Problems 30 (2014) 114007). Candidates of what is
missing (:mod:`bayesfric.diagnostics.candidates`) are marginalised. A column :math:`z` of size
:math:`\gamma` moves the estimate by :math:`-B\gamma` with :math:`B = (X'X + P)^{-1} X'z`, of
whitened derivatives :math:`X` and the prior's information :math:`P`.

The error depends on the measurand (:data:`Quantity.measurand`):

- a *constant* (inertia, first moment, spring, gain) has a physical value, and :math:`B\gamma` is
its error;
- *friction* is the law that the same model would be fitted to on similar motions, which a missing
effect moves, too. Only the difference counts, :math:`(B_w - B)\gamma` with :math:`B_w` of smoothly
reweighted outputs, as another motion weighs speeds, positions and times otherwise. An effect that
is significant and no function of speed biases friction in full.

The mean of the moves is applied with a random sign, as the column may be a collinear one. If
nothing is likely to be missing, the residual is reweighted in the same way, and its scatter beyond
the posterior's is added (a smooth Bayesian bootstrap; Rubin, Annals of Statistics 9 (1981)
130-134).

Sizes have a horseshoe prior. Each kind of candidate has one of its shapes, a few columns, and a
size of unknown scale, half Cauchy around one scale for all kinds, so that most are nothing and one
may be large rather than several collinear ones (Carvalho, Polson and Scott, "The horseshoe
estimator for sparse signals", Biometrika 97 (2010) 465-480). Given the scales, sizes are normal and
integrated out; scales and shapes are on a grid and drawn by Gibbs sampling from one Gram matrix.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dtrtri
from scipy.special import expit, logsumexp
from scipy.stats import chi2, rankdata

from bayesfric.inference.closed_loop import ClosedLoopLikelihood
from bayesfric.inference.likelihood import TorqueLikelihood
from bayesfric.inference.posterior import Posterior
from bayesfric.inference.target import Likelihood, Target
from bayesfric.recordings.arrays import Array, Flags
from bayesfric.recordings.signals import Signals

Index = NDArray[np.intp]

# Scales that a candidate's size may have, over the torque's rms.
_SCALES = np.geomspace(3e-5, 0.5, 24)
# Prior probability that something is missing; if the posterior one is less, intervals are not
# widened.
_CHANCE = 0.1
# Reweightings; their width was compared in ``studies/replication``.
_REWEIGHTINGS = 40


@dataclass(frozen=True, eq=False)
class Missing:
    """Candidates of what the model lacks, as regression columns."""

    observations: tuple[Signals, ...]  # the recordings or subsamples
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
    biases_friction: Flags


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """Moves of the free parameters, in the target's unbounded coordinates."""

    # probability that a candidate is missing; 0 if the recording contradicts it
    chance: float
    deviations: Array  # (n, k) draws of the moves less their mean
    mean: Array  # (k,) applied with a random sign
    covariance: Array  # (k, k) of the posterior

    @property
    def is_plausible(self) -> bool:
        """Whether intervals allow for a missing effect."""
        return self.chance > 0.0

    @property
    def moved(self) -> float:
        """Share of draws that are moved: all by the residual if no candidate is missing."""
        return self.chance if self.is_plausible else float(self.deviations.any())

    def moves(self, rows: Index, sides: Array) -> Array:
        """Compute moves ``(n, k)`` from rows of ``deviations`` and normal ``sides`` ``(n, 1)``."""
        return np.asarray(self.deviations[rows] + sides * self.mean)

    def widened(self, target: Target, parameters: Array, rng: np.random.Generator) -> Array:
        """Move draws ``(n, d)`` of the posterior by the model discrepancy."""
        widened = parameters.copy()
        if not self.moved:
            return widened
        v, k = target.unbounded(parameters), len(self.mean)

        def move(drawn: Index) -> Array:
            moved = v[drawn]
            picked = rng.integers(len(self.deviations), size=drawn.size)
            moved[:, :k] += self.moves(picked, rng.standard_normal((drawn.size, 1)))
            return target.from_unbounded(moved)

        rows = np.flatnonzero(rng.uniform(size=len(v)) < self.moved)
        move_within_support(widened, rows, move, rng)
        return widened


def move_within_support(
    widened: Array, rows: Index, move: Callable[[Index], Array], rng: np.random.Generator
) -> None:
    """Put moved draws into ``rows`` of ``widened``; those that leave the support are drawn again.

    ``move`` gives moved parameters of the chosen draws, not finite outside the support.
    """
    drawn = rows
    for _ in range(12):
        moved = move(drawn)
        possible = np.isfinite(moved).all(axis=1)
        widened[rows[possible]] = moved[possible]
        rows = rows[~possible]
        drawn = rng.integers(len(widened), size=rows.size)


def discrepancy(target: Target, posterior: Posterior, missing: Missing | None) -> Discrepancy:
    """Marginalise missing effects.

    Without candidates, as for simulated positions, and for unusable samples there are no moves.
    """
    k = len(target.free)
    if missing is None or posterior.diagnostics.status == "unusable":
        return Discrepancy(0.0, np.zeros((1, k)), np.zeros(k), np.eye(k))
    chance = chance_missing(missing)
    fit, rng = LinearisedFit(target, posterior, missing.observations), _stream(posterior)
    if chance < _CHANCE:
        return Discrepancy(0.0, fit.residual_moves(rng), np.zeros(k), fit.covariance)
    sizes = draw_sizes(missing, _stream(posterior, 1))
    moves = fit.moves(target.friction, missing, sizes, rng)
    mean = moves.mean(axis=0)
    return Discrepancy(chance, moves - mean, mean, fit.covariance)


def _stream(posterior: Posterior, *keys: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(posterior.seed, spawn_key=(13, *keys)))


class LinearisedFit:
    """The fit as a linear regression with unit noise, along the posterior's principal axes."""

    def __init__(
        self, target: Target, posterior: Posterior, observations: Sequence[Signals]
    ) -> None:
        """Linearise by central differences at the posterior's mean.

        Outputs of subsamples count for more accordingly.
        """
        k, full = len(target.free), target.likelihood
        v = target.unbounded(posterior.flat(4000))
        v = v[np.isfinite(v).all(axis=1)]
        # (k, k) coordinates of a unit step along each axis
        self.root = np.linalg.cholesky(np.atleast_2d(np.cov(v[:, :k].T)))
        self.covariance: Array = self.root @ self.root.T  # (k, k) of the posterior
        # the step is large: a kink's effect on a draw counts, not its slope
        steps, size = np.zeros((2 * k + 1, v.shape[1])), 0.3
        steps[:k, :k], steps[k : 2 * k, :k] = self.root.T, -self.root.T
        for _ in range(12):  # until no step leaves the support
            parameters = target.from_unbounded(v.mean(axis=0) + size * steps)
            if np.isfinite(parameters).all():
                break
            size *= 0.5
        scales = target.noise.scales(parameters[-1:, k:])[0]
        values = target.chain_values(parameters)
        self.motion = np.concatenate(
            [
                [o.stamps[at], o.qd[at], abs(o.qd[at]), o.q[at], o.qdd[at]]
                for o, at in zip(observations, _places(full, observations), strict=True)
            ],
            axis=1,
        )
        self.whitened: Callable[[Sequence[Array]], Array]
        if isinstance(full, ClosedLoopLikelihood):  # prediction errors over their sds are white
            white = [e / np.sqrt(s) for e, s in full.errors(values, scales)]
            errors = np.concatenate(white, axis=1)
            self.whitened = lambda outputs: np.concatenate(outputs, axis=-1).T
            self.rows = (errors[k : 2 * k] - errors[:k]).T / (2.0 * size)
            self.residual, self.sizes = errors[-1], full.sizes
            self.prior = _raised_eigenvalues(np.eye(k) - self.rows.T @ self.rows, 0.0)
            return
        assert isinstance(full, TorqueLikelihood)
        likelihood = TorqueLikelihood(full.chain, observations, full.noise)
        shares = likelihood.sizes / full.sizes
        self.sizes = likelihood.sizes

        def whitened(part: TorqueLikelihood, outputs: Sequence[Array], shares: Array) -> Array:
            # of each recording (., M), over the root of its subsample's share
            innovations = part.innovations(outputs, scales)
            weighted = [x / np.sqrt(share) for x, share in zip(innovations, shares, strict=True)]
            return np.concatenate(weighted, axis=-1).T

        def slopes(predicted: Sequence[Array]) -> list[Array]:
            return [(p[:k] - p[k : 2 * k]) / (2.0 * size) for p in predicted]

        predicted = likelihood.predict(values)
        residuals = [o.measured - p[-1] for o, p in zip(observations, predicted, strict=True)]
        self.whitened = partial(whitened, likelihood, shares=shares)
        # (n, k) change of whitened outputs for a unit step, and whitened residual (n,)
        self.rows, self.residual = self.whitened(slopes(predicted)), self.whitened(residuals)
        full_rows = self.rows
        if (shares < 1.0).any():
            full_rows = whitened(full, slopes(full.predict(values)), np.ones(len(shares)))
        # (k, k) information beyond the likelihood's
        self.prior = _raised_eigenvalues(np.eye(k) - full_rows.T @ full_rows, 0.0)

    def estimator(self, weights: Array | float = 1.0) -> Array:
        """Return the estimate's change ``(k, n)`` per unit change of each weighted output."""
        weighted = (self.rows.T * weights).T
        # a subsample or reweighting has at least a twentieth of the full information
        information = _raised_eigenvalues(weighted.T @ self.rows + self.prior, 0.05)
        return np.asarray(self.root @ np.linalg.solve(information, weighted.T))

    def reweighted(self, rng: np.random.Generator) -> Iterator[Array]:
        """Yield estimators under smooth log-normal weights of mean one and unit log variance.

        The log weight is a quadratic of the ranks of time, speed, its size, position and
        acceleration, which similar motions vary.
        """
        ranks = np.array([rankdata(x) - 0.5 * (len(x) + 1) for x in self.motion])
        ranks /= np.maximum(ranks.std(axis=1, keepdims=True), 1e-300)
        features = np.concatenate([ranks, (ranks**2 - 1.0) / 0.9])
        for _ in range(_REWEIGHTINGS):
            weights = np.exp(rng.standard_normal(len(features)) @ features / len(features) ** 0.5)
            yield self.estimator(weights / weights.mean())

    def moves(
        self, friction: Flags, missing: Missing, sizes: Array, rng: np.random.Generator
    ) -> Array:
        """Compute moves ``(n, k)`` by candidates of sizes ``(n, m)``.

        ``friction`` ``(k,)`` flags coordinates of the friction law.
        """
        ends = np.cumsum(self.sizes)[:-1]
        columns = self.whitened([part.T for part in np.split(missing.columns, ends)])
        moves = -sizes @ (self.estimator() @ columns).T
        law = sizes * ~missing.biases_friction
        for first, estimator in enumerate(self.reweighted(rng)):
            draws = np.arange(first, len(sizes), _REWEIGHTINGS)
            moves[np.ix_(draws, friction)] += law[draws] @ (estimator[friction] @ columns).T
        return np.asarray(moves)

    def residual_moves(self, rng: np.random.Generator) -> Array:
        """Compute moves ``(n, k)`` by the reweighted residual, beyond the posterior's scatter.

        Coordinates that scatter no more than those of 95 % of right models have none: the ten
        features of the weights are as many directions (measured on 200 benches: 1.97).
        """
        plain = self.estimator() @ self.residual
        moves = np.array([estimator @ self.residual - plain for estimator in self.reweighted(rng)])
        ratio = np.mean(moves**2, axis=0) / np.diag(self.covariance)
        excess = np.sqrt(1.0 - 1.0 / np.maximum(ratio, 1.0))
        excess *= ratio > float(chi2.ppf(0.95, 10)) / 10.0
        return np.asarray(np.concatenate([moves, -moves]) * excess)


def _places(likelihood: Likelihood, observations: Sequence[Signals]) -> Sequence[Index]:
    """Return the samples of each recording to which its outputs belong."""
    if isinstance(likelihood, ClosedLoopLikelihood):
        return [np.flatnonzero(used) for used in likelihood.used]
    return [o.filter.centres for o in observations]


def _raised_eigenvalues(information: Array, least: float) -> Array:
    """Raise the eigenvalues of a symmetric matrix to a minimum."""
    power, axes = np.linalg.eigh(information)
    return np.asarray((axes * np.maximum(power, least)) @ axes.T)


def chance_missing(missing: Missing) -> float:
    """Return the probability that any candidate is present, each tested separately.

    The Bayes factor of a candidate of standard deviation ``s`` is that of a linear regression with
    a normal size, the noise's variance integrated out, averaged over ``s``, shapes and kinds. Prior
    odds are 1 to 9.
    """
    if not missing.kinds:
        return 0.0
    variance, size = missing.power / missing.free, _SCALES[:, None] ** 2
    scores, kind_factors = missing.scores / missing.spread, []
    for shapes in missing.kinds.values():
        log_factors = []
        for columns in shapes:
            power, vectors = np.linalg.eigh(missing.gram[np.ix_(columns, columns)])
            rotated = vectors.T @ scores[list(columns)]
            total = variance + size * np.clip(power, 0.0, None)
            gain = (rotated**2 * size / total).sum(axis=1) / missing.power
            log_gain = -0.5 * missing.free * np.log(np.maximum(1.0 - gain, 1e-12))
            log_factors.append(log_gain - 0.5 * np.log(total / variance).sum(axis=1))
        kind_factors.append(float(logsumexp(log_factors)) - math.log(np.size(log_factors)))
    factor = float(logsumexp(kind_factors)) - math.log(len(kind_factors))
    return float(expit(factor + math.log(_CHANCE / (1.0 - _CHANCE))))


def draw_sizes(
    missing: Missing,
    rng: np.random.Generator,
    *,
    typical: float = 0.003,
    sweeps: int = 300,
    burn: int = 100,
    draws: int = 20,
) -> Array:
    """Draw sizes ``(n, m)`` of all candidates by Gibbs sampling, ``draws`` in each sweep.

    ``typical`` is the scale of the half-Cauchy prior of the common scale.
    """
    ratio = _SCALES[:, None] / _SCALES
    log_prior = np.log(ratio) - np.log1p(ratio**2)  # half Cauchy in the logarithm
    log_prior -= logsumexp(log_prior, axis=0)  # (scale, common scale)
    x = _SCALES / typical
    common_prior, common = np.log(x / (1.0 + x * x)), 0
    state, kinds = _Candidates(missing), range(len(missing.kinds))
    # several kinds may sum to one, and no step leads back: the best are included first
    for _ in range(4):
        posteriors = [state.log_evidence(g) + log_prior[:, common] for g in kinds]
        best = int(np.argmax([log.max() - log[:, 0].max() for log in posteriors]))
        state.select(best, int(np.argmax(posteriors[best])))
        mean, _, active = state.sizes()
        state.variance = state.residual_power(active, mean) / missing.free
    sizes = np.zeros((sweeps, draws, missing.scores.size + 1))
    for sweep in sizes:
        for g in kinds:
            state.select(g, _categorical(state.log_evidence(g) + log_prior[:, common], rng))
        common = _categorical(common_prior + log_prior[state.scale].sum(axis=0), rng)
        mean, root, active = state.sizes()
        drawn = mean[:, None] + root @ rng.standard_normal((active.size, draws))
        power = state.residual_power(active, drawn[:, 0])
        state.variance = power / float(rng.chisquare(missing.free))
        sweep[:, active] = drawn.T
    return sizes[burn:, :, :-1].reshape(-1, missing.scores.size)


class _Candidates:
    """Shape and scale of each kind, and the noise variance; sizes are integrated out.

    Columns only approximate the true effect, by an error of 20 % that is normal like the noise;
    otherwise nearly collinear candidates cancel with huge coefficients.
    """

    def __init__(self, missing: Missing, column_error: float = 0.2) -> None:
        kinds, zero = missing.kinds.values(), missing.scores.size
        self.gram, self.scores = np.pad(missing.gram, (0, 1)), np.pad(missing.scores, (0, 1))
        errors = column_error**2 * np.pad(missing.column_errors, (0, 1))
        self.rough_gram, self.power = self.gram + np.diag(errors), missing.power
        width = max(len(shape) for shapes in kinds for shape in shapes)
        # (shapes, width) indices of columns, padded by a column of zeros
        padded = [np.array([s + (zero,) * (width - len(s)) for s in shapes]) for shapes in kinds]
        self.shapes, self.widths = padded, [max(map(len, shapes)) for shapes in kinds]
        self.included = np.array([shapes[0] for shapes in padded])
        self.scale = np.zeros(len(padded), dtype=np.intp)
        self.variance = missing.power / missing.free

    def select(self, g: int, place: int) -> None:
        """Give kind ``g`` a shape and a scale, by their index in its log evidence."""
        shape, self.scale[g] = divmod(place, _SCALES.size)
        self.included[g] = self.shapes[g][shape]

    def log_evidence(self, g: int) -> Array:
        """Log evidence ``(shapes, scales)`` of kind ``g``, given all others."""
        active, sd, root = self._active(1e-4 * self.variance, g)
        shapes = self.shapes[g][:, : self.widths[g]]
        gram = self.rough_gram[shapes[:, :, None], shapes[:, None, :]]
        scores = self.scores[shapes]
        if active.size:  # project the others out
            root = root * sd
            cross = root @ self.rough_gram[active[:, None], shapes.ravel()]
            by_shape = cross.reshape(-1, *shapes.shape).transpose(1, 2, 0)  # (shapes, width, .)
            gram = gram - by_shape @ by_shape.transpose(0, 2, 1) / self.variance
            scores = scores - by_shape @ (root @ self.scores[active]) / self.variance
        power, vectors = np.linalg.eigh(gram)
        rotated = (vectors.transpose(0, 2, 1) @ scores[:, :, None])[:, :, 0] / self.variance
        size = _SCALES[:, None] ** 2
        total = 1.0 + size * np.clip(power, 0.0, None)[:, None, :] / self.variance
        log = size * rotated[:, None, :] ** 2 / total - np.log(total)
        return np.asarray(0.5 * log.sum(axis=2))

    def sizes(self) -> tuple[Array, Array, Index]:
        """Return mean ``(active,)`` and root ``(active, active)`` of sizes given their scales."""
        active, sd, root = self._active(0.0)
        root = sd[:, None] * root.T
        return root @ (root.T @ self.scores[active]) / self.variance, root, active

    def residual_power(self, active: Index, size: Array) -> float:
        """Return the power of the residual for given sizes."""
        power = self.power - 2.0 * size @ self.scores[active]
        power += size @ self.gram[active[:, None], active] @ size
        return max(float(power), 1e-4 * self.power)

    def _active(self, least: float, other_than: int = -1) -> tuple[Index, Array, Array]:
        """Return included columns ``(active,)`` of at least some power, their sds and their root.

        The root is the inverse of a Cholesky factor of their sizes' precision over these sds.
        """
        kinds, width = self.included.shape
        sd = np.repeat(_SCALES[self.scale, None], width, axis=1)
        powerful = sd**2 * np.diagonal(self.rough_gram)[self.included] > least
        powerful &= (np.arange(kinds) != other_than)[:, None]
        active, sd = self.included[powerful], sd[powerful]
        scaled = sd[:, None] * self.rough_gram[active[:, None], active] * sd / self.variance
        if not active.size:  # which LAPACK refuses
            return active, sd, scaled
        # a quarter of the time of numpy's
        factor, _ = dpotrf(scaled + np.eye(active.size), lower=1)
        return active, sd, dtrtri(factor, lower=1)[0]


def _categorical(log_weights: Array, rng: np.random.Generator) -> int:
    weights = np.cumsum(np.exp(log_weights - log_weights.max()))
    return int(np.searchsorted(weights, rng.uniform() * weights[-1]))
