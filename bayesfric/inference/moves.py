"""Proposals on emcee's public move interface.

emcee's own ``DESnookerMove`` and ``GaussianMove`` are not used: in 3.1.6 the
first samples a standard normal with 0.59 of its variance, the second hands every
walker the same step. The tests pin both facts and check every move used here
against exact posteriors.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from emcee.moves import RedBlueMove
from numpy.typing import NDArray
from scipy.special import gammaln


class DifferentialEvolutionMove(RedBlueMove):  # type: ignore[misc]
    """Step along the difference of two walkers of the other half.

    ter Braak (2006), vectorised over walkers. One proposal in ten takes the whole
    difference, which lets walkers change between separate modes.

    Parameters
    ----------
    jitter
        Relative standard deviation of the scatter around the step length.
    """

    def __init__(self, jitter: float = 1e-5, **options: Any) -> None:
        super().__init__(**options)
        self.jitter = jitter

    def get_proposal(
        self,
        sample: NDArray[np.float64],
        complement: list[NDArray[np.float64]],
        random: np.random.RandomState,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Propose for every walker of one half, ``(n, d)``; factors are zero."""
        others = np.concatenate(complement, axis=0)
        n, d = sample.shape
        first = random.randint(others.shape[0], size=n)
        second = random.randint(others.shape[0] - 1, size=n)
        second += second >= first
        length = np.where(random.rand(n) < 0.1, 1.0, 2.38 / math.sqrt(2.0 * d))
        length = length * (1.0 + self.jitter * random.randn(n))
        return sample + length[:, None] * (others[first] - others[second]), np.zeros(n)


class IndependenceMove(RedBlueMove):  # type: ignore[misc]
    """Propose from a fixed multivariate t, wherever the walker is.

    The proposal is fitted to the warm-up and then frozen: a proposal that went on
    learning from the chain it drives would not leave the posterior invariant.

    Parameters
    ----------
    mean
        ``(d,)``
    covariance
        ``(d, d)``, of the draws the proposal is fitted to.
    degrees
        Degrees of freedom; heavier tails than a normal keep weights bounded.
    """

    def __init__(
        self,
        mean: NDArray[np.float64],
        covariance: NDArray[np.float64],
        degrees: float = 10.0,
        **options: Any,
    ) -> None:
        super().__init__(**options)
        self.mean = mean
        self.degrees = degrees
        self.root = np.linalg.cholesky(np.asarray(covariance, dtype=np.float64))
        # a product with a small inverse is far cheaper than a solve at every step
        self._whiten = np.linalg.inv(self.root)

    def draw(self, n: int, random: np.random.RandomState) -> NDArray[np.float64]:
        """Draw ``(n, d)`` from the proposal."""
        d = self.mean.size
        stretch = np.sqrt(self.degrees / random.chisquare(self.degrees, size=n))
        return self.mean + stretch[:, None] * (random.randn(n, d) @ self.root.T)

    def log_density(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Log of the proposal's density at ``(n, d)`` points."""
        d, nu = self.mean.size, self.degrees
        z = self._whiten @ (x - self.mean).T
        constant = (
            gammaln((nu + d) / 2.0)
            - gammaln(nu / 2.0)
            - d / 2.0 * math.log(nu * math.pi)
            - float(np.log(np.diag(self.root)).sum())
        )
        density: NDArray[np.float64] = constant - (nu + d) / 2.0 * np.log1p((z**2).sum(axis=0) / nu)
        return density

    def get_proposal(
        self,
        sample: NDArray[np.float64],
        complement: list[NDArray[np.float64]],  # noqa: ARG002  (emcee's interface)
        random: np.random.RandomState,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Propose for every walker of one half, with the Hastings factor of the proposal."""
        proposed = self.draw(sample.shape[0], random)
        return proposed, self.log_density(sample) - self.log_density(proposed)
