"""Proposals fitted to draws of the posterior, and the moves of emcee's walkers.

Bounds and load-dependent friction curve the posterior; a mixture of normals follows that, in
sampled and in linear coordinates. It is frozen before a step counts.

The walkers of one emcee sampler are several independent ensembles, one after the other: evaluating
all together costs little more than one ensemble. Walkers of different ensembles never interact.

emcee's own ``DESnookerMove`` and ``GaussianMove`` are not used: in 3.1.6 the first samples a
standard normal with 0.59 of its variance, the second gives every walker the same step. The tests
check every move used here against exact posteriors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from emcee.moves import Move
from numpy.typing import NDArray
from scipy.special import expit, gammaln

from bayesfric.recordings.arrays import Array, Flags, Index

# A map to other coordinates ``(n, d)`` with its log Jacobian ``(n,)``, and back
Forward = Callable[[Array], tuple[Array, Array]]
Inverse = Callable[[Array], Array]

# Weight and degrees of freedom of the wide component, which bounds the importance weights in the
# tails.
_WIDE, _DEGREES = 0.1, 5.0
# Largest number of iterations of a fit.
_ROUNDS = 60


class Proposal:
    """A mixture of normals and a multivariate t around it all.

    The t has a tenth of the weight and five degrees of freedom: tails heavier than the posterior's
    keep the importance weights bounded (Hesterberg, "Weighted average importance sampling and
    defensive mixture distributions", Technometrics 37 (1995) 185-194). Weights ``(k,)``, means
    ``(k, d)`` and Cholesky roots ``(k, d, d)``; ``mean`` and ``root`` of the t.
    """

    def __init__(
        self, weights: Array, means: Array, roots: Array, mean: Array, root: Array
    ) -> None:
        k, d = means.shape
        self.dimension = d
        self.weights = np.append((1.0 - _WIDE) * weights, _WIDE)
        self.means = np.concatenate([means, mean[None]])
        self.roots = np.concatenate([roots, root[None]])
        # products with inverses are faster than solves
        inverses = np.linalg.inv(self.roots)
        self._whiten = inverses.reshape((k + 1) * d, d)
        self._shift = np.einsum("kij,kj->ki", inverses, self.means)[:, :, None]
        log_volume = np.log(np.diagonal(self.roots, axis1=1, axis2=2)).sum(axis=1)
        constant = np.full(k + 1, -d / 2.0 * math.log(2.0 * math.pi))
        nu = _DEGREES
        constant[-1] = (
            gammaln((nu + d) / 2.0) - gammaln(nu / 2.0) - d / 2.0 * math.log(nu * math.pi)
        )
        self._constant = (np.log(self.weights) + constant - log_volume)[:, None]
        self._shares = np.cumsum(self.weights)[:-1]

    @classmethod
    def normal(cls, mean: Array, covariance: Array) -> Proposal:
        """Make one normal of mean ``(d,)`` and covariance ``(d, d)``, and a t of the same root."""
        root = _cholesky(covariance)
        return cls(np.ones(1), mean[None], root[None], mean, root)

    @classmethod
    def fitted(cls, draws: Array, *, last: bool = False) -> Proposal:
        """Fit to draws ``(n, d)`` by expectation maximisation.

        Components start as slices along the direction of the largest skewness; there are fewer for
        few draws. The last fit, which all draws are proposed from, is finer: in the curved tails of
        a knee with an encoder three components are too thin, and walkers stay there for thousands
        of steps. Dempster, Laird and Rubin, Journal of the Royal Statistical Society B 39 (1977)
        1-38.
        """
        # most components, draws needed for each entry of a component's covariance, most draws, and
        # gain of log-likelihood per draw below which it ends
        max_count, per_entry, most_draws, gain = (
            (6, 5, 12_000, 1e-4) if last else (3, 10, 8000, 1e-2)
        )
        n, d = draws.shape
        mean, covariance = draws.mean(axis=0), np.atleast_2d(np.cov(draws.T))
        # keeps the covariance of collinear coordinates positive definite
        covariance[np.diag_indices(d)] *= 1.0 + 1e-10
        covariance[np.diag_indices(d)] += 1e-300
        root = _cholesky(covariance)
        z = (draws[:: n // most_draws + 1] - mean) @ np.linalg.inv(root).T
        # repeated positions do not count
        distinct = np.unique(z[:, 0]).size
        components = min(max_count, distinct // (per_entry * d * d))
        if components < 2:
            return cls(np.ones(1), mean[None], root[None], mean, root)
        weights, means, roots = _mixture(z, components, gain)
        return cls(weights, mean + means @ root.T, np.asarray(root @ roots), mean, root)

    def draw(self, n: int, random: np.random.RandomState) -> Array:
        """Draw ``(n, d)`` with emcee's generator."""
        component = np.searchsorted(self._shares, random.rand(n))
        z = random.randn(n, self.dimension)
        wide = component == self.weights.size - 1
        stretch = _DEGREES / random.chisquare(_DEGREES, size=int(wide.sum()))
        z[wide] *= np.sqrt(stretch)[:, None]
        out = np.empty_like(z)
        for k, root in enumerate(self.roots):
            members = component == k
            out[members] = self.means[k] + z[members] @ root.T
        return out

    def log_density(self, x: Array) -> Array:
        """Log density ``(n,)`` at points ``(n, d)``."""
        d, nu = self.dimension, _DEGREES
        z = (self._whiten @ x.T).reshape(self.weights.size, d, -1) - self._shift
        level = np.einsum("kdn,kdn->kn", z, z)
        level[:-1] *= -0.5
        level[-1] = -(nu + d) / 2.0 * np.log1p(level[-1] / nu)
        level += self._constant
        top = level.max(axis=0)
        return np.asarray(top + np.log(np.exp(level - top).sum(axis=0)))


class MixedProposal:
    """A mixture of proposals in the sampled and in linear coordinates.

    A draw without an inverse is drawn again, which truncates the proposal at the posterior's
    support and scales its density by a constant.
    """

    def __init__(
        self, sampled: Proposal, linear: Proposal, share: float, forward: Forward, inverse: Inverse
    ) -> None:
        self.sampled, self.linear, self.share = sampled, linear, share
        self._forward, self._inverse = forward, inverse

    @classmethod
    def fitted(
        cls, draws: Array, forward: Forward, inverse: Inverse, *, last: bool = False
    ) -> MixedProposal:
        """Fit both to draws ``(n, d)``, and their shares by expectation maximisation."""
        v, slope = forward(draws)
        finite = np.isfinite(slope)
        sampled, linear = (Proposal.fitted(x, last=last) for x in (draws, v[finite]))
        proposal = cls(sampled, linear, 0.5, forward, inverse)
        subset = draws[:: len(draws) // 8000 + 1]
        levels = proposal._levels(subset)
        for _ in range(_ROUNDS):
            linear_sum = expit(levels[1] - levels[0]).sum()
            share = float((linear_sum + 1.0) / (len(subset) + 2.0))  # neither share is ever zero
            levels += np.log([[(1.0 - share) / (1.0 - proposal.share)], [share / proposal.share]])
            proposal.share = share
        return proposal

    def draw(self, n: int, random: np.random.RandomState) -> Array:
        """Draw ``(n, d)``; rows without an inverse after a hundred trials are not finite."""
        out, missing = np.full((n, self.sampled.dimension), np.nan), np.arange(n)
        for _ in range(100):
            in_sampled = random.rand(missing.size) >= self.share
            out[missing[in_sampled]] = self.sampled.draw(int(in_sampled.sum()), random)
            out[missing[~in_sampled]] = self._inverse(
                self.linear.draw(int((~in_sampled).sum()), random)
            )
            missing = missing[~np.isfinite(out[missing]).all(axis=1)]
            if not missing.size:
                break
        return out

    def log_density(self, x: Array) -> Array:
        """Log density ``(n,)`` at points ``(n, d)``, up to a constant."""
        return np.asarray(np.logaddexp(*self._levels(x)))

    def _levels(self, x: Array) -> Array:
        """Log density of each proposal times its share, ``(2, n)``."""
        v, slope = self._forward(x)
        sampled = self.sampled.log_density(x) + math.log(1.0 - self.share)
        linear = self.linear.log_density(v) + slope + math.log(self.share)
        return np.where(np.isfinite([sampled, linear]), [sampled, linear], -np.inf)


def _mixture(z: Array, components: int, tolerance: float) -> tuple[Array, Array, Array]:
    """Fit normals to white draws ``(n, d)``: weights, means and Cholesky roots."""
    n, d = z.shape
    skewed = (z * np.sum(z**2, axis=1, keepdims=True)).mean(axis=0)
    share = np.eye(components)[:, np.argsort(np.argsort(z @ skewed)) * components // n]
    # densities and moments are linear in coordinates and their products
    i, j = _pairs(d)
    terms = np.concatenate([np.ones((1, n)), z.T, z.T[i] * z.T[j]])
    previous = -np.inf
    for _ in range(_ROUNDS):
        normals = _maximisation(share, terms, d)
        share, likelihood = _expectation(normals, terms)
        # an empty component would divide by zero
        if likelihood - previous < tolerance or share.mean(axis=1).min() * n < 2 * d:
            break
        previous = likelihood
    return normals


@cache
def _pairs(d: int) -> tuple[Index, Index]:
    """Return the indices of the products of coordinates."""
    return np.triu_indices(d)


def _maximisation(share: Array, terms: Array, d: int) -> tuple[Array, Array, Array]:
    """Compute the normals from the draws' responsibilities ``(k, n)``."""
    moments = share @ terms.T
    i, j = _pairs(d)
    means = moments[:, 1 : d + 1] / moments[:, :1]
    covariances = np.empty((len(moments), d, d))
    covariances[:, i, j] = covariances[:, j, i] = moments[:, d + 1 :] / moments[:, :1]
    # draws are white, so nothing cancels; the diagonal keeps a component from collapsing
    covariances += 1e-3 * np.eye(d) - means[:, :, None] * means[:, None, :]
    return moments[:, 0] / terms.shape[1], means, _cholesky(covariances)


def _expectation(normals: tuple[Array, Array, Array], terms: Array) -> tuple[Array, float]:
    """Compute the draws' responsibilities ``(k, n)`` and the mean log density."""
    weights, means, roots = normals
    i, j = _pairs(means.shape[1])
    inverses = np.linalg.inv(roots)
    precisions = inverses.transpose(0, 2, 1) @ inverses
    centres = np.einsum("kij,kj->ki", precisions, means)
    constant = np.log(weights) - 0.5 * np.einsum("ki,ki->k", means, centres)
    constant -= np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
    products = np.where(i == j, -0.5, -1.0) * precisions[:, i, j]
    level = np.concatenate([constant[:, None], centres, products], axis=1) @ terms
    top = level.max(axis=0)
    share = np.exp(level - top)
    total = share.sum(axis=0)
    return share / total, float(np.mean(top + np.log(total)))


def _cholesky(covariance: Array) -> Array:
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)


def _accept(
    model: Any, state: Any, walkers: NDArray[np.int64], proposed: Array, factors: Array
) -> Flags:
    """Accept or reject proposals ``(n, d)`` for walkers ``(n,)`` at once; return flags ``(n,)``.

    emcee's moves loop over walkers in Python. ``factors`` are log Hastings factors; a proposal that
    is not finite has no density.
    """
    density = np.full(len(proposed), -np.inf)
    possible = np.flatnonzero(np.isfinite(proposed).all(axis=1) & ~np.isnan(factors))
    if possible.size:
        # emcee's compute_log_prob would unpack the values one by one
        density[possible] = model.log_prob_fn(proposed[possible])
    if np.isnan(density).any():
        raise ValueError("the log density is nan")
    with np.errstate(invalid="ignore"):
        gain = factors + density - state.log_prob[walkers]
    accepted = gain > np.log(model.random.rand(gain.size))
    moved = walkers[accepted]
    state.coords[moved] = proposed[accepted]
    state.log_prob[moved] = density[accepted]
    return np.asarray(accepted, dtype=np.bool_)


class DifferentialEvolutionMove(Move):  # type: ignore[misc]
    """Step along the difference of two walkers of the other half of the same ensemble.

    Differential evolution (ter Braak, Statistics and Computing 16 (2006) 239-249), vectorised: ``x
    + g (x_i - x_j)`` with ``g = 2.38/sqrt(2 d)``, jittered by 1e-5. One proposal in ten has ``g =
    1``, which lets walkers change between separate modes. Steps may be made in other coordinates.
    """

    def __init__(
        self,
        ensembles: int = 1,
        forward: Forward = lambda u: (u, np.zeros(len(u))),
        inverse: Inverse = lambda v: v,
    ) -> None:
        self.ensembles, self._forward, self._inverse = ensembles, forward, inverse

    def propose(self, model: Any, state: Any) -> tuple[Any, Flags]:
        """Move both halves of every ensemble, one after the other."""
        random = model.random
        coords, slope = self._forward(state.coords)
        # a walker without a finite image accepts any step
        slope = np.where(np.isfinite(slope), slope, np.inf)
        total, d = coords.shape
        size = total // self.ensembles
        first = np.arange(0, total, size)[:, None]
        # halves are drawn again in every step
        halves = np.array_split(random.permutation(size), 2)
        accepted = np.zeros(total, dtype=bool)
        for half, other in (halves, halves[::-1]):
            walkers = (first + half).ravel()
            shape = (self.ensembles, half.size)
            i = random.randint(other.size, size=shape)
            j = random.randint(other.size - 1, size=shape)
            j += j >= i
            length = np.where(random.rand(walkers.size) < 0.1, 1.0, 2.38 / math.sqrt(2.0 * d))
            length *= 1.0 + 1e-5 * random.randn(walkers.size)
            difference = coords[first + other[i]] - coords[first + other[j]]
            stepped = coords[walkers] + length[:, None] * difference.reshape(-1, d)
            proposed = self._inverse(stepped)
            new_slope = self._forward(proposed)[1]
            factors = slope[walkers] - np.where(np.isfinite(new_slope), new_slope, np.nan)
            moved = _accept(model, state, walkers, proposed, factors)
            coords[walkers[moved]] = stepped[moved]
            accepted[walkers] = moved
        return state, accepted


class IndependenceMove(Move):  # type: ignore[misc]
    """Propose from a fixed density, independent of the walker's position.

    The proposal may be replaced between blocks of the warm-up; then it is frozen, as an adaptive
    one would not leave the posterior invariant.
    """

    def __init__(self, proposal: Proposal | MixedProposal) -> None:
        self.proposal = proposal

    def propose(self, model: Any, state: Any) -> tuple[Any, Flags]:
        """Move all walkers at once, with the Hastings factor of the proposal."""
        proposed = self.proposal.draw(state.coords.shape[0], model.random)
        factors = self.proposal.log_density(state.coords) - self.proposal.log_density(proposed)
        return state, _accept(model, state, np.arange(len(proposed)), proposed, factors)
