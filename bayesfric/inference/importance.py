"""The mode by Fisher scoring, and draws by importance: for a likelihood that takes milliseconds.

Draws come from a normal at the mode with a wider t around it, which is fitted again to the weighted
draws of all rounds so far; weights are over the mixture of all proposals (adaptive multiple
importance sampling; Cornuet, Marin, Mira and Robert, Scandinavian Journal of Statistics 39 (2012)
798-812). Noise scales are drawn from the normal at their mode, and the parameters at the mode's
noise: what moves a prediction and what spreads it are orthogonal in Fisher's information.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import logsumexp

from bayesfric.base.progress import Progress, ProgressCallback, no_progress
from bayesfric.inference.posterior import Diagnostics, Posterior, nested_rhat
from bayesfric.inference.proposals import Proposal
from bayesfric.inference.start import Start
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array

# Independent draws that suffice: ends of a 90 % interval to a tenth of a standard deviation.
ENOUGH = 300
# Largest number of draws, and the share of them that counts below which they are not trusted.
MOST, EFFICIENT = 4000, 0.1


def score(
    target: Target,
    start: Array,
    spread: Array,
    *,
    most: int = 30,
    on_step: Callable[[float], None] = lambda _: None,
) -> Array:
    """Climb from coordinates ``(d,)`` to the mode by Fisher scoring.

    ``spread`` ``(d,)`` is the prior's, the longest step.
    """
    u, height, damping, small = start, float(target(start[None])[0]), 1e-3, 0
    for _ in range(most):
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
        small = small + 1 if gain < 0.05 else 0
        if small >= 2:
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
    most: int = MOST,
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
        if effective >= enough or len(draws) >= most:
            break
        # a few to learn the shape from, then as many as are wanted at the efficiency so far, but
        number = max(20 * d, int(1.2 * (enough - effective) / max(share, 0.05)))
        # at most as many as there are: early efficiencies are too low
        number = min(number, max(len(draws), 20 * d), most - len(draws))
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
