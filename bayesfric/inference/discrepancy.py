r"""Model discrepancy: errors of reported numbers because the model is not exactly right.

A posterior assumes the model; its intervals may then miss parameters that an unmodelled torque
biases (Brynjarsdóttir and O'Hagan, Inverse Problems 30 (2014) 114007). Candidates of what is
missing are marginalised, with sizes drawn by :mod:`bayesfric.inference.missing`. A column :math:`z`
of size :math:`\gamma` moves the estimate by :math:`-B\gamma` with :math:`B = (X'X + P)^{-1} X'z`,
of whitened derivatives :math:`X` and the prior's information :math:`P`.

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
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, rankdata

from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.missing import CHANCE, Missing, Sizes, chance_missing
from bayesfric.inference.posterior import Posterior
from bayesfric.inference.target import Target
from bayesfric.recordings.observation import Observation

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Draws for the covariance, and step of central differences in posterior standard deviations.
_DRAWS, _STEP = 4000, 0.3
# Halvings of a step that leaves the support, and redraws of moves that leave it.
_HALVINGS, _TRIES = 12, 12
# Least share of the full information that a subsample or reweighting has.
_LEAST = 0.05
# Reweightings; their width was compared in ``studies/replication``.
_REWEIGHTINGS = 40
# 95 % quantile of the residual moves' mean square over the posterior variance for right models: the
# ten features of the weights are as many directions. Measured on 200 benches: 1.97.
_CHANCE_SCATTER = float(chi2.ppf(0.95, 10)) / 10.0


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

    def moves(self, rows: NDArray[np.intp], sides: Array) -> Array:
        """Compute moves ``(n, k)`` from rows of ``deviations`` and normal ``sides`` ``(n, 1)``."""
        return np.asarray(self.deviations[rows] + sides * self.mean)

    def widened(self, target: Target, parameters: Array, rng: np.random.Generator) -> Array:
        """Move draws ``(n, d)`` of the posterior by the model discrepancy."""
        widened = parameters.copy()
        if not self.moved:
            return widened
        v, k = target.unbounded(parameters), len(self.mean)

        def move(drawn: NDArray[np.intp]) -> Array:
            moved = v[drawn]
            picked = rng.integers(len(self.deviations), size=drawn.size)
            moved[:, :k] += self.moves(picked, rng.standard_normal((drawn.size, 1)))
            return target.from_unbounded(moved)

        rows = np.flatnonzero(rng.uniform(size=len(v)) < self.moved)
        move_within_support(widened, rows, move, rng)
        return widened


def move_within_support(
    widened: Array,
    rows: NDArray[np.intp],
    move: Callable[[NDArray[np.intp]], Array],
    rng: np.random.Generator,
) -> None:
    """Put moved draws into ``rows`` of ``widened``; those that leave the support are drawn again.

    ``move`` gives moved parameters of the chosen draws, not finite outside the support.
    """
    drawn = rows
    for _ in range(_TRIES):
        moved = move(drawn)
        possible = np.isfinite(moved).all(axis=1)
        widened[rows[possible]] = moved[possible]
        rows = rows[~possible]
        drawn = rng.integers(len(widened), size=rows.size)


def discrepancy(target: Target, posterior: Posterior, missing: Missing | None) -> Discrepancy:
    """Marginalise missing effects.

    Without candidates, for positions and for unusable samples there are no moves.
    """
    k = len(target.free)
    is_torque = isinstance(target.likelihood, TorqueLikelihood)
    if missing is None or not is_torque or posterior.diagnostics.status == "unusable":
        return Discrepancy(0.0, np.zeros((1, k)), np.zeros(k), np.eye(k))
    chance = chance_missing(missing)
    fit, rng = _Linearised.of(target, posterior, missing.observations), _stream(posterior)
    if chance < CHANCE:
        return Discrepancy(0.0, fit.residual_moves(rng), np.zeros(k), fit.covariance)
    moves = fit.moves(target.friction, missing, Sizes(missing).drawn(_stream(posterior, 1)), rng)
    mean = moves.mean(axis=0)
    return Discrepancy(chance, moves - mean, mean, fit.covariance)


def _stream(posterior: Posterior, *more: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(posterior.seed, spawn_key=(13, *more)))


@dataclass(frozen=True, eq=False)
class _Linearised:
    """The fit as a linear regression with unit noise, along the posterior's principal axes."""

    likelihood: TorqueLikelihood
    scales: Array
    shares: Array  # (R,) of the outputs of each recording that a subsample has
    root: Array  # (k, k) coordinates of a unit step along each axis
    rows: Array  # (n, k) change of whitened outputs for such a step
    residual: Array  # (n,) whitened
    prior: Array  # (k, k) information beyond the likelihood's

    @classmethod
    def of(
        cls, target: Target, posterior: Posterior, observations: Sequence[Observation]
    ) -> _Linearised:
        """Linearise by central differences at the posterior's mean.

        Outputs of subsamples count for more accordingly.
        """
        k, full = len(target.free), target.likelihood
        assert isinstance(full, TorqueLikelihood)
        likelihood = TorqueLikelihood(full.chain, observations, full.noise)
        shares = likelihood.sizes / full.sizes
        v = target.unbounded(posterior.flat(_DRAWS))
        v = v[np.isfinite(v).all(axis=1)]
        root = np.linalg.cholesky(np.atleast_2d(np.cov(v[:, :k].T)))
        # the step is large: a kink's effect on a draw counts, not its slope
        steps, size = np.zeros((2 * k + 1, v.shape[1])), _STEP
        steps[:k, :k], steps[k : 2 * k, :k] = root.T, -root.T
        for _ in range(_HALVINGS):
            parameters = target.from_unbounded(v.mean(axis=0) + size * steps)
            if np.isfinite(parameters).all():
                break
            size *= 0.5
        scales = target.noise.scales(parameters[-1:, k:])[0]

        def linearised(part: TorqueLikelihood, shares: Array) -> tuple[Array, Array]:
            predicted = part.predict(target.chain_values(parameters))
            changes = [(p[:k] - p[k : 2 * k]) / (2.0 * size) for p in predicted]
            residuals = [o.measured - p[-1] for o, p in zip(part.outputs, predicted, strict=True)]
            return tuple(_whitened(part, x, scales, shares).T for x in (changes, residuals))  # type: ignore[return-value]

        rows, residual = linearised(likelihood, shares)
        full_rows = linearised(full, np.ones(len(shares)))[0] if (shares < 1.0).any() else rows
        prior = _raised_eigenvalues(np.eye(k) - full_rows.T @ full_rows, 0.0)
        return cls(likelihood, scales, shares, root, rows, residual, prior)

    @property
    def covariance(self) -> Array:
        """Covariance ``(k, k)`` of the posterior."""
        return np.asarray(self.root @ self.root.T)

    def estimator(self, weights: Array | float = 1.0) -> Array:
        """Return the estimate's change ``(k, n)`` per unit change of each weighted output."""
        weighted = (self.rows.T * weights).T
        information = _raised_eigenvalues(weighted.T @ self.rows + self.prior, _LEAST)
        return np.asarray(self.root @ np.linalg.solve(information, weighted.T))

    def reweighted(self, rng: np.random.Generator) -> Iterator[Array]:
        """Yield estimators under smooth log-normal weights of mean one and unit log variance.

        The log weight is a quadratic of the ranks of time, speed, its size, position and
        acceleration, which similar motions vary.
        """
        ranks = np.array([rankdata(x) - 0.5 * (len(x) + 1) for x in self._motion().T])
        ranks /= np.maximum(ranks.std(axis=1, keepdims=True), 1e-300)
        features = np.concatenate([ranks, (ranks**2 - 1.0) / 0.9])
        for _ in range(_REWEIGHTINGS):
            weights = np.exp(rng.standard_normal(len(features)) @ features / len(features) ** 0.5)
            yield self.estimator(weights / weights.mean())

    def _motion(self) -> Array:
        parts = []
        for o in self.likelihood.observations:
            at = o.filter.centres
            parts.append(np.stack([o.stamps[at], o.qd[at], abs(o.qd[at]), o.q[at], o.qdd[at]]))
        return np.concatenate(parts, axis=1).T

    def moves(
        self, friction: Flags, missing: Missing, sizes: Array, rng: np.random.Generator
    ) -> Array:
        """Compute moves ``(n, k)`` by candidates of sizes ``(n, m)``.

        ``friction`` ``(k,)`` flags coordinates of the friction law.
        """
        ends = np.cumsum([o.measured.size for o in self.likelihood.outputs])[:-1]
        parts = [part.T for part in np.split(missing.columns, ends)]
        columns = _whitened(self.likelihood, parts, self.scales, self.shares).T
        moves = -sizes @ (self.estimator() @ columns).T
        law = sizes * ~missing.biases_friction
        for first, estimator in enumerate(self.reweighted(rng)):
            draws = np.arange(first, len(sizes), _REWEIGHTINGS)
            law_moves = law[draws] @ (estimator[friction] @ columns).T
            moves[np.ix_(draws, friction)] += law_moves
        return np.asarray(moves)

    def residual_moves(self, rng: np.random.Generator) -> Array:
        """Compute moves ``(n, k)`` by the reweighted residual, beyond the posterior's scatter.

        Coordinates that scatter no more than those of 95 % of right models have none.
        """
        plain = self.estimator() @ self.residual
        moves = np.array([estimator @ self.residual - plain for estimator in self.reweighted(rng)])
        ratio = np.mean(moves**2, axis=0) / np.diag(self.covariance)
        excess = np.sqrt(1.0 - 1.0 / np.maximum(ratio, 1.0)) * (ratio > _CHANCE_SCATTER)
        return np.asarray(np.concatenate([moves, -moves]) * excess)


def _whitened(
    likelihood: TorqueLikelihood, outputs: Sequence[Array], scales: Array, shares: Array
) -> Array:
    """Whiten outputs ``(..., M)`` of each recording, over the root of its subsample's share."""
    innovations = likelihood.innovations(outputs, scales)
    weighed = [x / np.sqrt(share) for x, share in zip(innovations, shares, strict=True)]
    return np.concatenate(weighed, axis=-1)


def _raised_eigenvalues(information: Array, least: float) -> Array:
    """Raise the eigenvalues of a symmetric matrix to a minimum."""
    power, axes = np.linalg.eigh(information)
    return np.asarray((axes * np.maximum(power, least)) @ axes.T)
