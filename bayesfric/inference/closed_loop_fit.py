"""The fit of a closed loop: its mode by Fisher scoring, and draws by importance.

One evaluation of its likelihood takes milliseconds. Draws come from a normal at the mode with a
wider t around it, which is fitted again to the weighted draws of all rounds so far; weights are
over the mixture of all proposals (adaptive multiple importance sampling; Cornuet, Marin, Mira and
Robert, Scandinavian Journal of Statistics 39 (2012) 798-812). Noise scales are drawn from the
normal at their mode, and the parameters at the mode's noise: what moves a prediction and what
spreads it are orthogonal in Fisher's information.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from bayesfric.base.progress import Progress, ProgressCallback, no_progress
from bayesfric.estimates.point_estimate import Estimate
from bayesfric.inference.closed_loop import ClosedLoopLikelihood
from bayesfric.inference.posterior import Diagnostics, Posterior, nested_rhat
from bayesfric.inference.proposals import Proposal
from bayesfric.inference.sampling import Sampling, sample
from bayesfric.inference.start import Start, place_and_widths, unwrapped
from bayesfric.inference.target import Target
from bayesfric.mechanism.quantities import scales_with_torque
from bayesfric.recordings.arrays import Array

# Independent draws that suffice: ends of a 90 % interval to a tenth of a standard deviation.
ENOUGH = 300
# Largest number of draws, and the share of them that counts below which they are not trusted.
MAX_DRAWS, EFFICIENT = 4000, 0.1


@dataclass(frozen=True, eq=False)
class ClosedLoopMode:
    """Mode of a closed-loop posterior, and the horizon that it was chosen with."""

    target: Target  # its likelihood refers to the mode
    mode: Array  # (d,) coordinates
    information: Array  # (d, d) there
    # shifts in sds from predictions of single readings to those of 20 ms, which are used
    faster: Mapping[str, float]

    @property
    def parameters(self) -> Array:
        """Parameters ``(d,)`` there."""
        return np.asarray(self.target.to_parameters(self.mode[None])[0][0])

    @property
    def by_name(self) -> dict[str, float]:
        """The same, by name."""
        return dict(zip(self.target.names, self.parameters.tolist(), strict=True))

    def predicts_better(self, smaller: ClosedLoopMode) -> bool:
        """Whether a larger model predicts other data better, by its information criterion."""
        return self.bic < smaller.bic

    @property
    def bic(self) -> float:
        """Bayesian information criterion (Schwarz 1978)."""
        outputs = sum(o.measured.size for o in self.target.likelihood.outputs)
        height = float(self.target.log_likelihood(self.parameters[None])[0])
        return self.mode.size * float(np.log(outputs)) - 2.0 * height


def closed_loop_mode(
    target: Target,
    estimates: Sequence[Estimate],
    seed: int,
    progress: ProgressCallback = no_progress,
    *,
    near: Mapping[str, float] | None = None,
    largest: float = 3.5,
) -> ClosedLoopMode:
    """Find the mode of a closed-loop posterior, and how far its predictions reach.

    It is searched from parameters that are ``near`` by name, or else from the estimates and around.
    What the model lacks at high frequency moves the estimate from single readings most. Where that
    from predictions 20 ms ahead differs by more than ``largest`` standard deviations of the
    difference, it is used, and the differences are given by name; with infinity it is not searched.
    """
    likelihood, rng = target.likelihood, np.random.default_rng(seed)
    assert isinstance(likelihood, ClosedLoopLikelihood)
    target = target.with_circular_cut_at(next(dict(e.point) for e in estimates if e.point))
    prior_draws = np.stack([prior.draw(500, rng) for prior in target.priors], axis=1)
    spread = _spread(target, prior_draws)

    def climb_from(target: Target, u: Array) -> Array:
        return score(target, u, spread, on_step=lambda _: progress(Progress("searching the mode")))

    def at_mode(target: Target, mode: Array) -> ClosedLoopMode:
        at = target.at(target.to_parameters(mode[None])[0][0])
        return ClosedLoopMode(at, mode, slope_and_information(at, mode, 1e-3 * spread)[1], {})

    modes = [climb_from(target, u) for u in _starting_points(target, estimates, prior_draws, near)]
    every = at_mode(target, modes[int(np.argmax(target(np.array(modes))))])
    if likelihood.longer == 1 or np.isinf(largest):
        return every
    longer = copy(target)
    longer.likelihood = likelihood.with_stride(likelihood.longer)
    far = at_mode(longer, climb_from(longer, every.mode))
    narrow, wide = (np.diag(np.linalg.inv(at.information)) for at in (every, far))
    # the estimate of all readings is efficient if the model is right (Hausman 1978)
    shift = (far.mode - every.mode) / np.sqrt(np.maximum(wide - narrow, 0.1 * wide))
    named = zip(target.free, shift.tolist(), strict=False)
    shifts = {name: x for name, x in named if abs(x) > largest}
    return replace(far, faster=shifts) if shifts else every


def sample_closed_loop(
    at_mode: ClosedLoopMode, sampling: Sampling, progress: ProgressCallback
) -> tuple[Target, Posterior]:
    """Draw by importance, or where few draws count by emcee; the target has their coordinates."""
    target, place, rng = at_mode.target, at_mode.parameters, np.random.default_rng(sampling.seed)
    k = len(target.free)
    covariance = np.asarray(np.linalg.inv(at_mode.information))
    _, widths = place_and_widths(target, Start(at_mode.mode, covariance))
    # the likelihood is near normal in the parameters, and in the logarithms of the noise
    widths[k:] = np.nan
    scaled, by = _scaled_by_gain(target)
    if scaled:  # straight, up to its bounds
        span = target.priors[by].upper - target.priors[by].lower
        widths[by] = min(widths[by], 0.05 * span)
    shaped = target.with_widths(widths)
    centre = shaped.from_parameters(place[None])[0]
    steps = np.concatenate([0.05 * widths[:k], np.full(widths.size - k, 0.05)])
    _, information = slope_and_information(shaped, centre, steps)
    if scaled:  # all of them over the gain may be all that is determined
        information[by, by] += target.priors[by].sd() ** -2
    start = Start(centre, np.asarray(np.linalg.inv(information)))
    posterior, share = draw(shaped, start, sampling.seed, scaled=(scaled, by), progress=progress)
    if share < EFFICIENT:
        reduced = {"ensembles": 2, "min_ess": float(ENOUGH), "max_steps": 2000}
        posterior = sample(shaped, start, sampling.model_copy(update=reduced), progress=progress)
    return shaped, replace(posterior, draws=_with_loop_doubt(shaped, posterior, rng))


def _scaled_by_gain(target: Target) -> tuple[list[int], int]:
    """Return indices of free parameters that scale with an unknown kp, and its own."""
    if "drive.kp" not in target.free:
        return [], 0
    by, parameters = target.free.index("drive.kp"), target.likelihood.chain.parameters
    units = {p.name: p.unit for p in parameters}
    scaled = [j for j, n in enumerate(target.free) if scales_with_torque(units[n]) and j != by]
    return scaled, by


def _with_loop_doubt(
    target: Target, posterior: Posterior, rng: np.random.Generator, *, size: float = 5e-4
) -> Array:
    """Add to draws what an unknown loop period T and lag of the drive's speed take away.

    That is kp T/2 of viscous loss and kd (T/2 + lag) of inertia. Both are half normal of ``size``
    s: a drive for joints closes its loop a thousand times a second, or more often.
    """
    likelihood, draws = target.likelihood, posterior.draws.copy()
    assert isinstance(likelihood, ClosedLoopLikelihood)
    chain, law = likelihood.chain, likelihood.recordings[0].law
    assert law is not None
    shape, flat = draws.shape[:-1], draws.reshape(-1, draws.shape[-1])
    factor, extra_kd = chain.drive_gains(target.chain_values(flat))
    scale = float(law.scale.mean())
    back, lag = (
        size * np.abs(rng.standard_normal(len(flat))) * (known is None)
        for known in (law.loop, law.velocity_filter)
    )
    lost = {
        "viscous": scale * factor * law.kp * back / 2.0,
        "inertia": scale * (law.kd + extra_kd) * (back / 2.0 + lag),
    }
    for quantity, torque in lost.items():
        owners = [n.rpartition(".")[0] for n in target.free if n.rpartition(".")[2] == quantity]
        if owners:
            reach = chain.reaches[owners[0]]
            column = target.names.index(f"{owners[0]}.{quantity}")
            flat[:, column] += torque * chain.ratio / reach**2
    return flat.reshape(*shape, -1)


def _spread(target: Target, prior_draws: Array) -> Array:
    """Spread ``(d,)`` of the priors in coordinates."""
    with np.errstate(all="ignore"):
        low, high = np.nanquantile(target.from_parameters(prior_draws), [0.16, 0.84], axis=0)
    return np.asarray(np.maximum((high - low) / 2.0, 1e-12))


def _starting_points(
    target: Target,
    estimates: Sequence[Estimate],
    prior_draws: Array,
    near: Mapping[str, float] | None,
) -> Array:
    """Search starting coordinates ``(n, d)`` from estimates, one parameter after the other.

    The torque of a control law is late and noisy: its estimate has too small an inertia where the
    encoder is coarse, and takes a delay for a viscous loss. Far from the mode errors are larger
    than the noise, which is then tried larger. A loss by the load may end where the gearbox does
    not move by its load: another start has the prior's, with a gain that drives as much.
    """
    free, k = target.free, len(target.free)
    points = [dict(e.point) for e in estimates if e.point]
    rows = unwrapped(target, np.array([[p[name] for name in free] for p in points]))
    inner = np.quantile(prior_draws, [0.002, 0.5, 0.998], axis=0)
    assert isinstance(target.likelihood, ClosedLoopLikelihood)
    periods = max(r.period for r in target.likelihood.recordings) * np.arange(5)
    quantities = [name.rpartition(".")[2] for name in free]
    if losses := [j for j, quantity in enumerate(quantities) if quantity.startswith("load")]:
        others = rows.copy()
        others[:, losses] = inner[1, losses]
        if "drive.kp" in free:
            ratio = (1.0 + others[:, losses]) / (1.0 + rows[:, losses])
            others[:, free.index("drive.kp")] *= ratio.prod(axis=1)
        rows = np.concatenate([rows, others])

    def best_of(rows: Array) -> Array:
        rows = np.clip(rows, inner[0], inner[2])
        return np.asarray(rows[int(np.argmax(target(target.from_parameters(rows))))])

    noises = np.quantile(prior_draws[:, k:], [0.5, 0.9, 0.99], axis=0)
    if near:
        typical = zip(target.names, [*rows[0], *noises[0]], strict=True)
        row = np.array([[near.get(name, value) for name, value in typical]])
        return target.from_parameters(np.clip(row, inner[0], inner[2]))
    starts = [best_of(np.array([[*row, *noise] for noise in noises])) for row in rows]
    for n, best in enumerate(starts):
        for j in 2 * list(range(best.size)):
            is_delay = j < k and quantities[j] == "delay"
            if j in losses or (inner[0, j] < 0.0 and not is_delay):
                continue
            values = np.array([0.2 * best[j], 3.0 * best[j], inner[1, j]])
            values = periods if is_delay else values
            tried = np.tile(best, (1 + values.size, 1))
            tried[1:, j] = values
            best = best_of(tried)
        starts[n] = best
    return target.from_parameters(np.array(starts))


def score(
    target: Target,
    start: Array,
    spread: Array,
    *,
    max_steps: int = 30,
    on_step: Callable[[float], None] = lambda _: None,
) -> Array:
    """Climb from coordinates ``(d,)`` to the mode by Fisher scoring.

    ``spread`` ``(d,)`` is the prior's, the longest step.
    """
    u, height, damping, small = start, float(target(start[None])[0]), 1e-3, 0
    for _ in range(max_steps):
        on_step(height)
        gradient, information = slope_and_information(target, u, 1e-4 * spread, central=False)
        size = np.sqrt(np.diag(information))
        scaled = information / np.outer(size, size)
        while damping < 1e8:
            change = np.linalg.solve(scaled + damping * np.eye(u.size), gradient / size) / size
            trial = u + np.clip(change, -spread, spread)
            new = float(target(trial[None])[0])
            if new > height:
                break
            damping = max(8.0 * damping, 1e-4)
        else:
            break
        gain, u, height, damping = new - height, trial, new, damping / 5.0
        # a step as long as Newton's that gains little ends at the mode
        small = small + 1 if gain < 0.05 else 0
        if small >= 2 or (small and damping < 1e-3):
            break
    return u


def slope_and_information(
    target: Target, u: Array, steps: Array, *, central: bool = True
) -> tuple[Array, Array]:
    """Gradient ``(d,)`` of the log density and its expected information ``(d, d)``.

    By differences of standardised errors ``z`` and half log variances ``l``, of which the
    log-likelihood is ``-sum(z²/2 + l)``; a step that leaves the support is taken the other way.
    """
    d, k = u.size, len(target.free)
    ways = np.concatenate([np.diag(steps), -np.diag(steps)])
    parameters, jacobian = target.to_parameters(u + np.concatenate([np.zeros((1, d)), ways]))
    prior = target.log_prior(parameters) + jacobian
    inside = np.isfinite(prior[1:]).reshape(2, d)
    up, down = inside[0], inside[1] & (central | ~inside[0])
    needed = np.concatenate([[True], up, down])
    scales = target.noise.scales(parameters[needed][:, k:])
    values = target.chain_values(parameters[needed])
    widths = np.where(up | down, steps * (1.0 * up + down), np.inf)

    def slopes(rows: Array) -> Array:
        full = np.tile(rows[:1], (2 * d + 1, *[1] * (rows.ndim - 1)))
        full[needed] = rows
        return np.nan_to_num(((full[1 : d + 1] - full[d + 1 :]).T / widths).T)

    gradient, information = slopes(prior[needed]), np.zeros((d, d))
    for output in target.likelihood.standardised(values, scales):
        half, change = output.shape[1] // 2, slopes(output)
        gradient -= change @ np.concatenate([output[0, :half], np.ones(half)])
        information += change @ change.T
    bend = np.where(inside.all(axis=0), prior[0] - prior[1:].reshape(2, d).mean(axis=0), 0.0)
    return gradient, information + np.diag(np.maximum(2.0 * bend, 1e-12) / steps**2)


def draw(
    target: Target,
    start: Start,
    seed: int,
    *,
    scaled: tuple[Sequence[int], int] = ((), 0),
    enough: int = ENOUGH,
    max_draws: int = MAX_DRAWS,
    progress: ProgressCallback = no_progress,
) -> tuple[Posterior, float]:
    """Draw from the posterior; return it, and the share of the draws that counts.

    Coordinates ``scaled`` are proposed as ratios to another one, of which they may be multiples.
    """
    columns, by = list(scaled[0]), scaled[1]
    began, d = time.perf_counter(), len(target.free)
    noise = start.mode[d:]
    random = np.random.RandomState(np.random.MT19937(np.random.SeedSequence(seed)))
    slope, mode = np.eye(d), start.mode[:d].copy()
    slope[columns, columns] = 1.0 / mode[by]
    slope[columns, by] = -mode[columns] / mode[by] ** 2
    mode[columns] /= mode[by]
    normal = Proposal.normal(mode, slope @ start.covariance[:d, :d] @ slope.T)
    proposals, counts = [normal], list[int]()
    draws, heights, weights, share = np.empty((0, d)), np.empty(0), np.empty(0), 1.0
    ratios = draws
    while True:
        effective = 1.0 / float(np.sum(weights**2)) if weights.size else 0.0
        progress(Progress("sampling", len(draws), effective, 1.0))
        if effective >= enough or len(draws) >= max_draws:
            break
        # a few to learn the shape from, then as many as are wanted at the efficiency so far
        number = max(20 * d, int((enough - effective) / max(share, 0.05)) + 1)
        number = min(number, max(20 * d, len(draws)), max_draws - len(draws))
        ratios = np.concatenate([ratios, new := proposals[-1].draw(number, random)])
        new = new.copy()
        new[:, columns] *= new[:, by : by + 1]
        draws, counts = np.concatenate([draws, new]), [*counts, number]
        full = np.column_stack([new, np.tile(noise, (number, 1))])
        heights = np.concatenate([heights, target(full)])
        shares = np.log(np.array(counts) / len(draws))
        densities = np.stack([proposal.log_density(ratios) for proposal in proposals])
        if columns:
            densities -= len(columns) * np.log(np.abs(draws[:, by]))
        log_weights = heights - logsumexp(densities + shares[:, None], axis=0)
        weights = np.exp(log_weights - logsumexp(log_weights))
        share = 1.0 / float(np.sum(weights**2)) / len(draws)
        if share * len(draws) > 2 * d:
            picked = random.choice(len(draws), 4 * len(draws), p=weights)
            proposals.append(Proposal.fitted(ratios[picked]))
        else:
            proposals.append(proposals[-1])
    z = random.multivariate_normal(noise, start.covariance[d:, d:], len(draws))
    draws = np.concatenate([draws, z], axis=1)
    return _posterior(target, draws, heights, weights, effective, seed, random, began), share


def _posterior(
    target: Target,
    draws: Array,
    heights: Array,
    weights: Array,
    effective: float,
    seed: int,
    random: np.random.RandomState,
    began: float,
    *,
    ensembles: int = 4,
    walkers: int = 10,
    steps: int = 50,
) -> Posterior:
    """Resample weighted draws; each ensemble has a quarter of them."""
    d, parts = draws.shape[1], []
    for part in range(ensembles):
        rows = np.arange(part, len(draws), ensembles)
        share = weights[rows] / weights[rows].sum()
        # systematic: a draw comes as often as its weight says, to one
        places = (random.rand() + np.arange(walkers * steps)) / (walkers * steps)
        drawn = np.minimum(np.searchsorted(np.cumsum(share), places), len(rows) - 1)
        parts.append(random.permutation(rows[drawn]))
    picked = np.array(parts).reshape(ensembles, walkers, steps)
    sampled = draws[picked]
    parameters = target.to_parameters(sampled.reshape(-1, d))[0].reshape(sampled.shape)
    problems: tuple[str, ...] = ()
    if effective < ENOUGH:
        problems = (
            f"only {effective:.0f} independent draws where {ENOUGH} were wanted: give narrower "
            "priors, or fix what is known",
        )
    rhat = nested_rhat(sampled)
    return Posterior(
        names=target.names,
        priors=target.priors,
        draws=parameters,
        log_density=heights[picked],
        diagnostics=Diagnostics(
            status="reliable" if not problems else "tentative" if effective > 100 else "unusable",
            problems=problems,
            rhat=np.asarray(rhat),
            tau=np.full(d, ensembles * walkers * steps / effective),
            ess=np.full(d, effective),
            acceptance=np.full((ensembles, walkers), effective / len(draws)),
            ensembles=ensembles,
            walkers=walkers,
            warmup=0,
            steps=steps,
            thin=1,
            not_finite=target.not_finite,
            seconds=time.perf_counter() - began,
        ),
        seed=seed,
    )
