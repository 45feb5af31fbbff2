r"""How far the numbers may be off because the model is not exactly right: model discrepancy.

A posterior takes the model for true; its intervals then may miss parameters that another cause of
torque biases [2]_. What else may explain the torque stands in a table of
candidates (:mod:`bayesfric.diagnostics.candidates`), each a few columns beside the model's own.
Here they are marginalised: each kind of candidate has one of its shapes and a size of unknown
scale, half Cauchy around one scale for all kinds, so that most are nothing and one may be large
rather than several of the same size that look like it [1]_; and with some probability none is
there at all. Given the scales, sizes are normal and integrated out; scales and shapes are on a
grid and drawn by Gibbs sampling from one Gram matrix, whatever the length of the recordings.

What a candidate of size :math:`\gamma` with column :math:`z` does to the model's own estimate is
:math:`-(X'WX + P)^{-1} X'Wz\gamma`, of the likelihood's weights and the prior's: along what the
prior says nothing moves. Half of the mean of that is taken as a shift, and half is spread: the
true column may be another one that looks alike on this motion.

The scores that encoder and filters give each candidate where the model is right are known from the
recording's simulated twins, and are taken off first.

References
----------
.. [1] C. M. Carvalho, N. G. Polson, J. G. Scott, "The horseshoe estimator for sparse signals",
   Biometrika 97 (2010) 465-480.
.. [2] J. Brynjarsdóttir, A. O'Hagan, "Learning about physical parameters: the importance of model
   discrepancy", Inverse Problems 30 (2014) 114007.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logsumexp, ndtr, ndtri

from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.posterior import Posterior
from bayesfric.inference.prior.priors import bound_of
from bayesfric.inference.target import Target

Array = NDArray[np.float64]
Index = NDArray[np.intp]

# Draws that tell where the posterior lies; and step to either side, in its sds.
_DRAWS, _STEP = 4000, 0.3
# How often that is halved where it leads to where nothing can be; and a move there drawn anew.
_HALVINGS, _TRIES = 12, 12
# Rounds of the Gibbs sampler of a normal that bounds cut.
_ROUNDS = 20
# Scales of a candidate, as shares of the torque's rms.
_GRID = np.geomspace(3e-5, 0.5, 24)
# Scale of the half-Cauchy of the scale that all others are around.
_TYPICAL = 0.003
# Chance that something is missing, before the recording is asked; where it is less afterwards, the
# recording speaks against it, and intervals stay the posterior's own.
_CHANCE = 0.1
# Sweeps of the Gibbs sampler, and those left out; sizes drawn in each of the others; candidates
# that are taken in before.
_SWEEPS, _BURN, _EACH, _FIRST = 300, 100, 20, 4
# Share of a candidate's shift that is taken; the rest is spread.
_TAKEN = 0.5
# Share of the residual's power that is noise, at least.
_LEAST = 1e-4
# Variance of a candidate in that of its noise below which it does not matter to the others.
_IDLE = 1e-4


@dataclass(frozen=True, eq=False)
class Missing:
    """Candidates of what the model lacks, as regression columns.

    Attributes
    ----------
    columns
        ``(M, m)`` of all outputs, filtered as they are, N m or N; their largest value is the
        torque's rms, or for friction what the model loses. A size of one is then as large as that.
    kinds
        Names of candidates, and of each the columns of every shape that it may have.
    gram, scores, power
        ``(m, m)``, ``(m,)`` and a number: products of what is left of columns and residual beside
        the model's own, whitened; scores of a right model are taken off.
    spread
        ``(m,)`` sd of a right model's scores, in those of white noise; at least one.
    free
        Outputs beyond the model's own parameters.
    """

    columns: Array
    kinds: dict[str, tuple[tuple[int, ...], ...]]
    gram: Array
    scores: Array
    power: float
    spread: Array
    free: int


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
    if chance < _CHANCE:
        return None
    around = _Around.of(target, posterior)
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


def chance_missing(missing: Missing) -> float:
    """Give the probability that any candidate is there, each by itself against none.

    Scores beyond what twins show count in the twins' own standard deviations.

    Parameters
    ----------
    missing
        Candidates, their scores and the residual's power.

    Returns
    -------
    float
        0 without candidates.

    Notes
    -----
    For a candidate of sd ``s`` the evidence against none is that of a linear regression with a
    normal size, the noise's variance integrated out, averaged over the grid of ``s``, over its
    shapes, and over kinds. Prior odds are 1 to 9.
    """
    variance = missing.power / missing.free
    scores = missing.scores / missing.spread
    kinds = []
    for shapes in missing.kinds.values():
        told = []
        for own in shapes:
            power, vectors = np.linalg.eigh(missing.gram[np.ix_(own, own)])
            turned = vectors.T @ scores[list(own)]
            size = _GRID[:, None] ** 2
            total = variance + size * np.clip(power, 0.0, None)
            gain = (turned**2 * size / total).sum(axis=1) / missing.power
            log_gain = -0.5 * missing.free * np.log(np.maximum(1.0 - gain, 1e-12))
            told.append(log_gain - 0.5 * np.log(total / variance).sum(axis=1))
        kinds.append(float(logsumexp(told)) - math.log(np.size(told)))
    if not kinds:
        return 0.0
    factor = float(logsumexp(kinds)) - math.log(len(kinds))
    odds: float = factor + math.log(_CHANCE / (1.0 - _CHANCE))
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

    def evidence(self, precision: Array, pull: Array) -> Array:
        """Give the log evidence ``(shapes, scales)`` of each shape at each scale."""
        own, size = self.places, _GRID[:, None] ** 2
        power, vectors = np.linalg.eigh(precision[own[:, :, None], own[:, None]])
        turned = (vectors * pull[own][:, :, None]).sum(axis=1)[:, None]
        total = 1.0 + size * np.maximum(power, 0.0)[:, None]
        return np.asarray(0.5 * (size * turned**2 / total - np.log(total)).sum(axis=2))


class Sizes:
    """Gibbs sampler of candidates' shapes and scales; sizes are integrated out.

    Parameters
    ----------
    missing
        Candidates, their Gram matrix and scores; at least one.
    """

    def __init__(self, missing: Missing) -> None:
        zero, shapes = missing.scores.size, missing.kinds.values()
        width = max(len(own) for each in shapes for own in each)
        self.gram, self.scores = np.pad(missing.gram, (0, 1)), np.pad(missing.scores, (0, 1))
        self.diagonal = np.diagonal(self.gram)
        self.power, self.free = missing.power, missing.free
        self.kinds = [_Kind.of(each, width, zero) for each in shapes]
        self.taken = np.array([kind.shapes[0] for kind in self.kinds])
        self.scale = np.zeros(len(self.kinds), dtype=np.intp)
        self.variance = missing.power / missing.free

    def drawn(self, rng: np.random.Generator) -> Array:
        """Draw sizes of all candidates together.

        Parameters
        ----------
        rng
            Random numbers.

        Returns
        -------
        ndarray
            ``(n, m)`` factors of the columns; zero of shapes that are not taken.
        """
        ratio = _GRID[:, None] / _GRID
        around = np.log(ratio) - np.log1p(ratio**2)  # half Cauchy, a logarithm's
        around -= logsumexp(around, axis=0)  # (scale, typical scale)
        x = _GRID / _TYPICAL
        prior, typical = np.log(x / (1.0 + x * x)), 0
        # several kinds together may look like one, and no step leads back: the best goes first
        for _ in range(_FIRST):
            asked = [self._asked(g) + around[:, typical] for g in range(len(self.kinds))]
            best = int(np.argmax([one.max() - one[:, 0].max() for one in asked]))
            self._take(best, int(np.argmax(asked[best])))
            mean, _, active = self._given()
            self.variance = self._rest(active, mean) / self.free
        sizes = np.zeros((_SWEEPS, _EACH, self.scores.size))
        for sweep in sizes:
            for g in range(len(self.kinds)):
                self._take(g, _drawn((self._asked(g) + around[:, typical]).ravel(), rng))
            typical = _drawn(prior + around[self.scale].sum(axis=0), rng)
            mean, root, active = self._given()
            drawn = mean[:, None] + root @ rng.standard_normal((active.size, _EACH))
            self.variance = self._rest(active, drawn[:, 0]) / float(rng.chisquare(self.free))
            sweep[:, active] = drawn.T
        return sizes[_BURN:, :, :-1].reshape(-1, self.scores.size - 1)

    def _take(self, g: int, place: int) -> None:
        shape, self.scale[g] = divmod(place, _GRID.size)
        self.taken[g] = self.kinds[g].shapes[shape]

    def _asked(self, g: int) -> Array:
        """Give the log evidence of a kind's shapes at each scale, beside all the others."""
        gram, scores, own = self.gram, self.scores, self.kinds[g].columns
        active, sd = self._active(without=g)
        precision, pull = gram[own[:, None], own], scores[own]
        if active.size:
            cross = sd[:, None] * np.column_stack([gram[active[:, None], own], scores[active]])
            known = cross.T @ np.linalg.solve(self._inner(active, sd), cross) / self.variance
            precision, pull = precision - known[:-1, :-1], pull - known[:-1, -1]
        return self.kinds[g].evidence(precision / self.variance, pull / self.variance)

    def _active(self, without: int | None = None) -> tuple[Index, Array]:
        """Give the numbers of columns that are taken, and their sds; those that matter to one."""
        sd = np.repeat(_GRID[self.scale], self.taken.shape[1]).reshape(self.taken.shape)
        power = sd**2 * self.diagonal[self.taken]
        if without is None:
            return self.taken[power > 0.0], sd[power > 0.0]
        power[without] = 0.0
        matter = power > _IDLE * self.variance
        return self.taken[matter], sd[matter]

    def _inner(self, active: Index, sd: Array) -> Array:
        """Give the precision of sizes over their sds, ``(active, active)``."""
        inner = sd[:, None] * self.gram[active[:, None], active] * (sd / self.variance)
        inner[np.diag_indices(active.size)] += 1.0
        return np.asarray(inner)

    def _given(self) -> tuple[Array, Array, Index]:
        """Give mean ``(active,)`` and root ``(active, active)`` of sizes given their scales."""
        active, sd = self._active()
        root = sd[:, None] * np.linalg.inv(np.linalg.cholesky(self._inner(active, sd))).T
        return root @ (root.T @ self.scores[active]) / self.variance, root, active

    def _rest(self, active: Index, size: Array) -> float:
        """Give the power that sizes leave of the residual."""
        left = self.power - 2.0 * size @ self.scores[active]
        left += size @ self.gram[active[:, None], active] @ size
        return max(float(left), _LEAST * self.power)


def _drawn(log_weights: Array, rng: np.random.Generator) -> int:
    weights = np.cumsum(np.exp(log_weights - log_weights.max()))
    return int(np.searchsorted(weights, rng.uniform() * weights[-1]))


@dataclass(frozen=True, eq=False)
class _Around:
    """The fit as a linear regression in unit noise, as if no bound held anything.

    Posterior draws tell the covariance, of likelihood and prior together. Of what a bound holds
    they do not; but what follows from it they do, as a normal that is cut keeps its conditionals.
    So of that alone the information is the likelihood's, along what follows, and the prior's.
    """

    likelihood: TorqueLikelihood
    scales: Array
    rows: Array  # (n, k) what outputs change by for changes of one
    covariance: Array  # (k, k)
    shift: Array  # (k,) from the posterior's mean to the estimate without bounds

    @classmethod
    def of(cls, target: Target, posterior: Posterior) -> _Around:
        """Linearise the outputs about the posterior's mean, and take off what bounds hold.

        ``rows`` are central differences of the whitened outputs along the posterior's own axes.
        """
        k, likelihood = len(target.free), target.likelihood
        assert isinstance(likelihood, TorqueLikelihood)
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
        predicted = likelihood.predict(target.chain_values(parameters))
        scales = target.noise.scales(parameters[-1:, k:])[0]
        changes = [(p[:k] - p[k : 2 * k]) / (2.0 * size) for p in predicted]
        unit = np.concatenate(likelihood.innovations(changes, scales), axis=1)
        rows = np.linalg.solve(root.T, unit).T
        left = [o.measured - p[-1] for o, p in zip(likelihood.outputs, predicted, strict=True)]
        white = np.concatenate(likelihood.innovations(left, scales))
        pull, known = _held(target, v)
        return cls(likelihood, scales, rows, *_without_bounds(covariance, rows, white, pull, known))

    def scores(self, columns: Array) -> Array:
        """Give what columns ``(n, m)`` of outputs pull the estimate by: ``(k, m)``."""
        ends = np.cumsum([o.measured.size for o in self.likelihood.outputs])[:-1]
        parts = [part.T for part in np.split(columns, ends)]
        white = np.concatenate(self.likelihood.innovations(parts, self.scales), axis=1).T
        return np.asarray(self.rows.T @ white)


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
