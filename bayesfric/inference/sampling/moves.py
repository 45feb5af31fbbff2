"""Proposals on emcee's public move interface, for several ensembles in one sampler.

The walkers of one emcee sampler are here several independent ensembles, one after the other:
a step then asks for the density of all of them at once, which costs little more than one
ensemble's. Walkers of different ensembles never see each other.

emcee's own ``DESnookerMove`` and ``GaussianMove`` are not used: in 3.1.6 the
first samples a standard normal with 0.59 of its variance, the second hands every
walker the same step. The tests pin both facts and check every move used here
against exact posteriors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import emcee
import numpy as np
from emcee.moves import Move
from numpy.typing import NDArray

from bayesfric.inference.sampling.proposal import Proposal, ProposalInBoth
from bayesfric.recordings.arrays import Array

Chosen = NDArray[np.bool_]

# Relative sd of the scatter around a step of differential evolution.
_JITTER = 1e-5


class _VectorisedMove(Move):  # type: ignore[misc]
    """Judge all proposals at once; emcee's own moves loop over walkers in Python."""

    def _judge(
        self, model: Any, state: Any, some: NDArray[np.int64], proposed: Array, factors: Array
    ) -> Chosen:
        """Accept or refuse ``(n, d)`` proposals for walkers ``some``; say which, ``(n,)``."""
        # straight to the function: emcee's compute_log_prob unpacks its answer one by one
        density = np.asarray(model.log_prob_fn(proposed))
        if np.isnan(density).any():
            raise ValueError("the log density came out as no number")
        with np.errstate(invalid="ignore"):
            gain = factors + density - state.log_prob[some]
        accepted = gain > np.log(model.random.rand(gain.size))
        taken = some[accepted]
        state.coords[taken] = proposed[accepted]
        state.log_prob[taken] = density[accepted]
        return np.asarray(accepted, dtype=np.bool_)


class DifferentialEvolutionMove(_VectorisedMove):
    """Step along the difference of two walkers of the other half of the same ensemble.

    Differential evolution [1]_, vectorised over walkers. It adapts to the posterior's shape by
    itself.

    ``x + g (x_i - x_j)`` with ``g = 2.38/sqrt(2 d)``, scattered by 1e-5 of itself. One proposal in
    ten takes the whole difference, ``g = 1``, which lets walkers change between separate modes.

    References
    ----------
    .. [1] C. J. F. ter Braak, "A Markov chain Monte Carlo version of the genetic algorithm
       differential evolution", Statistics and Computing 16 (2006) 239-249.
    """

    def __init__(self, ensembles: int = 1) -> None:
        self.ensembles = ensembles

    def propose(self, model: Any, state: Any) -> tuple[Any, Chosen]:
        """Move both halves of every ensemble, one after the other; emcee's interface.

        Shapes: returns (walkers,).
        """
        random = model.random
        total, d = state.coords.shape
        walkers = total // self.ensembles
        first = np.arange(0, total, walkers)[:, None]
        # which walkers make which half is drawn anew in every step
        halves = np.array_split(random.permutation(walkers), 2)
        accepted = np.zeros(total, dtype=bool)
        for own, other in (halves, halves[::-1]):
            some = (first + own).ravel()
            shape = (self.ensembles, own.size)
            i = random.randint(other.size, size=shape)
            j = random.randint(other.size - 1, size=shape)
            j += j >= i
            length = np.where(random.rand(some.size) < 0.1, 1.0, 2.38 / math.sqrt(2.0 * d))
            length *= 1.0 + _JITTER * random.randn(some.size)
            difference = state.coords[first + other[i]] - state.coords[first + other[j]]
            proposed = state.coords[some] + length[:, None] * difference.reshape(-1, d)
            accepted[some] = self._judge(model, state, some, proposed, np.zeros(some.size))
        return state, accepted


class IndependenceMove(_VectorisedMove):
    """Propose from a fixed density, wherever the walker is.

    The proposal is fitted to the warm-up, where it may be replaced between blocks, and then
    frozen: one that went on learning from the chain it drives would not leave the posterior
    invariant.
    """

    def __init__(self, proposal: Proposal | ProposalInBoth) -> None:
        self.proposal = proposal

    def propose(self, model: Any, state: Any) -> tuple[Any, Chosen]:
        """Move all walkers at once, with the Hastings factor of the proposal; emcee's interface."""
        proposed = self.proposal.draw(state.coords.shape[0], model.random)
        factors = self.proposal.log_density(state.coords) - self.proposal.log_density(proposed)
        some = np.arange(state.coords.shape[0])
        return state, self._judge(model, state, some, proposed, factors)


class ElsewhereMove(Move):  # type: ignore[misc]
    """A move made in other coordinates, where the posterior is of another shape.

    Shapes: ``there`` (n, d).
    """

    def __init__(
        self,
        move: Move,
        there: Callable[[Array], tuple[Array, Array]],
        back: Callable[[Array], Array],
    ) -> None:
        self.move, self._there, self._back = move, there, back

    def propose(self, model: Any, state: Any) -> tuple[Any, Chosen]:
        """Move walkers there, by the density there, and bring them back; emcee's interface."""
        coords, slope = self._there(state.coords)
        # a walker that has no place there, so far out is it, takes any step
        with np.errstate(invalid="ignore"):
            height = np.where(np.isfinite(slope), state.log_prob - slope, -np.inf)
        away = emcee.State(coords, log_prob=height)
        gone, accepted = self.move.propose(model._replace(log_prob_fn=self._density(model)), away)
        moved = np.flatnonzero(accepted)
        if moved.size:
            state.coords[moved] = self._back(gone.coords[moved])
            state.log_prob[moved] = gone.log_prob[moved] + self._there(state.coords[moved])[1]
        return state, accepted

    def _density(self, model: Any) -> Callable[[Array], Array]:
        """Give the log density there: the one here, less the log Jacobian of going there."""

        def density(v: Array) -> Array:
            u, out = self._back(v), np.full(len(v), -np.inf)
            possible = np.flatnonzero(np.isfinite(u).all(axis=1))
            slope = self._there(u[possible])[1]
            possible, slope = possible[np.isfinite(slope)], slope[np.isfinite(slope)]
            if possible.size:
                out[possible] = model.log_prob_fn(u[possible]) - slope
            return out

        return density
