"""Sampling with emcee: independent ensembles, run until they agree.

An ensemble sampler needs no gradient, which the kinks of direction-dependent friction would
mislead, and evaluates all walkers at once (Foreman-Mackey, Hogg, Lang and Goodman, "emcee: the MCMC
hammer", Publications of the Astronomical Society of the Pacific 125 (2013) 306-312). Moves are
differential evolution and an independence move; several ensembles show whether the posterior was
found.
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
from bayesfric.base.progress import Progress, ProgressCallback, no_progress
from bayesfric.inference.posterior import Diagnostics, Posterior, Status
from bayesfric.inference.sampling import convergence
from bayesfric.inference.sampling.convergence import LONG_ENOUGH, hopeless, negligible, nested_rhat
from bayesfric.inference.sampling.moves import (
    DifferentialEvolutionMove,
    IndependenceMove,
    TransformedMove,
)
from bayesfric.inference.sampling.proposal import MixedProposal, Proposal
from bayesfric.inference.sampling.start import Start
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array

# R-hat above which a sample is unusable.
_UNUSABLE_RHAT = 1.1
# R-hat below which warm-up may end.
_WARM_RHAT = 1.05
# Number of slowest parameters in a message.
_NAMED_PARAMETERS = 4
# Least number of blocks of warm-up, so that the proposal has learned from its own draws.
_LEAST_BLOCKS = 3
# Gain of the proposal's log density by another block below which it has converged: two densities so
# close share at least four fifths of their mass (Pinsker).
_LEARNING_GAIN = 0.08
# Blocks after which the proposal is refitted to all of them, as one from warm-up may be too thin in
# the tails; then twice as many.
_REFIT_BLOCKS = 6
# Share of differential evolution among the steps, for shapes that the proposal misses.
_SEARCH_SHARE = 0.2
_STILL_MOVING = (
    "warm-up was still moving when it was cut off: raise sampling.max_steps, or give narrower "
    "priors"
)
# Share of proposals without a likelihood that is reported. About this share of the posterior may be
# missing, and the 5 % tail beyond an end of a 90 % interval off by as much; 2000 independent draws
# give that tail to 0.5 %. Warm-up starts far out and does not count.
TROUBLE = 0.01
_STUCK = (
    "{} of {} walkers never moved, and are left out of every interval: look at the trace; try "
    "another sampling.seed, or narrower priors"
)
_NOT_FINITE = (
    "at {:.2g} % of the proposals the likelihood is not finite; they count as impossible: check "
    "units and columns of the recordings with 'bayesfric check', and do not trust the intervals"
)
# Draws kept in the result.
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
        "64 where the likelihood is fast",
    )
    min_ess: float = Field(
        2000.0,  # ends of 90 % intervals to a twentieth of an sd
        gt=0,
        le=1e8,
        description="independent draws wanted of every parameter",
    )
    max_rhat: float = Field(1.01, gt=1, le=2, description="largest nested R-hat accepted")
    max_steps: int = Field(
        20_000,
        ge=100,
        le=10_000_000,
        description="steps after which sampling gives up; sooner where it cannot converge in "
        "twice as many",
    )


def sample(
    target: Target, start: Start, settings: Sampling, *, progress: ProgressCallback = no_progress
) -> Posterior:
    """Sample until every criterion of ``settings`` is met or ``max_steps`` is reached.

    It stops early if it is predicted not to converge in twice the allowed steps. Warm-up from
    over-dispersed starts adapts the independence move's proposal until the ensembles roughly agree;
    then the proposal is refitted and frozen, and only later steps count. If they do not suffice,
    they are warm-up of another proposal.
    """
    started = time.perf_counter()
    d = target.dimension
    # emcee refuses fewer than two walkers a dimension
    minimum = 64 if target.likelihood.fast else 32
    walkers = max(settings.walkers or max(minimum, 3 * d), 2 * d)
    walkers += walkers % 2
    for_emcee, for_starts = np.random.SeedSequence(settings.seed).spawn(2)
    random = np.random.RandomState(np.random.MT19937(for_emcee))
    rng = np.random.default_rng(for_starts)
    # Ensembles start further apart than their walkers, else nested R-hat is meaningless.
    centres = start.draw(settings.ensembles, target, rng, spread=2.0)
    clouds = (Start(centre, start.covariance) for centre in centres)
    positions = np.stack([cloud.draw(walkers, target, rng, spread=0.5) for cloud in clouds])
    # The proposal may adapt until it is frozen, as no step counts before.
    adaptive = IndependenceMove(Proposal.normal(start.mode, start.covariance))
    moves = [(adaptive, 0.5), *_search_moves(target, settings, adaptive.proposal, 0.5)]
    warm = _Ensembles(target, moves, positions, random)
    # BLAS threads contend on small matrices: seven times slower on two busy cores
    with threadpool_limits(1, "blas"):
        second_half, settled = _warm_up(warm, adaptive, settings, rng, progress)
        # precompute the likelihood where the posterior lies
        states = second_half.reshape(-1, d)
        target = target.precomputed(states[:: max(1, len(states) // 500)])
        training, previous, warmup = second_half, warm, warm.steps
        limit = _REFIT_BLOCKS * _block_steps(target, settings)
        while True:
            frozen = IndependenceMove(_fit_proposal(target, training, last=True))
            moves = [(frozen, 1.0 - _SEARCH_SHARE)]
            moves += _search_moves(target, settings, frozen.proposal, _SEARCH_SHARE)
            main = _Ensembles(target, moves, previous.positions(), random)
            before, remaining = target.not_finite, settings.max_steps - warmup
            # if at least twice the steps remain that a refit would discard
            steps = limit if 3 * limit <= remaining else remaining
            checked = _run_until_converged(main, settings, steps, progress)
            if checked.done or checked.hopeless or main.steps >= remaining:
                break
            training, previous, warmup = main.chain(), main, warmup + main.steps
            limit *= 2

    return _posterior(main, checked, settings, warmup, started, settled=settled, before=before)


def _posterior(
    main: _Ensembles,
    checked: _Convergence,
    settings: Sampling,
    warmup: int,
    started: float,
    *,
    settled: bool,
    before: int,
) -> Posterior:
    """Thin the chain and collect its diagnostics.

    ``before`` counts non-finite values until warm-up ended.
    """
    target, walkers = main.target, main.acceptance().shape[1]
    kept_draws = max(_KEPT_DRAWS, 2 * int(settings.min_ess))
    thin = min(max(1, main.steps * walkers * settings.ensembles // kept_draws), main.steps)
    thinned = main.chain()[:, :, thin - 1 :: thin]
    draws = target.to_parameters(thinned.reshape(-1, thinned.shape[-1]))[0].reshape(thinned.shape)
    acceptance = main.acceptance()
    problems = list(_problems(target, settings, checked, main, draws))
    if checked.hopeless and acceptance.any():
        steps = warmup + main.steps
        problems.insert(0, _not_converging(target.names, checked.needed, steps, settings.max_steps))
    if not settled:
        problems.append(_STILL_MOVING)
    share = (target.not_finite - before) / (main.steps * settings.ensembles * walkers)
    stuck = acceptance == 0.0
    warnings = [_STUCK.format(stuck.sum(), stuck.size)] if stuck.any() and negligible(stuck) else []
    if share >= TROUBLE:
        warnings.append(_NOT_FINITE.format(100 * share))
    return Posterior(
        names=target.names,
        priors=target.priors,
        draws=draws,
        log_density=main.log_density()[:, :, thin - 1 :: thin],
        diagnostics=Diagnostics(
            status=checked.status if problems else "reliable",
            problems=tuple(problems),
            rhat=checked.rhat,
            tau=checked.tau,
            ess=checked.ess,
            acceptance=acceptance,
            ensembles=settings.ensembles,
            walkers=walkers,
            warmup=warmup,
            steps=main.steps,
            thin=thin,
            not_finite=target.not_finite,
            seconds=time.perf_counter() - started,
            not_finite_share=share,
            warnings=tuple(warnings),
            max_rhat=settings.max_rhat,
        ),
        seed=settings.seed,
    )


def _block_steps(target: Target, settings: Sampling) -> int:
    """Return the number of steps between two checks."""
    usual = 50 if target.likelihood.method == "input-error" else 25
    return min(usual, max(settings.max_steps // 8, 10))


def _warm_up(
    warm: _Ensembles,
    learning: IndependenceMove,
    settings: Sampling,
    rng: np.random.Generator,
    progress: ProgressCallback,
) -> tuple[Array, bool]:
    """Run and adapt; return the second half of the steps, and whether they settled."""
    block, limit = _block_steps(warm.target, settings), settings.max_steps // 4
    predictions: list[tuple[int, float]] = []
    gain = math.inf
    while True:
        warm.run(block)
        warm.bring_back_lost(rng)
        progress(Progress("warm-up", warm.steps))
        second_half = warm.chain()[:, :, warm.steps // 2 :]
        old = learning.proposal
        learning.proposal = _fit_proposal(warm.target, second_half, last=False)
        newest = second_half[:, :, -block:].reshape(-1, warm.target.dimension)
        gains = learning.proposal.log_density(newest) - old.log_density(newest)
        previous_gain, gain = gain, float(gains.mean())
        rhats = nested_rhat(second_half)
        agree = warm.steps >= _LEAST_BLOCKS * block and rhats.max() < _WARM_RHAT
        # a shape that no proposal represents yields the same gain in every block
        settled = agree and warm.settled() and not _LEARNING_GAIN < gain < previous_gain
        needed = convergence.steps_needed(warm.steps, len(second_half), rhats, _WARM_RHAT)
        predictions.append((warm.steps, float(needed.max())))
        if settled or warm.steps >= limit or hopeless(predictions, limit):
            return second_half, settled


@dataclass(frozen=True, eq=False)
class _Convergence:
    """Convergence diagnostics ``(d,)`` so far, and steps needed ``(d,)``."""

    rhat: Array
    tau: Array
    ess: Array
    needed: Array
    hopeless: bool
    done: bool

    @property
    def status(self) -> Status:
        """Status if a criterion is not met."""
        usable = self.rhat.max() < _UNUSABLE_RHAT and np.isfinite(self.ess).all()
        return "tentative" if usable and self.ess.min() > 100.0 else "unusable"


def _run_until_converged(
    main: _Ensembles, settings: Sampling, most: int, progress: ProgressCallback
) -> _Convergence:
    """Run until every criterion is met, the steps are used up or it is hopeless."""
    block, predictions, steps_needed = _block_steps(main.target, settings), [], math.inf
    while True:
        # checks at growing distances, as frequent checks stop by chance; earlier if predicted
        block_steps = max(block, main.steps // 3)
        if steps_needed < main.steps + block_steps:
            block_steps = max(block // 2, math.ceil(steps_needed) - main.steps)
        main.run(min(block_steps, most - main.steps))
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
        steps_needed = float(needed.max())
        predictions.append((main.steps, steps_needed))
        is_hopeless = not done and hopeless(predictions, most)
        if done or is_hopeless or main.steps >= most:
            return _Convergence(rhats, tau, ess, needed, is_hopeless, done)


class _Ensembles:
    """Several independent ensembles in one emcee sampler."""

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
        # emcee's wrapper prints a traceback at any exception, Ctrl-C included
        self._sampler.log_prob_fn = target
        # emcee ignores any other way of seeding
        self._sampler.random_state = random.get_state()
        self._state = emcee.State(positions.reshape(-1, d))
        self._random = random

    def run(self, steps: int) -> None:
        """Run a number of steps."""
        self._state = self._sampler.run_mcmc(self._state, steps, skip_initial_state_check=True)
        self.steps += steps
        # later samplers continue this random stream
        self._random.set_state(self._sampler.random_state)

    def bring_back_lost(self, rng: np.random.Generator) -> None:
        """Move walkers at a hopelessly improbable mode next to the others, during warm-up only.

        Such a mode has no mass, but a walker may stay in it forever.
        """
        ensembles, _, d = self._shape
        coords, heights = self.positions(), self._state.log_prob.reshape(ensembles, -1)
        lost = heights < heights.max() - stats.chi2.isf(1e-12, d) / 2.0
        if not lost.any():
            return
        for ensemble, is_lost in zip(coords, lost, strict=True):
            pool = ensemble[~is_lost] if np.count_nonzero(~is_lost) >= 3 else coords[~lost]
            if pool.shape[0] < 3:
                continue
            # next to a good walker, along the difference of two others
            first, second, third = (
                rng.integers(pool.shape[0], size=is_lost.sum()) for _ in range(3)
            )
            ensemble[is_lost] = pool[first] + 0.1 * (pool[second] - pool[third])
        self._state = emcee.State(coords.reshape(-1, d), random_state=self._state.random_state)

    def settled(self) -> bool:
        """Whether nothing climbs, shrinks or spreads over the second half of the steps."""
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
        """Return current positions, ``(ensembles, walkers, d)``."""
        return np.array(self._state.coords).reshape(self._shape)

    def acceptance(self) -> Array:
        """Return the acceptance fraction of each walker, ``(ensembles, walkers)``."""
        return np.asarray(self._sampler.acceptance_fraction).reshape(self._shape[:2])


def _fit_proposal(target: Target, chain: Array, *, last: bool) -> Proposal | MixedProposal:
    """Fit a proposal to steps ``(ensembles, walkers, n, d)``, also in linear coordinates."""
    draws = chain.reshape(-1, target.dimension)
    if not target.coordinates.is_nonlinear:
        return Proposal.fitted(draws, last=last)
    return MixedProposal.fitted(draws, target.to_linear, target.from_linear, last=last)


def _search_moves(
    target: Target, settings: Sampling, proposal: Proposal | MixedProposal, share: float
) -> list[tuple[emcee.moves.Move, float]]:
    """Make differential evolution moves in the coordinates that suit the proposal."""
    search = DifferentialEvolutionMove(settings.ensembles)
    if not target.coordinates.is_nonlinear:
        return [(search, share)]
    linear_share = proposal.share if isinstance(proposal, MixedProposal) else 0.5
    linear_search = TransformedMove(search, target.to_linear, target.from_linear)
    return [(search, share * (1.0 - linear_share)), (linear_search, share * linear_share)]


def _problems(
    target: Target, settings: Sampling, checked: _Convergence, main: _Ensembles, draws: Array
) -> Iterator[str]:
    """Yield a sentence with a hint for every criterion that is not met."""
    rhat, tau, ess = checked.rhat, checked.tau, checked.ess
    names = np.array(target.names)
    acceptance = main.acceptance()
    if not acceptance.any():
        yield (
            "no proposal was accepted; no interval can be computed: check the recording's units, "
            "or give wider priors"
        )
        return
    if not negligible(acceptance == 0.0):
        yield _STUCK.format(np.count_nonzero(acceptance == 0.0), acceptance.size)
    disagreeing = names[rhat > settings.max_rhat]
    if disagreeing.size:
        worst = int(rhat.argmax())
        medians = ", ".join(f"{x:.4g}" for x in np.median(draws[..., worst], axis=(1, 2)))
        yield (
            f"the ensembles disagree on {', '.join(disagreeing)} "
            f"(nested R-hat up to {rhat.max():.3f}; their medians of {names[worst]}: {medians}): "
            "raise sampling.max_steps, or give these parameters narrower priors"
        )
    too_few = names[ess < settings.min_ess]
    # more steps do not help a walker that never moves
    if too_few.size and np.isfinite(tau).all():
        yield (
            f"only {ess.min():.0f} independent draws of {names[int(ess.argmin())]} where "
            f"{settings.min_ess:.0f} were wanted: raise sampling.max_steps"
        )
    length = len(draws) * main.steps / tau.max()
    if not too_few.size and length < LONG_ENOUGH:
        yield (
            f"the run is only {length:.0f} autocorrelation times long, "
            f"{LONG_ENOUGH:g} are needed to trust them: raise sampling.max_steps"
        )


def _not_converging(names: tuple[str, ...], needed: Array, steps: int, max_steps: int) -> str:
    """Report that sampling was stopped because it cannot converge, and the slowest parameters."""
    slowest = np.argsort(-needed, kind="stable")[:_NAMED_PARAMETERS]
    slow = [names[j] for j in slowest if needed[j] > max_steps]
    worst = needed.max()
    would = f"about {float(f'{worst:.1g}'):.0f}" if np.isfinite(worst) else "endless"
    return (
        f"stopped after {steps} steps: at this pace it would need {would} steps, "
        f"sampling.max_steps is {max_steps}; slowest are {', '.join(slow)}: give them "
        "narrower priors, or fix what is known"
    )
