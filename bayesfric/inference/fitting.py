"""From preprocessed recordings to a posterior.

Read priors, make the likelihood, start from point estimates, climb to the mode, choose coordinates
for the posterior's widths there, and sample.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import stats

from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.progress import Progress, ProgressCallback, no_progress
from bayesfric.estimates.least_squares import least_squares, starting_values, typical_sizes
from bayesfric.estimates.point_estimate import Estimate
from bayesfric.inference.closed_loop_fit import ClosedLoopMode, closed_loop_mode, sample_closed_loop
from bayesfric.inference.discrepancy import Discrepancy
from bayesfric.inference.likelihood import TorqueLikelihood
from bayesfric.inference.noise import SCALES, Autoregressive, Noise, NoiseScale
from bayesfric.inference.posterior import Posterior, Prediction
from bayesfric.inference.priors import Prior, PriorText, default_prior, read_prior
from bayesfric.inference.sampling import Sampling, sample
from bayesfric.inference.start import (
    CLIMBS,
    Start,
    climb,
    gauss_newton,
    place_and_widths,
    unwrapped,
)
from bayesfric.inference.target import Likelihood, Target
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.signals import Signals


@dataclass(frozen=True)
class Fit:
    """A posterior with its target and what was examined of it.

    :class:`bayesfric.fit.model.Result` adds model and summary.
    """

    target: Target  # in the coordinates that were sampled
    posterior: Posterior  # draws, assuming the model
    estimates: tuple[Estimate, ...]  # point estimates, least squares first
    held_out: tuple[Prediction, ...] = ()  # of recordings that the likelihood did not use
    # see :func:`linearisation_change`; None if nothing is linearised
    linearisation: float | None = None
    discrepancy: Discrepancy | None = None  # None where it was not evaluated
    # (n, d) draws of a finished run, widened by the model discrepancy
    widened_draws: Array | None = None
    # shifts in sds from predictions of single readings to those of 20 ms, which are used
    faster: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def wide(self) -> Fit:
        """The same fit with draws widened by the model discrepancy, at most about 8000.

        Draws of a finished run have no log density: it is nan.
        """
        posterior = self.posterior
        if self.widened_draws is not None:
            # walkers are unknown; those that never moved were excluded
            widened = posterior.with_draws(self.widened_draws)
            return replace(self, posterior=widened, widened_draws=None)
        if self.discrepancy is None or not self.discrepancy.moved:
            return self
        rng = np.random.default_rng(np.random.SeedSequence(posterior.seed, spawn_key=(12,)))
        d = posterior.draws.shape[-1]
        # each is evaluated
        thinned = slice(None, None, -(-posterior.log_density.size // 8000))
        draws = posterior.draws[:, :, thinned]
        moved = self.discrepancy.widened(self.target, draws.reshape(-1, d), rng)
        widened = replace(
            posterior,
            draws=moved.reshape(draws.shape),
            log_density=posterior.log_density[:, :, thinned],
        )
        return replace(self, posterior=widened, discrepancy=None)

    @property
    def chain(self) -> Joint:
        """The joint."""
        return self.target.likelihood.chain

    @property
    def observations(self) -> tuple[Signals, ...]:
        """The preprocessed recordings."""
        return self.target.likelihood.observations

    @property
    def predicting(self) -> Array:
        """Draws ``(n, d)`` for predictions: 200, fewer for long recordings or closed loops."""
        likelihood = self.target.likelihood
        outputs = sum(o.measured.size for o in likelihood.outputs)
        count = 40 if likelihood.method == "closed-loop" else 200
        return self.posterior.flat(max(10, min(count, 2_000_000 // outputs)))

    @cached_property
    def residuals(self) -> list[Array]:
        """Measured minus posterior mean output ``(M,)`` of each recording."""
        likelihood = self.target.likelihood
        predicted = likelihood.predict(self.target.chain_values(self.predicting))
        pairs = zip(likelihood.outputs, predicted, strict=True)
        return [o.measured - rows.mean(axis=0) for o, rows in pairs]

    def chain_draws(self, n: int | None = None) -> Array:
        """Draws ``(n, n_parameters)`` of all parameters of the joint, fixed ones included."""
        return self.target.chain_values(self.posterior.flat(n))


def read_priors(
    chain: Joint,
    texts: Mapping[str, PriorText],
    observations: Sequence[Signals],
    noise: Sequence[str] = ("sigma",),
) -> dict[str, Prior]:
    """Complete the configured priors of parameters and noise scales with defaults."""
    noises = [f"noise.{quantity}" for quantity in noise]
    # one prior of the offset applies to all recordings without one
    if "offset" in texts and chain.own_offsets:
        texts = dict.fromkeys(chain.offset_names, texts["offset"]) | {
            name: text for name, text in texts.items() if name != "offset"
        }
    names = [*chain.names, *noises]
    for name in texts:
        if name not in names:
            raise BadInput(
                f"priors.{name}", "the mechanism has no such parameter", nearest(name, names)
            )
    priors = {
        p.name: read_prior(p.name, texts[p.name], lower=p.lower, upper=p.upper, circular=p.circular)
        for p in chain.parameters
        if p.name in texts
    }
    known = {name: prior.value for name, prior in priors.items() if prior.fixed}
    scales = typical_sizes(chain, observations, known)
    if not scales.torque:
        problem = "the motor's torque is 0 throughout, and no other torque is known"
        raise BadInput("priors", problem, 'fix what is known, such as "load.first_moment" = 0.14')
    per_torque = scales
    if chain.kp:  # the torque was computed with another gain
        gain = priors["drive.kp"]
        times = (gain.value if gain.fixed else gain.upper) / chain.kp
        per_torque = replace(
            scales, torque=times * scales.torque, exchanged=times * scales.exchanged
        )
    defaults = {p.name: default_prior(chain, p, per_torque) for p in chain.parameters}
    priors = {**defaults, **priors}
    for name, quantity in zip(noises, noise, strict=True):
        priors[name] = SCALES[quantity].read_prior(texts, scales)
        if priors[name].fixed:
            raise BadInput(f"priors.{name}", "cannot be fixed", "give a narrow range instead")
    if all(priors[name].fixed for name in chain.names):
        raise BadInput("priors", "fix every parameter", "leave at least one free")
    return priors


def make_target(
    chain: Joint,
    observations: Sequence[Signals],
    priors: Mapping[str, Prior],
    noise_scale: NoiseScale,
    noise: Autoregressive | None = None,
) -> Target:
    """Make the log-posterior of the torque."""
    return target_of(TorqueLikelihood(chain, observations, noise), priors, noise_scale)


def target_of(
    likelihood: Likelihood, priors: Mapping[str, Prior], noise_scale: NoiseScale
) -> Target:
    """Make the log-posterior of a likelihood."""
    recordings = [o.name for o in likelihood.observations]
    noise = Noise(recordings, likelihood.noise.scales, priors, noise_scale)
    return Target(likelihood, priors, noise)


def fit(
    target: Target,
    sampling: Sampling,
    *,
    estimates: Sequence[Estimate] = (),
    closed_loop: ClosedLoopMode | None = None,
    progress: ProgressCallback = no_progress,
) -> Fit:
    """Search the mode and sample; ``sampling.seed`` makes everything reproducible.

    The mode of a closed-loop likelihood may be known. Estimates by simulation do not start a
    posterior of the torque: they may be cut off by the clock.
    """
    likelihood = target.likelihood
    if not estimates:
        estimates = (least_squares(likelihood.chain, likelihood.observations),)
    progress(Progress("searching the mode"))
    if likelihood.method == "closed-loop":
        closed = closed_loop or closed_loop_mode(target, estimates, sampling.seed, progress)
        shaped, posterior = sample_closed_loop(closed, sampling, progress)
        return Fit(shaped, posterior, tuple(estimates), faster=closed.faster)
    rng = np.random.default_rng(np.random.SeedSequence(sampling.seed, spawn_key=(2**31,)))
    simulating = {"output-error"} - {likelihood.method}
    starting_estimates = [e for e in estimates if e.method not in simulating]
    points = _starting_points(target, starting_estimates)
    target = target.with_circular_cut_at(points[0])
    prior_draws = np.stack([prior.draw(500, rng) for prior in target.priors], axis=1)
    try:
        candidates = _candidates(target, starting_estimates, points, prior_draws)
        # estimates with a point are near the mode already
        climbs = 1 if any(e.point for e in starting_estimates) else CLIMBS
        heights = target.subsample()(candidates)
        candidates = candidates[np.argsort(-heights)[:climbs]]
        prior_places = target.from_parameters(prior_draws)
        best = gauss_newton(target, candidates[0], prior_places)
        target = _precomputed(target, best, rng)
        if likelihood.method == "input-error":
            mode = _searched_mode(target, candidates, best, prior_places, rng)
        else:  # few simulations, linearised again at the mode
            mode = climb(target, candidates, climbs=1, max_steps=20)
            for _ in range(2):
                target = target.relinearised_at(target.to_parameters(mode[None])[0][0])
                mode = climb(target, mode[None], climbs=1, max_steps=20)
    except ValueError:
        raise BadInput(
            "priors", "leave no possible starting point near the data", "widen the narrowest ones"
        ) from None
    # Once the posterior's widths are known, the sampler's coordinates can be used.
    normal = gauss_newton(target, mode, prior_places)
    place, widths = place_and_widths(target, normal)
    shaped = target.with_circular_cut_at(dict(zip(target.free, place, strict=False)))
    shaped = shaped.with_widths(widths)
    prior_draws = unwrapped(shaped, prior_draws)
    start = gauss_newton(
        shaped, shaped.from_parameters(place[None])[0], shaped.from_parameters(prior_draws)
    )
    shaped = _precomputed(shaped, start, rng)
    simulated = likelihood.method == "output-error"
    change = linearisation_change(shaped, start, rng) if simulated else None
    try:
        posterior = sample(shaped, start, sampling, progress=progress)
    except RuntimeError as error:
        raise BadInput("priors", str(error), "widen the narrowest ones") from None
    return Fit(shaped, posterior, tuple(estimates), linearisation=change)


def _searched_mode(
    target: Target, candidates: Array, best: Start, prior_places: Array, rng: np.random.Generator
) -> Array:
    """Climb from candidates ``(n, d)``, precomputing again where the search leaves its region.

    With a million samples a slow evaluation costs ten thousand times a fast one.
    """
    fast, slow = target, target.likelihood.slow_evaluations

    def precompute_again(place: Array) -> None:
        nonlocal fast, slow
        before, slow = slow, fast.likelihood.slow_evaluations
        if slow - before > 50:  # the last step was mostly slow
            fast = _precomputed(fast, gauss_newton(fast, place, prior_places), rng)
            slow = fast.likelihood.slow_evaluations

    widths = 1.0 / np.sqrt(np.diag(np.linalg.inv(best.covariance)))
    return climb(
        lambda u: fast(u),
        candidates,
        climbs=len(candidates),
        widths=widths,
        on_step=precompute_again,
    )


def _precomputed(target: Target, start: Start, rng: np.random.Generator) -> Target:
    """Precompute a target near a normal; draws decide the speed, not the value."""
    root = np.linalg.cholesky(start.covariance)
    return target.precomputed(start.mode + rng.standard_normal((300, start.mode.size)) @ root.T)


def _starting_points(target: Target, estimates: Sequence[Estimate]) -> list[dict[str, float]]:
    """Return starting points by name: estimates, and splits of base parameters.

    Least squares estimates quantities at the motor; load-dependent friction and the load's share
    are tried on a grid.
    """
    points = [dict(e.point) for e in estimates if e.point]
    # a simulation is expensive, and starts from a simulation's estimate
    if target.likelihood.method == "input-error" or not points:
        points += [
            starting_values(target.likelihood.chain, e, mu, share)
            for e in estimates
            if not e.point
            for mu in (0.02, 0.1, 0.2, 0.4)
            for share in (0.2, 0.5, 0.8)
        ]
    return points


def _candidates(
    target: Target,
    estimates: Sequence[Estimate],
    points: Sequence[Mapping[str, float]],
    prior_draws: Array,
) -> Array:
    """Return starting coordinates ``(n, d)`` from points and prior draws.

    Each is combined with several noise scales; values on a bound are moved inside.
    """
    likelihood = target.likelihood
    k = len(target.free)
    rows = unwrapped(target, np.array([[p[name] for name in target.free] for p in points]))
    # a start on a bound has no finite coordinates
    inner = np.quantile(prior_draws, [0.002, 0.998], axis=0)
    for j, prior in enumerate(target.priors[:k]):
        outside = (rows[:, j] <= prior.lower) | (rows[:, j] >= prior.upper)
        rows[outside, j] = np.clip(rows[outside, j], *inner[:, j])
    if isinstance(likelihood, TorqueLikelihood):
        rms = max(e.residual_rms for e in estimates if e.method == "least-squares")
        # prior draws leave a residual about as large as the torque
        measured = np.concatenate([o.measured for o in likelihood.outputs])
        unexplained = float(np.sqrt(np.mean(measured**2)))
        columns = [likelihood.noise.quantities.index(kind) for kind in target.noise.quantities]
        candidates = np.concatenate(
            [
                np.column_stack([block, np.tile(scales, (len(block), 1))])
                for block, size in ((rows, rms), (prior_draws[:100, :k], unexplained))
                for scales in likelihood.noise.starts(size)[:, columns]
            ]
        )
    else:
        scales = _noise_grid(target, inner[:, k:])
        candidates = np.column_stack(
            [np.repeat(rows, len(scales), axis=0), np.tile(scales, (len(rows), 1))]
        )
    candidates[:, k:] = np.clip(candidates[:, k:], *inner[:, k:])
    return target.from_parameters(candidates)


def _noise_grid(target: Target, inner: Array) -> Array:
    """Grid ``(n, scales)`` of noise scales over their priors, the same for all recordings."""
    kinds = target.noise.quantities
    unique = list(dict.fromkeys(kinds))
    ends = [inner[:, kinds.index(kind)] for kind in unique]
    axes = [np.geomspace(low, high, 9) for low, high in ends]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(unique))
    return grid[:, [unique.index(kind) for kind in kinds]]


# Check of the output-error likelihood's linearisation. Its derivatives are taken at the mode; for a
# joint that sticks they differ between plausible parameters, and so does the likelihood.


def linearisation_change(
    target: Target,
    start: Start,
    rng: np.random.Generator,
    *,
    # of 57 simulated recordings, 45 were below, with the truth within 3.2 posterior standard
    # deviations in all parameters of all but one, whether the joint stuck for 0 or 38 % of the
    # time; above, errors were up to 90
    largest: float = 2.0,
    points: int = 12,
) -> float:
    """Return the standard deviation of the log-likelihood's change by relinearisation.

    Plausible parameters are compared by the log-likelihood linearised there and at the mode; a
    constant difference does not matter to a posterior. BadInput if it is too large.
    """
    changes: list[float] = []
    for place in _plausible_parameters(target, start, rng, points):
        relinearised = target.relinearised_at(place)
        change = relinearised.log_likelihood(place[None]) - target.log_likelihood(place[None])
        changes.append(float(change[0]))
        # the sum of squares about the mean only grows: stop once it is too large, or not finite
        if not np.var(changes) * len(changes) <= largest**2 * (points - 1):
            sd = float(np.std(changes, ddof=1)) if np.isfinite(changes).all() else np.inf
            raise BadInput(
                'likelihood.method = "output-error"',
                f"cannot be linearised: at another point the log-likelihood changes by {sd:.2g} "
                f"(sd; at most {largest:g}), as if the joint sticks or reverses",
                'set likelihood.method = "input-error", or exclude standstills',
            )
    return float(np.std(changes, ddof=1))


def _plausible_parameters(
    target: Target, start: Start, rng: np.random.Generator, max_count: int
) -> Array:
    """Draw parameter vectors ``(n, d)`` as probable as the posterior's.

    The start's normal is narrowed until enough draws are within the fall of log density of 99.9 %
    of a ``d``-dimensional normal: bounds and curvature make a posterior narrower than its normal.
    """
    d, spread = start.mode.size, 1.0
    root = np.linalg.cholesky(start.covariance)
    fall = stats.chi2.isf(1e-3, d) / 2.0
    while True:
        u = start.mode + spread * rng.standard_normal((100, d)) @ root.T
        density = target(u)
        probable = u[density > max(density.max(), target(start.mode[None])[0]) - fall]
        if len(probable) >= max_count or spread < 1e-3:
            places = probable[:max_count] if len(probable) > 1 else u[:max_count]
            return np.asarray(target.to_parameters(places)[0])
        spread /= 2.0
