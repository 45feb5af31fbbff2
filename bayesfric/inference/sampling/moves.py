"""Proposals on emcee's public move interface, for several ensembles in one sampler.

The walkers of one emcee sampler are several independent ensembles, one after the other: evaluating
all together costs little more than one ensemble. Walkers of different ensembles never interact.

emcee's own ``DESnookerMove`` and ``GaussianMove`` are not used: in 3.1.6 the first samples a
standard normal with 0.59 of its variance, the second gives every walker the same step. The tests
pin both facts and check every move used here against exact posteriors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import emcee
import numpy as np
from emcee.moves import Move
from numpy.typing import NDArray

from bayesfric.inference.sampling.proposal import MixedProposal, Proposal
from bayesfric.recordings.arrays import Array

Chosen = NDArray[np.bool_]

# Relative standard deviation of the jitter of a differential evolution step.
_JITTER = 1e-5


class _VectorisedMove(Move):  # type: ignore[misc]
    """Judge all proposals at once; emcee's moves loop over walkers in Python."""

    def _judge(
        self, model: Any, state: Any, walkers: NDArray[np.int64], proposed: Array, factors: Array
    ) -> Chosen:
        """Accept or reject proposals ``(n, d)`` for walkers ``(n,)``; return flags ``(n,)``."""
        # emcee's compute_log_prob would unpack the values one by one
        density = np.asarray(model.log_prob_fn(proposed))
        if np.isnan(density).any():
            raise ValueError("the log density is nan")
        with np.errstate(invalid="ignore"):
            gain = factors + density - state.log_prob[walkers]
        accepted = gain > np.log(model.random.rand(gain.size))
        moved = walkers[accepted]
        state.coords[moved] = proposed[accepted]
        state.log_prob[moved] = density[accepted]
        return np.asarray(accepted, dtype=np.bool_)


class DifferentialEvolutionMove(_VectorisedMove):
    """Step along the difference of two walkers of the other half of the same ensemble.

    Differential evolution (ter Braak, Statistics and Computing 16 (2006) 239-249), vectorised: ``x
    + g (x_i - x_j)`` with ``g = 2.38/sqrt(2 d)``, jittered by 1e-5. One proposal in ten has ``g =
    1``, which lets walkers change between separate modes.
    """

    def __init__(self, ensembles: int = 1) -> None:
        self.ensembles = ensembles

    def propose(self, model: Any, state: Any) -> tuple[Any, Chosen]:
        """Move both halves of every ensemble, one after the other."""
        random = model.random
        total, d = state.coords.shape
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
            length *= 1.0 + _JITTER * random.randn(walkers.size)
            difference = state.coords[first + other[i]] - state.coords[first + other[j]]
            proposed = state.coords[walkers] + length[:, None] * difference.reshape(-1, d)
            accepted[walkers] = self._judge(model, state, walkers, proposed, np.zeros(walkers.size))
        return state, accepted


class IndependenceMove(_VectorisedMove):
    """Propose from a fixed density, independent of the walker's position.

    The proposal may be replaced between blocks of the warm-up; then it is frozen, as an adaptive
    one would not leave the posterior invariant.
    """

    def __init__(self, proposal: Proposal | MixedProposal) -> None:
        self.proposal = proposal

    def propose(self, model: Any, state: Any) -> tuple[Any, Chosen]:
        """Move all walkers at once, with the Hastings factor of the proposal."""
        proposed = self.proposal.draw(state.coords.shape[0], model.random)
        factors = self.proposal.log_density(state.coords) - self.proposal.log_density(proposed)
        walkers = np.arange(state.coords.shape[0])
        return state, self._judge(model, state, walkers, proposed, factors)


class TransformedMove(Move):  # type: ignore[misc]
    """A move made in other coordinates, mapped ``forward`` and by its ``inverse``."""

    def __init__(
        self,
        move: Move,
        forward: Callable[[Array], tuple[Array, Array]],
        inverse: Callable[[Array], Array],
    ) -> None:
        self.move, self._forward, self._inverse = move, forward, inverse

    def propose(self, model: Any, state: Any) -> tuple[Any, Chosen]:
        """Move walkers in the other coordinates, and map them back."""
        coords, slope = self._forward(state.coords)
        # a walker without a finite image accepts any step
        with np.errstate(invalid="ignore"):
            log_density = np.where(np.isfinite(slope), state.log_prob - slope, -np.inf)
        transformed = emcee.State(coords, log_prob=log_density)
        moved_state, accepted = self.move.propose(
            model._replace(log_prob_fn=self._density(model)), transformed
        )
        moved = np.flatnonzero(accepted)
        if moved.size:
            state.coords[moved] = self._inverse(moved_state.coords[moved])
            state.log_prob[moved] = (
                moved_state.log_prob[moved] + self._forward(state.coords[moved])[1]
            )
        return state, accepted

    def _density(self, model: Any) -> Callable[[Array], Array]:
        """Return the log density in the other coordinates."""

        def density(v: Array) -> Array:
            u, out = self._inverse(v), np.full(len(v), -np.inf)
            possible = np.flatnonzero(np.isfinite(u).all(axis=1))
            slope = self._forward(u[possible])[1]
            possible, slope = possible[np.isfinite(slope)], slope[np.isfinite(slope)]
            if possible.size:
                out[possible] = model.log_prob_fn(u[possible]) - slope
            return out

        return density
