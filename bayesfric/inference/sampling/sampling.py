"""Sampling with emcee: independent ensembles, run until they agree.

An ensemble sampler needs no gradient, which the kinks of direction-dependent friction would
mislead, and asks for the density of all walkers at once [1]_. The moves are differential evolution
and an independence move; several independent ensembles show whether the posterior was found.

References
----------
.. [1] D. Foreman-Mackey, D. W. Hogg, D. Lang, J. Goodman, "emcee: the MCMC hammer", Publications
   of the Astronomical Society of the Pacific 125 (2013) 306-312.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass

import emcee
import numpy as np
from pydantic import Field
from scipy import stats
from threadpoolctl import threadpool_limits

from bayesfric.base.options import Options
from bayesfric.base.progress import Progress, Shown, silent
from bayesfric.inference.posterior import Diagnostics, Posterior, Status
from bayesfric.inference.sampling import convergence
from bayesfric.inference.sampling.convergence import LONG_ENOUGH, few, hopeless, nested_rhat
from bayesfric.inference.sampling.moves import (
    DifferentialEvolutionMove,
    ElsewhereMove,
    IndependenceMove,
)
from bayesfric.inference.sampling.proposal import Proposal, ProposalInBoth
from bayesfric.inference.sampling.start import Start
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array

# Ensembles further apart than this are not sampling one distribution.
_UNUSABLE_RHAT = 1.1
# Ensembles in warm-up that agree like this may be sampled from.
_WARM_RHAT = 1.05
# Slowest parameters that are named.
_NAMED = 4
# Blocks of warm-up at least, so that the proposal has learned from what it proposed.
_LEAST_BLOCKS = 3
# What one more block may teach the proposal, in units of log density, where it has learned enough:
# two densities so far apart share at least four fifths of their mass (Pinsker).
_LEARNED = 0.08
# Blocks after which what is not done learns once more, from all of them, in whose tails a proposal
# from warm-up is too thin; then twice as many.
_RELEARNED = 6
# Share of the steps that go where the walkers are, for what no proposal has learned.
_OTHERWISE = 0.2
_UNSETTLED = (
    "warm-up was still moving when it was cut off: raise sampling.max_steps, or give narrower "
    "priors"
)
# Share of the proposals that may have no likelihood. Most are made of the posterior's own shape, so
# about this share of it may be missing, and the tail beyond an end of a 90 % interval, 5 %, may be
# off by as much. Below this it drowns in what chance leaves: 2000 independent draws know that tail
# to 0.5 %. Warm-up starts far out on purpose, and what it meets there says nothing.
TROUBLE = 0.01
_STUCK = (
    "{} of {} walkers never moved, and are left out of every interval: look at the trace; try "
    "another sampling.seed, or narrower priors"
)
_UNDEFINED = (
    "at {:.2g} % of the places beside the posterior the likelihood is no number; they count as "
    "impossible: check units and columns of the recordings with 'bayesfric check', and do not "
    "trust the intervals"
)
# Draws kept in the result, over all walkers; more only makes the file larger.
_KEPT_DRAWS = 20_000


class Sampling(Options):
    """How the posterior is sampled; ``[sampling]`` in a configuration."""

    seed: int = Field(1, ge=0, lt=2**63, description="everything random comes from this number")
    ensembles: int = Field(4, ge=2, le=64, description="independent groups of walkers")
    walkers: int | None = Field(
        None,
        ge=8,
        le=10_000,
        description="walkers in each ensemble; default 3 for each parameter, at least 32, or "
        "64 where the likelihood is cheap",
    )
    min_ess: float = Field(
        2000.0,  # ends of 90 % intervals to a twentieth of an sd
        gt=0,
        le=1e8,
        description="independent draws wanted of every parameter",
    )
    max_rhat: float = Field(
        1.01,
        gt=1,
        le=2,
        description="largest nested R-hat accepted",
    )
    max_steps: int = Field(
        20_000,
        ge=100,
        le=10_000_000,
        description="steps after which sampling gives up; sooner where it cannot converge in "
        "twice as many",
    )


def sample(
    target: Target,
    start: Start,
    settings: Sampling,
    *,
    progress: Shown = silent,
) -> Posterior:
    """Sample until every criterion of ``settings`` is met or ``max_steps`` is reached.

    It stops sooner where looks at it predict that ensembles would neither agree nor have
    forgotten their past in twice the steps allowed.

    Warm-up from over-dispersed starts mixes differential evolution with an independence move
    whose proposal, a mixture of normals, learns from it, until the ensembles agree
    roughly and nothing climbs or spreads any more. Then the proposal is fitted once
    more and frozen. Only steps after that count; where they do not do, all of them are warm-up
    for another proposal.
    """
    began = time.perf_counter()
    d = target.dimension
    # emcee refuses fewer than two walkers a dimension
    least = 64 if target.likelihood.fast else 32
    walkers = max(settings.walkers or max(least, 3 * d), 2 * d)
    walkers += walkers % 2
    for_emcee, for_starts = np.random.SeedSequence(settings.seed).spawn(2)
    random = np.random.RandomState(np.random.MT19937(for_emcee))
    rng = np.random.default_rng(for_starts)
    # Every ensemble around a point of its own, the points further apart than its walkers:
    # only then does nested R-hat, which compares ensembles, say anything.
    centres = start.draw(settings.ensembles, target, rng, spread=2.0)
    around = (Start(centre, start.covariance) for centre in centres)
    positions = np.stack([one.draw(walkers, target, rng, spread=0.5) for one in around])
    # The normal at the mode to begin with, then whatever the walkers have found: until it is
    # frozen the proposal may learn, because none of these steps count.
    learning = IndependenceMove(Proposal.normal(start.mode, start.covariance))
    moves = [(learning, 0.5), *_searching(target, settings, learning.proposal, 0.5)]
    warm = _Ensembles(target, moves, positions, random)
    # threads that share a small matrix wait for each other: on two busy cores seven times the work
    with threadpool_limits(1, "blas"):
        half, settled = _warm_up(warm, learning, settings, rng, progress)
        # Where the posterior really lies, a likelihood can be prepared best.
        states = half.reshape(-1, d)
        target = target.precomputed(states[:: max(1, len(states) // 500)])
        learned, last, warmup, most = half, warm, warm.steps, _RELEARNED * _block(target, settings)
        while True:
            frozen = IndependenceMove(_fitted(target, learned, last=True))
            moves = [(frozen, 1.0 - _OTHERWISE)]
            moves += _searching(target, settings, frozen.proposal, _OTHERWISE)
            main = _Ensembles(target, moves, last.positions(), random)
            before, left = target.not_finite, settings.max_steps - warmup
            # where there is time for twice as many steps as are thrown away
            look = _walk(main, settings, most if 3 * most <= left else left, progress)
            if look.done or look.hopeless or main.steps >= left:
                break
            learned, last, warmup, most = main.chain(), main, warmup + main.steps, 2 * most

    return _concluded(main, look, settings, warmup, began, settled=settled, before=before)


def _concluded(
    main: _Ensembles,
    look: _Look,
    settings: Sampling,
    warmup: int,
    began: float,
    *,
    settled: bool,
    before: int,
) -> Posterior:
    """Thin what was sampled since ``began``, and say whether it can be trusted.

    ``before`` counts the places without a likelihood until the ``warmup`` steps had ended.
    """
    target, walkers = main.target, main.acceptance().shape[1]
    wanted = max(_KEPT_DRAWS, 2 * int(settings.min_ess))
    thin = min(max(1, main.steps * walkers * settings.ensembles // wanted), main.steps)
    kept = main.chain()[:, :, thin - 1 :: thin]
    draws = target.to_parameters(kept.reshape(-1, kept.shape[-1]))[0].reshape(kept.shape)
    acceptance = main.acceptance()
    problems = list(_problems(target, settings, look, main, draws))
    if look.hopeless and acceptance.any():
        steps = warmup + main.steps
        problems.insert(0, _given_up(target.names, look.needed, steps, settings.max_steps))
    if not settled:
        problems.append(_UNSETTLED)
    share = (target.not_finite - before) / (main.steps * settings.ensembles * walkers)
    stuck = acceptance == 0.0
    warnings = [_STUCK.format(stuck.sum(), stuck.size)] if stuck.any() and few(stuck) else []
    if share >= TROUBLE:
        warnings.append(_UNDEFINED.format(100 * share))
    return Posterior(
        names=target.names,
        priors=target.priors,
        draws=draws,
        log_density=main.log_density()[:, :, thin - 1 :: thin],
        diagnostics=Diagnostics(
            status=look.status if problems else "reliable",
            problems=tuple(problems),
            rhat=look.rhat,
            tau=look.tau,
            ess=look.ess,
            acceptance=acceptance,
            ensembles=settings.ensembles,
            walkers=walkers,
            warmup=warmup,
            steps=main.steps,
            thin=thin,
            not_finite=target.not_finite,
            seconds=time.perf_counter() - began,
            not_finite_share=share,
            warnings=tuple(warnings),
            max_rhat=settings.max_rhat,
        ),
        seed=settings.seed,
    )


def _block(target: Target, settings: Sampling) -> int:
    """Count the steps between two looks."""
    usual = 50 if target.likelihood.method == "input-error" else 25
    return min(usual, max(settings.max_steps // 8, 10))


def _warm_up(
    warm: _Ensembles,
    learning: IndependenceMove,
    settings: Sampling,
    rng: np.random.Generator,
    progress: Shown,
) -> tuple[Array, bool]:
    """Walk and learn; give the second half of the steps, and whether they had settled."""
    block, most = _block(warm.target, settings), settings.max_steps // 4
    seen: list[tuple[int, float]] = []
    taught = math.inf
    while True:
        warm.run(block)
        warm.bring_back_lost(rng)
        progress(Progress("warm-up", warm.steps))
        half = warm.chain()[:, :, warm.steps // 2 :]
        old, learning.proposal = learning.proposal, _fitted(warm.target, half, last=False)
        newest = half[:, :, -block:].reshape(-1, warm.target.dimension)
        gained = learning.proposal.log_density(newest) - old.log_density(newest)
        before, taught = taught, float(gained.mean())
        rhats = nested_rhat(half)
        agree = warm.steps >= _LEAST_BLOCKS * block and rhats.max() < _WARM_RHAT
        # a shape that no proposal can learn teaches every block as much
        settled = agree and warm.settled() and not _LEARNED < taught < before
        needed = convergence.steps_needed(warm.steps, len(half), rhats, _WARM_RHAT)
        seen.append((warm.steps, float(needed.max())))
        if settled or warm.steps >= most or hopeless(seen, most):
            return half, settled


@dataclass(frozen=True, eq=False)
class _Look:
    """What the steps so far are worth: diagnostics ``(d,)`` and steps needed, ``(d,)``."""

    rhat: Array
    tau: Array
    ess: Array
    needed: Array
    hopeless: bool
    done: bool

    @property
    def status(self) -> Status:
        """What they are good for where a criterion is not met."""
        usable = self.rhat.max() < _UNUSABLE_RHAT and np.isfinite(self.ess).all()
        return "tentative" if usable and self.ess.min() > 100.0 else "unusable"


def _walk(main: _Ensembles, settings: Sampling, most: int, progress: Shown) -> _Look:
    """Walk until every criterion is met, the steps are used up or it is hopeless."""
    block, seen, enough = _block(main.target, settings), [], math.inf
    while True:
        # looks at growing distances: a stopping rule asked too often stops by luck; but nearer
        # where the last one predicted that less is enough
        ahead = max(block, main.steps // 3)
        if enough < main.steps + ahead:
            ahead = max(block // 2, math.ceil(enough) - main.steps)
        main.run(min(ahead, most - main.steps))
        moving = convergence.without_stuck(main.chain(), main.acceptance())
        rhats, tau = nested_rhat(moving), convergence.autocorrelation_time(moving)
        ess = convergence.effective_sample_size(moving, tau)
        progress(Progress("sampling", main.steps, float(ess.min()), float(rhats.max())))
        done = (
            ess.min() >= settings.min_ess
            and rhats.max() <= settings.max_rhat
            and len(moving) * main.steps >= LONG_ENOUGH * tau.max()
        )
        needed = convergence.steps_needed(main.steps, len(moving), rhats, settings.max_rhat, tau)
        enough = float(needed.max())
        seen.append((main.steps, enough))
        lost = not done and hopeless(seen, most)
        if done or lost or main.steps >= most:
            return _Look(rhats, tau, ess, needed, lost, done)


class _Ensembles:
    """Several independent ensembles in one emcee sampler, and what they have walked so far."""

    def __init__(
        self,
        target: Target,
        moves: list[tuple[emcee.moves.Move, float]],
        positions: Array,
        random: np.random.RandomState,
    ) -> None:
        self.steps = 0
        self.target, self._shape = target, positions.shape
        ensembles, walkers, d = positions.shape
        self._sampler = emcee.EnsembleSampler(
            ensembles * walkers, d, target, moves=moves, vectorize=True
        )
        # emcee's wrapper prints a traceback of whatever ends the density, Ctrl-C included
        self._sampler.log_prob_fn = target
        # emcee silently ignores any other way of seeding it
        self._sampler.random_state = random.get_state()
        self._state = emcee.State(positions.reshape(-1, d))
        self._random = random

    def run(self, steps: int) -> None:
        """Go so many steps further."""
        self._state = self._sampler.run_mcmc(self._state, steps, skip_initial_state_check=True)
        self.steps += steps
        # so that what comes next goes on where this stream ends
        self._random.set_state(self._sampler.random_state)

    def bring_back_lost(self, rng: np.random.Generator) -> None:
        """Move walkers that hang on to a hopelessly improbable mode next to the others.

        Only during warm-up. A mode whose log density is this far below the best
        holds no mass worth counting, but a walker can stay in it for ever.
        """
        ensembles, _, d = self._shape
        coords, heights = self.positions(), self._state.log_prob.reshape(ensembles, -1)
        lost = heights < heights.max() - stats.chi2.isf(1e-12, d) / 2.0
        if not lost.any():
            return
        for own, gone in zip(coords, lost, strict=True):
            pool = own[~gone] if np.count_nonzero(~gone) >= 3 else coords[~lost]
            if pool.shape[0] < 3:
                continue
            # beside one sound walker, in the direction of a difference of two others
            first, second, third = (rng.integers(pool.shape[0], size=gone.sum()) for _ in range(3))
            own[gone] = pool[first] + 0.1 * (pool[second] - pool[third])
        self._state = emcee.State(coords.reshape(-1, d), random_state=self._state.random_state)

    def settled(self) -> bool:
        """Whether over the second half of the steps nothing climbs, shrinks or spreads."""
        third, fourth = np.array_split(self.log_density()[:, :, self.steps // 2 :], 2, axis=2)
        climbing = abs(fourth.mean() - third.mean()) > 0.25 * fourth.std()
        quarters = np.array_split(self.chain()[:, :, self.steps // 2 :], 2, axis=2)
        before, after = (x.reshape(-1, self._shape[2]).std(axis=0) for x in quarters)
        return not (climbing or np.abs(np.log(after / before)).max() > 0.2)

    def chain(self) -> Array:
        """All steps, ``(ensembles, walkers, steps, d)``."""
        chain = self._sampler.get_chain()
        return np.asarray(np.moveaxis(chain.reshape(-1, *self._shape), 0, 2))

    def log_density(self) -> Array:
        """``(ensembles, walkers, steps)``."""
        density = self._sampler.get_log_prob()
        return np.asarray(np.moveaxis(density.reshape(-1, *self._shape[:2]), 0, 2))

    def positions(self) -> Array:
        """Where the walkers are, ``(ensembles, walkers, d)``."""
        return np.array(self._state.coords).reshape(self._shape)

    def acceptance(self) -> Array:
        """Give the accepted share of each walker's proposals, ``(ensembles, walkers)``."""
        return np.asarray(self._sampler.acceptance_fraction).reshape(self._shape[:2])


def _fitted(target: Target, half: Array, *, last: bool) -> Proposal | ProposalInBoth:
    """Fit a proposal to steps ``(ensembles, walkers, n, d)``; also where the target is straight."""
    draws = half.reshape(-1, target.dimension)
    if not target.coordinates.is_nonlinear:
        return Proposal.fitted(draws, last=last)
    return ProposalInBoth.fitted(draws, target.to_linear, target.from_linear, last=last)


def _searching(
    target: Target, settings: Sampling, proposal: Proposal | ProposalInBoth, share: float
) -> list[tuple[emcee.moves.Move, float]]:
    """Make the moves that go where the walkers are, in whichever coordinates a proposal suits."""
    search = DifferentialEvolutionMove(settings.ensembles)
    if not target.coordinates.is_nonlinear:
        return [(search, share)]
    straight = proposal.share if isinstance(proposal, ProposalInBoth) else 0.5
    there = ElsewhereMove(search, target.to_linear, target.from_linear)
    return [(search, share * (1.0 - straight)), (there, share * straight)]


def _problems(
    target: Target, settings: Sampling, look: _Look, main: _Ensembles, draws: Array
) -> Iterator[str]:
    """Say in one sentence each, with a hint, which criteria of the settings a run does not meet.

    Stuck walkers, ensembles that disagree, too few independent draws, a run that is too short.
    """
    rhat, tau, ess = look.rhat, look.tau, look.ess
    names = np.array(target.names)
    moved = main.acceptance()
    if not moved.any():
        yield (
            "no walker ever moved: not one proposal was accepted, and there is nothing to make an "
            "interval of; check the recording's units, or give wider priors"
        )
        return
    if not few(moved == 0.0):
        yield _STUCK.format(np.count_nonzero(moved == 0.0), moved.size)
    apart = names[rhat > settings.max_rhat]
    if apart.size:
        worst = int(rhat.argmax())
        medians = ", ".join(f"{x:.4g}" for x in np.median(draws[..., worst], axis=(1, 2)))
        yield (
            f"the ensembles disagree on {', '.join(apart)} (nested R-hat up to {rhat.max():.3f}; "
            f"their medians of {names[worst]}: {medians}): raise sampling.max_steps, or give "
            "these parameters narrower priors"
        )
    short = names[ess < settings.min_ess]
    # a walker that never moves leaves no draws to count, and more steps do not mend that
    if short.size and np.isfinite(tau).all():
        yield (
            f"only {ess.min():.0f} independent draws of {names[int(ess.argmin())]} where "
            f"{settings.min_ess:.0f} were wanted: raise sampling.max_steps"
        )
    long = len(draws) * main.steps / tau.max()
    if not short.size and long < LONG_ENOUGH:
        yield (
            f"the run is only {long:.0f} autocorrelation times long, "
            f"{LONG_ENOUGH:g} are needed to trust them: raise sampling.max_steps"
        )


def _given_up(names: tuple[str, ...], needed: Array, steps: int, max_steps: int) -> str:
    """Say that a run was stopped because it could not converge, and what holds it up."""
    slowest = np.argsort(-needed, kind="stable")[:_NAMED]
    slow = [names[j] for j in slowest if needed[j] > max_steps]
    worst = needed.max()
    would = f"about {float(f'{worst:.1g}'):.0f}" if np.isfinite(worst) else "endless"
    return (
        f"stopped after {steps} steps: at this pace it would need {would} steps, "
        f"sampling.max_steps is {max_steps}; slowest are {', '.join(slow)}: give them "
        "narrower priors, or fix what is known"
    )
