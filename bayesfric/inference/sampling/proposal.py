"""A proposal fitted to draws of the posterior, frozen before it is used.

Bounds and load-dependent friction curve the posterior; a mixture of normals follows that, in
sampled and in linear coordinates.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.special import expit, gammaln

from bayesfric.recordings.arrays import Array

# Largest number of components, and draws needed for every entry of a component's covariance,
# against overfitting.
_MAX_COMPONENTS = 3
_DRAWS_PER_ENTRY = 10
# The last fit, which all draws are proposed from, is finer: in the curved tails of a knee with an
# encoder three components are too thin, and walkers stay there for thousands of steps.
_MAX_COMPONENTS_LAST = 6
_DRAWS_PER_ENTRY_LAST = 5
# Draws used by a fit, and its largest number of iterations.
_MAX_DRAWS = 8000
_MAX_DRAWS_LAST = 12_000
_ROUNDS = 60
# Gain of log-likelihood per draw below which the fit ends.
_GAIN = 1e-2
_GAIN_LAST = 1e-4
# Weight and degrees of freedom of the wide component, which bounds the importance weights in the
# tails.
_WIDE_SHARE = 0.1
_WIDE_DEGREES = 5.0
# Redraws where linear coordinates have no inverse.
_TRIALS = 100


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
        self.weights = np.append((1.0 - _WIDE_SHARE) * weights, _WIDE_SHARE)
        self.means = np.concatenate([means, mean[None]])
        self.roots = np.concatenate([roots, root[None]])
        # products with inverses are faster than solves
        inverses = np.linalg.inv(self.roots)
        self._whiten = inverses.reshape((k + 1) * d, d)
        self._shift = np.einsum("kij,kj->ki", inverses, self.means)[:, :, None]
        log_volume = np.log(np.diagonal(self.roots, axis1=1, axis2=2)).sum(axis=1)
        constant = np.full(k + 1, -d / 2.0 * math.log(2.0 * math.pi))
        nu = _WIDE_DEGREES
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
        few draws. Dempster, Laird and Rubin, Journal of the Royal Statistical Society B 39 (1977)
        1-38.
        """
        max_components = _MAX_COMPONENTS_LAST if last else _MAX_COMPONENTS
        draws_per_entry = _DRAWS_PER_ENTRY_LAST if last else _DRAWS_PER_ENTRY
        max_draws = _MAX_DRAWS_LAST if last else _MAX_DRAWS
        n, d = draws.shape
        mean, covariance = draws.mean(axis=0), np.atleast_2d(np.cov(draws.T))
        # keeps the covariance of collinear coordinates positive definite
        covariance[np.diag_indices(d)] *= 1.0 + 1e-10
        covariance[np.diag_indices(d)] += 1e-300
        root = _cholesky(covariance)
        z = (draws[:: n // max_draws + 1] - mean) @ np.linalg.inv(root).T
        # repeated positions do not count
        distinct = np.unique(z[:, 0]).size
        components = min(max_components, distinct // (draws_per_entry * d * d))
        if components < 2:
            return cls(np.ones(1), mean[None], root[None], mean, root)
        weights, means, roots = _mixture(z, components, _GAIN_LAST if last else _GAIN)
        return cls(weights, mean + means @ root.T, np.asarray(root @ roots), mean, root)

    def draw(self, n: int, random: np.random.RandomState) -> Array:
        """Draw ``(n, d)`` with emcee's generator."""
        component = np.searchsorted(self._shares, random.rand(n))
        z = random.randn(n, self.dimension)
        wide = component == self.weights.size - 1
        stretch = _WIDE_DEGREES / random.chisquare(_WIDE_DEGREES, size=int(wide.sum()))
        z[wide] *= np.sqrt(stretch)[:, None]
        out = np.empty_like(z)
        for k, root in enumerate(self.roots):
            members = component == k
            out[members] = self.means[k] + z[members] @ root.T
        return out

    def log_density(self, x: Array) -> Array:
        """Log density ``(n,)`` at points ``(n, d)``."""
        d, nu = self.dimension, _WIDE_DEGREES
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
        self,
        sampled: Proposal,
        linear: Proposal,
        share: float,
        forward: Callable[[Array], tuple[Array, Array]],
        inverse: Callable[[Array], Array],
    ) -> None:
        self.sampled, self.linear, self.share = sampled, linear, share
        self._forward, self._inverse = forward, inverse

    @classmethod
    def fitted(
        cls,
        draws: Array,
        forward: Callable[[Array], tuple[Array, Array]],
        inverse: Callable[[Array], Array],
        *,
        last: bool = False,
    ) -> MixedProposal:
        """Fit both to draws ``(n, d)``, and their shares by expectation maximisation."""
        v, slope = forward(draws)
        finite = np.isfinite(slope)
        sampled, linear = (Proposal.fitted(x, last=last) for x in (draws, v[finite]))
        proposal = cls(sampled, linear, 0.5, forward, inverse)
        subset = draws[:: len(draws) // _MAX_DRAWS + 1]
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
        for _ in range(_TRIALS):
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
    i, j = np.triu_indices(d)
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


def _maximisation(share: Array, terms: Array, d: int) -> tuple[Array, Array, Array]:
    """Compute the normals from the draws' responsibilities ``(k, n)``."""
    moments = share @ terms.T
    i, j = np.triu_indices(d)
    means = moments[:, 1 : d + 1] / moments[:, :1]
    covariances = np.empty((len(moments), d, d))
    covariances[:, i, j] = covariances[:, j, i] = moments[:, d + 1 :] / moments[:, :1]
    # draws are white, so nothing cancels; the diagonal keeps a component from collapsing
    covariances += 1e-3 * np.eye(d) - means[:, :, None] * means[:, None, :]
    return moments[:, 0] / terms.shape[1], means, _cholesky(covariances)


def _expectation(normals: tuple[Array, Array, Array], terms: Array) -> tuple[Array, float]:
    """Compute the draws' responsibilities ``(k, n)`` and the mean log density."""
    weights, means, roots = normals
    i, j = np.triu_indices(means.shape[1])
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
