"""A proposal fitted to draws of the posterior, frozen before it is used.

An independence move is as good as its proposal is near the posterior, which bounds and
load-dependent friction bend; several normals together follow that, in the coordinates in which it
is bent less.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.special import expit, gammaln

from bayesfric.recordings.arrays import Array

# Components of the mixture at most, and how many draws each must have for every entry of its
# covariance, or it would learn the draws and not the posterior.
_MOST_COMPONENTS = 3
_DRAWS_AN_ENTRY = 10
# The last fit, which all draws are proposed from, may be finer: in the bent tails of a knee with
# an encoder three components are too thin, and walkers stay there for thousands of steps.
_MOST_COMPONENTS_LAST = 6
_DRAWS_AN_ENTRY_LAST = 5
# Draws that a fit looks at, and rounds it takes at most.
_LOOKED_AT = 8000
_LOOKED_AT_LAST = 12_000
_ROUNDS = 60
# A round that gains less log-likelihood a draw ends the fit.
_GAIN = 1e-2
_GAIN_LAST = 1e-4
# Share and degrees of freedom of the wide component: it bounds the weights in the tails.
_WIDE_SHARE = 0.1
_WIDE_DEGREES = 5.0
# Draws made anew at most where straight coordinates have no way back.
_TRIALS = 100


class Proposal:
    """A mixture of normals, which follows a bent posterior, and a multivariate t around it all.

    With one component it is a normal, and the t. The t has a tenth of the weight, five degrees of
    freedom, and heavier tails than any posterior that is normal far out, so that the weights of an
    independence move stay bounded [1]_.

    References
    ----------
    .. [1] T. Hesterberg, "Weighted average importance sampling and defensive mixture
       distributions", Technometrics 37 (1995) 185-194.

    Shapes: ``weights`` (k,), ``means, roots`` (k, d), ``mean, root`` (d,).
    """

    def __init__(
        self, weights: Array, means: Array, roots: Array, mean: Array, root: Array
    ) -> None:
        k, d = means.shape
        self.dimension = d
        self.weights = np.append((1.0 - _WIDE_SHARE) * weights, _WIDE_SHARE)
        self.means = np.concatenate([means, mean[None]])
        self.roots = np.concatenate([roots, root[None]])
        # a product with small inverses is far cheaper than solves at every step
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
        """Fit to draws by expectation and maximisation [1]_.

        The components start as slices across the direction in which the draws are most skewed.
        There are fewer where draws are few, down to one.

        References
        ----------
        .. [1] A. P. Dempster, N. M. Laird, D. B. Rubin, "Maximum likelihood from incomplete data
           via the EM algorithm", Journal of the Royal Statistical Society B 39 (1977) 1-38.

        Shapes: ``draws`` (n, d).
        """
        most = _MOST_COMPONENTS_LAST if last else _MOST_COMPONENTS
        each = _DRAWS_AN_ENTRY_LAST if last else _DRAWS_AN_ENTRY
        looked_at = _LOOKED_AT_LAST if last else _LOOKED_AT
        n, d = draws.shape
        mean, covariance = draws.mean(axis=0), np.atleast_2d(np.cov(draws.T))
        # keeps the Cholesky factor alive when two coordinates are all but one
        covariance[np.diag_indices(d)] *= 1.0 + 1e-10
        covariance[np.diag_indices(d)] += 1e-300
        root = _cholesky(covariance)
        z = (draws[:: n // looked_at + 1] - mean) @ np.linalg.inv(root).T
        # a walker that stayed where it was says nothing new
        distinct = np.unique(z[:, 0]).size
        components = min(most, distinct // (each * d * d))
        if components < 2:
            return cls(np.ones(1), mean[None], root[None], mean, root)
        weights, means, roots = _mixture(z, components, _GAIN_LAST if last else _GAIN)
        return cls(weights, mean + means @ root.T, np.asarray(root @ roots), mean, root)

    def draw(self, n: int, random: np.random.RandomState) -> Array:
        """Draw ``(n, d)`` from emcee's own generator."""
        component = np.searchsorted(self._shares, random.rand(n))
        z = random.randn(n, self.dimension)
        wide = component == self.weights.size - 1
        stretch = _WIDE_DEGREES / random.chisquare(_WIDE_DEGREES, size=int(wide.sum()))
        z[wide] *= np.sqrt(stretch)[:, None]
        out = np.empty_like(z)
        for k, root in enumerate(self.roots):
            here = component == k
            out[here] = self.means[k] + z[here] @ root.T
        return out

    def log_density(self, x: Array) -> Array:
        """Log of the density at ``(n, d)`` points, ``(n,)``."""
        d, nu = self.dimension, _WIDE_DEGREES
        z = (self._whiten @ x.T).reshape(self.weights.size, d, -1) - self._shift
        level = np.einsum("kdn,kdn->kn", z, z)
        level[:-1] *= -0.5
        level[-1] = -(nu + d) / 2.0 * np.log1p(level[-1] / nu)
        level += self._constant
        top = level.max(axis=0)
        return np.asarray(top + np.log(np.exp(level - top).sum(axis=0)))


class ProposalInBoth:
    """A proposal in the sampled coordinates and one in straight ones, mixed.

    A draw without a way back is made anew: that cuts the proposal off where the posterior ends,
    and its density by a factor that is the same everywhere.

    Shapes: ``there, back`` (n, d).
    """

    def __init__(
        self,
        own: Proposal,
        straight: Proposal,
        share: float,
        there: Callable[[Array], tuple[Array, Array]],
        back: Callable[[Array], Array],
    ) -> None:
        self.own, self.straight, self.share = own, straight, share
        self._there, self._back = there, back

    @classmethod
    def fitted(
        cls,
        draws: Array,
        there: Callable[[Array], tuple[Array, Array]],
        back: Callable[[Array], Array],
        *,
        last: bool = False,
    ) -> ProposalInBoth:
        """Fit both to draws ``(n, d)``; their shares are those under which draws are likeliest.

        See :meth:`Proposal.fitted`; the shares by expectation and maximisation as well.
        """
        v, slope = there(draws)
        found = np.isfinite(slope)
        own, straight = (Proposal.fitted(x, last=last) for x in (draws, v[found]))
        made = cls(own, straight, 0.5, there, back)
        some = draws[:: len(draws) // _LOOKED_AT + 1]
        levels = made._levels(some)
        for _ in range(_ROUNDS):
            straights = expit(levels[1] - levels[0]).sum()
            share = float((straights + 1.0) / (len(some) + 2.0))  # neither is ever sure
            levels += np.log([[(1.0 - share) / (1.0 - made.share)], [share / made.share]])
            made.share = share
        return made

    def draw(self, n: int, random: np.random.RandomState) -> Array:
        """Draw ``(n, d)``; what has no way back after a hundred trials is not finite."""
        out, wanted = np.full((n, self.own.dimension), np.nan), np.arange(n)
        for _ in range(_TRIALS):
            bent = random.rand(wanted.size) >= self.share
            out[wanted[bent]] = self.own.draw(int(bent.sum()), random)
            out[wanted[~bent]] = self._back(self.straight.draw(int((~bent).sum()), random))
            wanted = wanted[~np.isfinite(out[wanted]).all(axis=1)]
            if not wanted.size:
                break
        return out

    def log_density(self, x: Array) -> Array:
        """Log of the density at ``(n, d)`` points, ``(n,)``, but for a constant."""
        return np.asarray(np.logaddexp(*self._levels(x)))

    def _levels(self, x: Array) -> Array:
        """Log density of each, its share in it, ``(2, n)``; minus infinity where there is none."""
        v, slope = self._there(x)
        own = self.own.log_density(x) + math.log(1.0 - self.share)
        straight = self.straight.log_density(v) + slope + math.log(self.share)
        return np.where(np.isfinite([own, straight]), [own, straight], -np.inf)


def _mixture(z: Array, components: int, least: float) -> tuple[Array, Array, Array]:
    """Fit normals to white draws ``(n, d)``: weights, means and Cholesky factors."""
    n, d = z.shape
    skewed = (z * np.sum(z**2, axis=1, keepdims=True)).mean(axis=0)
    share = np.eye(components)[:, np.argsort(np.argsort(z @ skewed)) * components // n]
    # densities and moments are both linear in a draw's coordinates and their products
    i, j = np.triu_indices(d)
    terms = np.concatenate([np.ones((1, n)), z.T, z.T[i] * z.T[j]])
    last = -np.inf
    for _ in range(_ROUNDS):
        found = _maximised(share, terms, d)
        share, gained = _expected(found, terms)
        # an empty component would divide by zero in the next round
        if gained - last < least or share.mean(axis=1).min() * n < 2 * d:
            break
        last = gained
    return found


def _maximised(share: Array, terms: Array, d: int) -> tuple[Array, Array, Array]:
    """Give the normals that suit draws best that belong to each by a share, ``(k, n)``."""
    moments = share @ terms.T
    i, j = np.triu_indices(d)
    means = moments[:, 1 : d + 1] / moments[:, :1]
    covariances = np.empty((len(moments), d, d))
    covariances[:, i, j] = covariances[:, j, i] = moments[:, d + 1 :] / moments[:, :1]
    # draws are white, so nothing cancels; a component may not collapse onto a few of them
    covariances += 1e-3 * np.eye(d) - means[:, :, None] * means[:, None, :]
    return moments[:, 0] / terms.shape[1], means, _cholesky(covariances)


def _expected(found: tuple[Array, Array, Array], terms: Array) -> tuple[Array, float]:
    """Give each draw's shares in the normals, ``(k, n)``, and the mean log density."""
    weights, means, roots = found
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
