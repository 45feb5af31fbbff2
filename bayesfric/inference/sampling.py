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

import emcee
import numpy as np
from pydantic import Field
from threadpoolctl import threadpool_limits

from bayesfric.base.options import Options
from bayesfric.base.progress import Progress, ProgressCallback, no_progress
from bayesfric.inference.posterior import (
    LONG_ENOUGH,
    Diagnostics,
    Posterior,
    autocorrelation_time,
    effective_sample_size,
    nested_rhat,
)
from bayesfric.inference.proposals import (
    DifferentialEvolutionMove,
    IndependenceMove,
    MixedProposal,
    Proposal,
)
from bayesfric.inference.start import Start
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array

# Share of proposals without a likelihood that is reported. About this share of the posterior may be
# missing, and the 5 % tail beyond an end of a 90 % interval off by as much; 2000 independent draws
# give that tail to 0.5 %. Warm-up starts far out and does not count.
TROUBLE = 0.01


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

    Warm-up from over-dispersed starts adapts the independence move's proposal until the ensembles
    roughly agree; then the proposal is refitted and frozen, and only later steps count. If they do
    not suffice, they are warm-up of another proposal.
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
    move = IndependenceMove(Proposal.normal(start.mode, start.covariance))
    sampler = _Ensembles(target, move, 0.5, positions, random)
    block = min(50 if target.likelihood.method == "input-error" else 25, settings.max_steps // 8)
    block = max(block, 10)
    # BLAS threads contend on small matrices: seven times slower on two busy cores
    with threadpool_limits(1, "blas"):
        settled = _warm_up(sampler, move, block, settings, progress)
        states = sampler.draws(sampler.steps // 2)
        # precompute the likelihood where the posterior lies
        target = target.precomputed(states[:: max(1, len(states) // 500)])
        # a proposal from warm-up may be too thin in the tails: it is refitted after six blocks
        warmup, before, limit, finished = sampler.steps, 0, 6 * block, False
        while not finished:
            move = IndependenceMove(_fit_proposal(target, states, last=True))
            # differential evolution for shapes that the proposal misses
            sampler = _Ensembles(target, move, 0.2, sampler.positions(), random)
            before, remaining = target.not_finite, settings.max_steps - warmup
            # if at least twice the steps remain that a refit would discard
            steps = limit if 3 * limit <= remaining else remaining
            finished, gave_up = _run_until_converged(sampler, steps, block, settings, progress)
            finished |= sampler.steps >= remaining
            if not finished:
                sampler.replace_stuck()
                states, warmup, limit = sampler.draws(), warmup + sampler.steps, 2 * limit
    return _posterior(
        sampler, settings, warmup, started, settled=settled, gave_up=gave_up, before=before
    )


def _warm_up(
    sampler: _Ensembles,
    move: IndependenceMove,
    block: int,
    settings: Sampling,
    progress: ProgressCallback,
) -> bool:
    """Run and adapt the proposal; return whether the second half of the steps settled."""
    gain = math.inf
    progress(Progress("warm-up"))
    while True:
        sampler.run(block)
        sampler.replace_stuck()
        progress(Progress("warm-up", sampler.steps))
        old = move.proposal
        move.proposal = _fit_proposal(sampler.target, sampler.draws(sampler.steps // 2), last=False)
        newest = sampler.chain()[:, :, -block:].reshape(-1, sampler.target.dimension)
        previous_gain = gain
        gain = float((move.proposal.log_density(newest) - old.log_density(newest)).mean())
        # two densities so close share at least four fifths of their mass (Pinsker); a shape that no
        # proposal represents yields the same gain in every block
        learned = not 0.08 < gain < previous_gain
        # three blocks at least, so that the proposal has learned from its own draws
        agree = (
            sampler.steps >= 3 * block
            and nested_rhat(sampler.chain(sampler.steps // 2)).max() < 1.05
        )
        settled = agree and learned and sampler.settled()
        if settled or sampler.steps >= settings.max_steps // 4:
            return settled


def _run_until_converged(
    sampler: _Ensembles, max_count: int, block: int, settings: Sampling, progress: ProgressCallback
) -> tuple[bool, float]:
    """Run until every criterion is met, ``max_count`` steps are used up or it is hopeless.

    Return whether to stop sampling, and the number of steps needed if that is hopeless, else 0.
    """
    needed = math.inf
    progress(Progress("sampling"))
    while True:
        # checks at growing distances, as frequent checks stop by chance; earlier if predicted
        steps = max(block, sampler.steps // 3)
        if needed < sampler.steps + steps:
            steps = max(block // 2, math.ceil(needed) - sampler.steps)
        sampler.run(min(steps, max_count - sampler.steps))
        rhat, tau, ess = sampler.convergence()
        progress(Progress("sampling", sampler.steps, float(ess.min()), float(rhat.max())))
        length = settings.ensembles * sampler.steps / tau.max()
        enough = ess.min() >= settings.min_ess and length >= LONG_ENOUGH
        if enough and rhat.max() <= settings.max_rhat:
            return True, 0.0
        # the variance between ensembles falls as one over the number of steps
        by_rhat = sampler.steps * float(rhat.max() ** 2 - 1.0) / (settings.max_rhat**2 - 1.0)
        needed = max(by_rhat, LONG_ENOUGH * float(tau.max()) / settings.ensembles)
        # a prediction from a tenth of the allowed steps may be off by a factor of two
        is_late = sampler.steps >= max(500, settings.max_steps // 10)
        if is_late and needed > 2 * settings.max_steps:
            return True, needed
        if sampler.steps >= max_count:
            return False, 0.0


class _Ensembles:
    """Several independent ensembles in one emcee sampler.

    Differential evolution, in addition to a move, has a share ``search`` among the steps.
    """

    def __init__(
        self,
        target: Target,
        move: IndependenceMove,
        search: float,
        positions: Array,
        random: np.random.RandomState,
    ) -> None:
        self.target, self._shape, self._random = target, positions.shape, random
        ensembles, walkers, d = positions.shape
        evolution = DifferentialEvolutionMove(ensembles)
        moves: list[tuple[emcee.moves.Move, float]] = [(move, 1.0 - search), (evolution, search)]
        if target.coordinates.is_nonlinear:  # in the coordinates that suit the proposal
            proposal = move.proposal
            share = proposal.share if isinstance(proposal, MixedProposal) else 0.5
            linear = DifferentialEvolutionMove(ensembles, target.to_linear, target.from_linear)
            moves[1:] = [(evolution, search * (1.0 - share)), (linear, search * share)]
        self._sampler = emcee.EnsembleSampler(
            ensembles * walkers, d, target, moves=moves, vectorize=True
        )
        # emcee's wrapper prints a traceback at any exception, Ctrl-C included
        self._sampler.log_prob_fn = target
        # emcee ignores any other way of seeding
        self._sampler.random_state = random.get_state()
        self._state = emcee.State(positions.reshape(-1, d))

    @property
    def steps(self) -> int:
        """Number of steps so far."""
        return int(self._sampler.iteration)

    def run(self, steps: int) -> None:
        """Run a number of steps."""
        self._state = self._sampler.run_mcmc(self._state, steps, skip_initial_state_check=True)
        # later samplers continue this random stream
        self._random.set_state(self._sampler.random_state)

    def chain(self, first: int = 0) -> Array:
        """Return the steps from ``first`` on, ``(ensembles, walkers, steps, d)``."""
        chain = self._sampler.get_chain()[first:]
        return np.asarray(np.moveaxis(chain.reshape(-1, *self._shape), 0, 2))

    def log_density(self, first: int = 0) -> Array:
        """``(ensembles, walkers, steps)``."""
        density = self._sampler.get_log_prob()[first:]
        return np.asarray(np.moveaxis(density.reshape(-1, *self._shape[:2]), 0, 2))

    def acceptance(self) -> Array:
        """Return the acceptance fraction of each walker, ``(ensembles, walkers)``."""
        return np.asarray(self._sampler.acceptance_fraction).reshape(self._shape[:2])

    def draws(self, first: int = 0) -> Array:
        """Positions ``(n, d)`` from step ``first`` on, of walkers that moved, if any did."""
        chain, moved = self.chain(first), self.acceptance() > 0.0
        return np.asarray((chain[moved] if moved.any() else chain).reshape(-1, self._shape[2]))

    def replace_stuck(self) -> None:
        """Put walkers that never moved, and would stay forever, on others of their ensemble."""
        walkers = np.arange(len(self._state.coords)).reshape(self._shape[:2])
        for ensemble, moved in zip(walkers, self.acceptance() > 0.0, strict=True):
            if moved.any() and not moved.all():
                stuck, others = ensemble[~moved], np.resize(ensemble[moved], np.sum(~moved))
                self._state.coords[stuck] = self._state.coords[others]
                self._state.log_prob[stuck] = self._state.log_prob[others]

    def positions(self) -> Array:
        """Return current positions, ``(ensembles, walkers, d)``."""
        return np.array(self._state.coords).reshape(self._shape)

    def convergence(self) -> tuple[Array, Array, Array]:
        """Nested R-hat, autocorrelation time and effective sample size, ``(d,)`` each."""
        chain, moved = self.chain(), self.acceptance() > 0.0
        if 0 < np.sum(~moved) <= 0.01 * moved.size:  # they are left out, and reported
            chain = chain[:, moved.all(axis=0)]
        tau = autocorrelation_time(chain)
        return nested_rhat(chain), tau, effective_sample_size(chain, tau)

    def settled(self) -> bool:
        """Whether nothing climbs, shrinks or spreads over the second half of the steps."""
        third, fourth = np.array_split(self.log_density(self.steps // 2), 2, axis=2)
        climbing = abs(fourth.mean() - third.mean()) > 0.25 * fourth.std()
        quarters = np.array_split(self.chain(self.steps // 2), 2, axis=2)
        before, after = (x.reshape(-1, self._shape[2]).std(axis=0) for x in quarters)
        return not (climbing or np.abs(np.log(after / before)).max() > 0.2)


def _fit_proposal(target: Target, draws: Array, *, last: bool) -> Proposal | MixedProposal:
    """Fit a proposal to draws ``(n, d)``, also in linear coordinates."""
    if not target.coordinates.is_nonlinear:
        return Proposal.fitted(draws, last=last)
    return MixedProposal.fitted(draws, target.to_linear, target.from_linear, last=last)


def _posterior(
    sampler: _Ensembles,
    settings: Sampling,
    warmup: int,
    started: float,
    *,
    settled: bool,
    gave_up: float,
    before: int,
) -> Posterior:
    """Thin the chain and collect its diagnostics.

    ``before`` counts non-finite values until warm-up ended.
    """
    target, acceptance = sampler.target, sampler.acceptance()
    rhat, tau, ess = sampler.convergence()
    kept_draws = max(20_000, 2 * int(settings.min_ess))
    thin = min(max(1, sampler.steps * acceptance.size // kept_draws), sampler.steps)
    thinned = sampler.chain()[:, :, thin - 1 :: thin]
    draws = target.to_parameters(thinned.reshape(-1, thinned.shape[-1]))[0].reshape(thinned.shape)
    problems = list(_problems(sampler, settings, draws, rhat, tau, ess))
    if gave_up and acceptance.any():
        needed = f"about {float(f'{gave_up:.1g}'):.0f}" if math.isfinite(gave_up) else "many more"
        slowest = target.names[int(tau.argmax() if np.isfinite(tau).all() else rhat.argmax())]
        problems.insert(
            0,
            f"stopped after {warmup + sampler.steps} steps, as {needed} would be needed "
            f"and sampling.max_steps is {settings.max_steps}; slowest is {slowest}: give it a "
            "narrower prior, or fix what is known",
        )
    if not settled:
        problems.append(
            "warm-up was still moving when it was cut off: raise sampling.max_steps, or give "
            "narrower priors"
        )
    share = (target.not_finite - before) / (sampler.steps * acceptance.size)
    warning = (
        f"at {100 * share:.2g} % of the proposals the likelihood is not finite; they count as "
        "impossible: check units and columns of the recordings with 'bayesfric check', and do not "
        "trust the intervals"
    )
    usable = rhat.max() < 1.1 and np.isfinite(ess).all() and ess.min() > 100.0
    return Posterior(
        names=target.names,
        priors=target.priors,
        draws=draws,
        log_density=sampler.log_density()[:, :, thin - 1 :: thin],
        diagnostics=Diagnostics(
            status="reliable" if not problems else "tentative" if usable else "unusable",
            problems=tuple(problems),
            rhat=rhat,
            tau=tau,
            ess=ess,
            acceptance=acceptance,
            ensembles=settings.ensembles,
            walkers=acceptance.shape[1],
            warmup=warmup,
            steps=sampler.steps,
            thin=thin,
            not_finite=target.not_finite,
            seconds=time.perf_counter() - started,
            not_finite_share=share,
            warnings=(warning,) if share >= TROUBLE else (),
            max_rhat=settings.max_rhat,
        ),
        seed=settings.seed,
    )


def _problems(
    sampler: _Ensembles, settings: Sampling, draws: Array, rhat: Array, tau: Array, ess: Array
) -> Iterator[str]:
    """Yield a sentence with a hint for every criterion that is not met."""
    names, acceptance = np.array(sampler.target.names), sampler.acceptance()
    if not acceptance.any():
        yield (
            "no proposal was accepted; no interval can be computed: check the recording's units, "
            "or give wider priors"
        )
        return
    if not acceptance.all():
        yield (
            f"{np.count_nonzero(acceptance == 0.0)} of {acceptance.size} walkers never moved, and "
            "are left out of every interval: look at the trace; try another sampling.seed, or "
            "narrower priors"
        )
    disagreeing = names[rhat > settings.max_rhat]
    if disagreeing.size:
        worst = int(rhat.argmax())
        medians = ", ".join(f"{x:.4g}" for x in np.median(draws[..., worst], axis=(1, 2)))
        yield (
            f"the ensembles disagree on {', '.join(disagreeing)} "
            f"(nested R-hat up to {rhat.max():.3f}; their medians of {names[worst]}: {medians}): "
            "raise sampling.max_steps, or give these parameters narrower priors"
        )
    too_few = ess.min() < settings.min_ess
    # more steps do not help a walker that never moves
    if too_few and np.isfinite(tau).all():
        yield (
            f"only {ess.min():.0f} independent draws of {names[int(ess.argmin())]} where "
            f"{settings.min_ess:.0f} were wanted: raise sampling.max_steps"
        )
    length = settings.ensembles * sampler.steps / tau.max()
    if not too_few and length < LONG_ENOUGH:
        yield (
            f"the run is only {length:.0f} autocorrelation times long, "
            f"{LONG_ENOUGH:g} are needed to trust them: raise sampling.max_steps"
        )
