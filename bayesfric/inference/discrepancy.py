r"""How far the numbers may be off because the model is not exactly right: model discrepancy.

A posterior takes the model for true; its intervals then may miss parameters that another cause of
torque biases [1]_. Here what else may explain the torque is marginalised, with sizes as
:mod:`bayesfric.inference.missing` draws them.

What a candidate of size :math:`\gamma` with column :math:`z` does to the model's own estimate is
:math:`-(X'WX + P)^{-1} X'Wz\gamma`, of the likelihood's weights and the prior's: along what the
prior says nothing moves. Half of the mean of that is taken as a shift, and half is spread: the
true column may be another one that looks alike on this motion.

The scores that encoder and filters give each candidate where the model is right are known from the
recording's simulated twins, and are taken off first.

References
----------
.. [1] J. Brynjarsdóttir, A. O'Hagan, "Learning about physical parameters: the importance of model
   discrepancy", Inverse Problems 30 (2014) 114007.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.missing import CHANCE, Missing, Sizes, chance_missing
from bayesfric.inference.posterior import Posterior
from bayesfric.inference.prior.priors import bound_of
from bayesfric.inference.target import Target
from bayesfric.recordings.observation import Observation

Array = NDArray[np.float64]
Index = NDArray[np.intp]

# Draws that tell where the posterior lies; and step to either side, in its sds.
_DRAWS, _STEP = 4000, 0.3
# How often that is halved where it leads to where nothing can be; and a move there drawn anew.
_HALVINGS, _TRIES = 12, 12
# Share of what the whole tells that an excerpt tells of any direction, at least.
_TOLD = 0.05
# Rounds of the Gibbs sampler of a normal that bounds cut.
_ROUNDS = 20
# Share of a candidate's shift that is taken; the rest is spread.
_TAKEN = 0.5


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """How far the model may be off, in a target's unbounded coordinates.

    Attributes
    ----------
    chance
        Probability that something is missing; 0 where the recording speaks against it.
    moves
        ``(n, k)`` draws of how far the ``k`` free parameters of the model then are off.
    shift
        ``(k,)`` from the mean of the posterior to what the data say without bounds.
    covariance
        ``(k, k)`` of that estimate.
    """

    chance: float
    moves: Array
    shift: Array
    covariance: Array

    @property
    def shown(self) -> bool:
        """Whether there is any, so that intervals are widened."""
        return self.chance > 0.0

    @property
    def taken(self) -> float:
        """Share of what candidates move that draws are moved by."""
        return _TAKEN * self.chance

    def widened(self, target: Target, parameters: Array, rng: np.random.Generator) -> Array:
        """Move draws of the posterior by as much as the model may be off.

        Parameters
        ----------
        target
            Whose unbounded coordinates the moves are in.
        parameters
            ``(n, d)`` draws, SI units.
        rng
            Says which draws are moved, with probability ``chance``, and by which of the moves.

        Returns
        -------
        ndarray
            ``(n, d)``; noise scales stay as they are.

        Notes
        -----
        What the data say is moved, and bounds cut it afterwards: a draw that ends beyond one is
        moved anew. Where hardly a move ends inside, all that data and moves say together is taken
        for a normal that bounds cut.
        """
        if not self.shown:
            return parameters
        v, found, k = target.unbounded(parameters), parameters.copy(), len(self.shift)
        left = np.flatnonzero(rng.uniform(size=len(v)) < self.chance)
        for _ in range(_TRIES):
            moved = v[left]
            moved[:, :k] += self.shift + self.moves[rng.integers(len(self.moves), size=len(left))]
            left = left[~_put(target, found, left, moved)]
        moved, whole = v[left], self.covariance + np.atleast_2d(np.cov(self.moves.T, bias=True))
        mean = v[:, :k].mean(axis=0) + self.shift + self.moves.mean(axis=0)
        moved[:, :k] = cut_normal(mean, whole, target.limits(), moved[:, :k], rng)
        _put(target, found, left, moved)
        return found


def cut_normal(
    mean: Array,
    covariance: Array,
    limits: tuple[Array, Array],
    start: Array,
    rng: np.random.Generator,
) -> Array:
    """Draw from a normal that bounds cut, by Gibbs sampling [1]_.

    Parameters
    ----------
    mean, covariance
        ``(k,)`` and ``(k, k)`` before it is cut.
    limits
        Lower and upper bounds, ``(k,)`` each, infinite where there are none.
    start
        ``(n, k)`` inside the bounds, one for each draw.
    rng
        Random numbers.

    Returns
    -------
    ndarray
        ``(n, k)``, after twenty rounds of drawing each number given all the others.

    References
    ----------
    .. [1] J. Geweke, "Efficient simulation from the multivariate normal and Student-t distributions
       subject to linear constraints", Computing Science and Statistics 23 (1991) 571-578.
    """
    x, precision, (low, high) = start.copy(), np.linalg.inv(covariance), limits
    sds = np.diagonal(precision) ** -0.5
    for _ in range(_ROUNDS):
        for j, sd in enumerate(sds):
            middle = x[:, j] - (x - mean) @ precision[j] * sd**2
            ends = (np.array([[low[j]], [high[j]]]) - middle) / sd
            # in the lower tail, which rounding leaves as it is
            upper = ends[0] > 0.0
            ends = np.where(upper, -ends[::-1], ends)
            below, inside = ndtr(ends[0]), ndtr(ends[1]) - ndtr(ends[0])
            drawn = ndtri(below + rng.uniform(size=len(x)) * inside)
            x[:, j] = np.clip(middle + sd * np.where(upper, -drawn, drawn), low[j], high[j])
    return x


def _put(target: Target, found: Array, rows: Index, moved: Array) -> NDArray[np.bool_]:
    """Put what is possible into the rows of ``found``, and say what that is."""
    parameters = target.from_unbounded(moved)
    possible = np.isfinite(parameters).all(axis=1)
    found[rows[possible]] = parameters[possible]
    return np.asarray(possible)


@dataclass(frozen=True, eq=False)
class Pull:
    """What may be missing pulls a recording's estimate by, in its target's coordinates.

    Attributes
    ----------
    chance
        Probability that something is missing.
    drawn
        ``(n, k)`` draws of the score that it adds, of likelihood and ``k`` free parameters: times
        the posterior's covariance it is a move.
    around
        The fit as a linear regression.
    """

    chance: float
    drawn: Array
    around: _Around

    def scores(self, rows: Index, sides: Array) -> Array:
        """Give scores of the pull, centred as far as they are taken for a shift.

        Parameters
        ----------
        rows
            Which of the drawn.
        sides
            ``(rows, 1)`` standard normal numbers.

        Returns
        -------
        ndarray
            ``(rows, k)``. Of the mean half is taken, and the rest may be there or not, to either
            side.
        """
        mean = self.drawn.mean(axis=0)
        return np.asarray(self.drawn[rows] - mean + (_TAKEN + (1.0 - _TAKEN) * sides) * mean)


def pull(target: Target, posterior: Posterior, missing: Missing | None) -> Pull | None:
    """Marginalise what may be missing from the torque.

    Parameters
    ----------
    target, posterior
        Of a fit.
    missing
        Candidates; ``None`` where nobody could ask.

    Returns
    -------
    Pull or None
        ``None`` without candidates, for positions, for an unusable sample, or where the probability
        that something is missing is below the one before the recording is asked, 0.1.
    """
    known = isinstance(target.likelihood, TorqueLikelihood)
    if missing is None or not known or posterior.diagnostics.status == "unusable":
        return None
    chance = chance_missing(missing)
    if chance < CHANCE:
        return None
    around = _Around.of(target, posterior, missing.observations)
    drawn = -Sizes(missing).drawn(_stream(posterior)) @ around.scores(missing.columns).T
    return Pull(chance, drawn, around)


def _stream(posterior: Posterior, *more: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(posterior.seed, spawn_key=(13, *more)))


def discrepancy(target: Target, posterior: Posterior, missing: Missing | None) -> Discrepancy:
    """Say how far what may be missing moves the numbers.

    Parameters
    ----------
    target, posterior, missing
        As for :func:`pull`.

    Returns
    -------
    Discrepancy
        Of chance 0 where :func:`pull` gives none.
    """
    k = len(target.free)
    one = pull(target, posterior, missing)
    if one is None:
        return Discrepancy(0.0, np.zeros((1, k)), np.zeros(k), np.eye(k))
    around, count = one.around, len(one.drawn)
    sides = _stream(posterior, 1).standard_normal((count, 1))
    moves = one.scores(np.arange(count), sides) @ around.covariance
    return Discrepancy(one.chance, moves, around.shift, around.covariance)


@dataclass(frozen=True, eq=False)
class _Around:
    """The fit as a linear regression in unit noise, as if no bound held anything.

    Posterior draws tell the covariance, of likelihood and prior together. Of what a bound holds
    they do not, nor what follows from it; but of the others while that stays where it is they do,
    as a normal that is cut keeps its conditionals. The rest is the likelihood's and the prior's.
    """

    likelihood: TorqueLikelihood
    scales: Array
    shares: Array  # (R,) of the outputs of each recording that are asked
    rows: Array  # (n, k) what outputs change by for changes of one
    covariance: Array  # (k, k)
    shift: Array  # (k,) from the posterior's mean to the estimate without bounds

    @classmethod
    def of(
        cls, target: Target, posterior: Posterior, observations: Sequence[Observation]
    ) -> _Around:
        """Linearise the outputs about the posterior's mean, and take off what bounds hold.

        ``rows`` are central differences of the whitened outputs along the posterior's own axes.
        ``observations`` may be excerpts: what they tell stands for as much more of the rest, and
        the covariance is then the one that draws would have, were the whole moved as they are.
        """
        k, whole = len(target.free), target.likelihood
        assert isinstance(whole, TorqueLikelihood)
        likelihood = TorqueLikelihood(whole.chain, observations, whole.noise)
        shares = likelihood.sizes / whole.sizes
        draws = posterior.flat(_DRAWS)
        v = target.unbounded(draws)
        v = v[np.isfinite(v).all(axis=1)]
        middle, covariance = v.mean(axis=0), np.atleast_2d(np.cov(v[:, :k].T))
        root = np.linalg.cholesky(covariance)
        # central differences over a sizeable step: what a kink does to a draw counts, not its slope
        steps, size = np.zeros((2 * k + 1, v.shape[1])), _STEP
        steps[:k, :k], steps[k : 2 * k, :k] = root.T, -root.T
        for _ in range(_HALVINGS):
            parameters = target.from_unbounded(middle + size * steps)
            if np.isfinite(parameters).all():
                break
            size *= 0.5
        scales = target.noise.scales(parameters[-1:, k:])[0]

        def linearised(asked: TorqueLikelihood, shares: Array) -> tuple[Array, Array]:
            """Give whitened changes along the posterior's axes, and what is left."""
            predicted = asked.predict(target.chain_values(parameters))
            changes = [(p[:k] - p[k : 2 * k]) / (2.0 * size) for p in predicted]
            left = [o.measured - p[-1] for o, p in zip(asked.outputs, predicted, strict=True)]
            return _white(asked, changes, scales, shares), _white(asked, left, scales, shares)

        unit, white = linearised(likelihood, shares)
        rows = np.linalg.solve(root.T, unit).T
        if (shares < 1.0).any():
            every, _ = linearised(whole, np.ones(len(shares)))
            told, axes = np.linalg.eigh(np.eye(k) + unit @ unit.T - every @ every.T)
            along = root @ axes
            covariance = along / np.maximum(told, _TOLD) @ along.T
        pull, known = _held(target, v)
        free = _without_bounds(covariance, rows, white, pull, known)
        return cls(likelihood, scales, shares, rows, *free)

    def scores(self, columns: Array) -> Array:
        """Give what columns ``(n, m)`` of outputs pull the estimate by: ``(k, m)``."""
        ends = np.cumsum([o.measured.size for o in self.likelihood.outputs])[:-1]
        parts = [part.T for part in np.split(columns, ends)]
        white = _white(self.likelihood, parts, self.scales, self.shares).T
        return np.asarray(self.rows.T @ white)


def _white(
    likelihood: TorqueLikelihood, outputs: Sequence[Array], scales: Array, shares: Array
) -> Array:
    """Whiten ``(..., M)`` of each recording, and weigh it as what it is a share of."""
    found = likelihood.innovations(outputs, scales)
    weighed = [x / np.sqrt(share) for x, share in zip(found, shares, strict=True)]
    return np.concatenate(weighed, axis=-1)


def _held(target: Target, v: Array) -> tuple[Array, Array]:
    """Give the way to the bound that holds a coordinate, else zero, and its prior's information.

    Of unbounded coordinates ``(n, d)``, ``(k,)`` each.
    """
    pull, known = np.zeros(len(target.free)), np.zeros(len(target.free))
    here, own, _ = target.coordinates.apart
    known[here] = [target.priors[i].sd() ** -2.0 for i in own]
    for i, (low, high) in enumerate(zip(*target.limits(), strict=True)):
        if side := bound_of(v[:, i], low, high):
            pull[i] = (high if side == "upper" else low) - v[:, i].mean()
    return pull, known


def _without_bounds(
    covariance: Array, rows: Array, left: Array, pull: Array, known: Array
) -> tuple[Array, Array]:
    """Give covariance ``(k, k)`` and shift of the mean ``(k,)`` without bounds.

    ``pull`` ``(k,)`` is the way to the bound that holds a number, else zero, and ``known`` the
    information of its prior there.
    """
    on = np.flatnonzero(pull)
    # of the others, while the held ones stay where they are
    rest = covariance - covariance[:, on] @ np.linalg.solve(
        covariance[np.ix_(on, on)], covariance[on]
    )
    # what the others do when a held one changes by one: by the likelihood, as a bound leaves the
    # draws so narrow there that what they show of it is mostly chance
    follow = -rest @ (rows.T @ rows[:, on])
    follow[on] = np.eye(len(on))
    along = rows @ follow
    own = np.linalg.inv(along.T @ along + np.diag(known[on]))
    shift = own @ (along.T @ left + known[on] * pull[on])
    return rest + follow @ own @ follow.T, follow @ shift
