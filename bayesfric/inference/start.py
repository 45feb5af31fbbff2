"""Start of sampling: the posterior's mode and the spread of the walkers around it.

Direction-dependent friction leaves kinks and several peaks in the density, and bounds truncate it,
which plain optimisers do not allow for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayesfric.inference.closed_loop import ClosedLoopLikelihood
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array

LogDensity = Callable[[Array], Array]

# Candidates from which a climb starts.
CLIMBS = 5


@dataclass(frozen=True)
class Start:
    """A normal distribution of starts, in sampling coordinates."""

    mode: Array  # (d,)
    covariance: Array  # (d, d)

    def draw(
        self, n: int, log_density: LogDensity, rng: np.random.Generator, *, spread: float = 1.5
    ) -> Array:
        """Draw over-dispersed starts ``(n, d)`` of non-zero probability.

        Impossible starts are redrawn closer to the mode: emcee would keep such a walker stuck.
        """
        root = np.linalg.cholesky(self.covariance)
        starts = np.empty((n, self.mode.size))
        missing = np.arange(n)
        for _ in range(60):
            z = rng.standard_normal((missing.size, self.mode.size))
            starts[missing] = self.mode + spread * (z @ root.T)
            missing = missing[~np.isfinite(log_density(starts[missing]))]
            if missing.size == 0:
                return starts
            spread *= 0.9
        raise RuntimeError("no start of non-zero probability beside the posterior's mode")


def place_and_widths(target: Target, start: Start) -> tuple[Array, Array]:
    """Convert a normal in coordinates to parameters: centre and standard deviations, ``(d,)``."""
    spread = np.sqrt(np.diag(start.covariance))
    sds = np.diag(np.minimum(spread, 1.0 + np.abs(start.mode)))
    centre, up, down = (
        target.to_parameters(u)[0] for u in (start.mode[None], start.mode + sds, start.mode - sds)
    )
    # a gearbox' coordinates mix parameters
    change = (up - down) / 2.0
    correlation = start.covariance / np.outer(spread, spread)
    widths = np.sqrt(np.einsum("ij,ik,kj->j", change, correlation, change).clip(0.0))
    widths = np.where(np.isfinite(widths), widths, np.abs(centre[0]))
    return centre[0], np.maximum(widths, 1e-12 * np.abs(centre[0]) + 1e-300)


def unwrapped(target: Target, parameters: Array) -> Array:
    """Unwrap angles of parameters ``(n, d)`` or ``(n, free)`` to their priors' turn."""
    columns = zip(target.priors, parameters.T, strict=False)
    return np.stack([prior.turned(column) for prior, column in columns], axis=1)


def gauss_newton(target: Target, mode: Array, prior_draws: Array) -> Start:
    """Approximate the posterior at ``mode`` ``(d,)`` by a normal, without bounds.

    The curvature at a mode on a bound would be misleading. The information is ``J'J`` of the
    standardised outputs, that of the noise scales, and the priors' inverse variance, from the
    central 68 % of their draws ``(n, d)``.
    """
    k, d = len(target.free), mode.size
    low, high = np.nanquantile(prior_draws, [0.16, 0.84], axis=0)
    prior_sd = (high - low) / 2.0
    prior_sd = np.where(np.isfinite(prior_sd) & (prior_sd > 0.0), prior_sd, np.inf)
    reach = np.abs(mode) + 1e-3 * np.where(np.isfinite(prior_sd), prior_sd, 1.0)
    steps = 1e-6 * np.minimum(reach, 1e3)
    shifted, _ = target.to_parameters(mode + np.concatenate([np.diag(steps), -np.diag(steps)]))
    centre, _ = target.to_parameters(mode[None])
    scales = target.noise.scales(centre[:, k:])[0]
    values = target.chain_values(np.concatenate([shifted, centre]))
    subsampled, all_outputs = target.likelihood.subsample(), target.likelihood.outputs
    jacobian = np.concatenate(
        [
            _differences(output, steps) * np.sqrt(full.measured.size / subset.measured.size)
            for output, subset, full in zip(
                subsampled.standardised(values, scales),
                subsampled.outputs,
                all_outputs,
                strict=True,
            )
        ],
        axis=1,
    )
    information = jacobian @ jacobian.T + np.diag(1.0 / prior_sd**2)
    slope = ((np.diag(shifted[:d]) - np.diag(shifted[d:])) / (2.0 * steps))[k:]
    assert not isinstance(target.likelihood, ClosedLoopLikelihood)
    noise = target.noise.fold(target.likelihood.noise_information(scales))
    information[k:, k:] += noise * np.outer(slope, slope)
    scale = 1.0 / np.sqrt(np.diag(information))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    inverse = (vectors / np.clip(values, 1e-12, None)) @ vectors.T
    return Start(mode, inverse * np.outer(scale, scale))


def _differences(output: Array, steps: Array) -> Array:
    """Differentiate outputs ``(2d + 1, n)``: a step up, a step down and the centre.

    A step outside the support has no output; the other side is used, or zero without either.
    """
    d = steps.size
    up, down, centre = output[:d], output[d : 2 * d], output[2 * d]
    right, left = (up - centre) / steps[:, None], (centre - down) / steps[:, None]
    usable = np.stack([np.isfinite(right).all(axis=1), np.isfinite(left).all(axis=1)])
    weights = (usable / np.maximum(usable.sum(axis=0), 1))[:, :, None]
    return np.asarray(weights[0] * np.nan_to_num(right) + weights[1] * np.nan_to_num(left))


def climb(
    log_density: LogDensity,
    candidates: Array,
    *,
    climbs: int = CLIMBS,
    max_steps: int = 60,
    widths: Array | None = None,
    on_step: Callable[[Array], None] = lambda _: None,
) -> Array:
    """Climb to the mode from the best of candidates ``(n, d)``.

    Newton steps with a Hessian by finite differences, damped by Levenberg and Marquardt. Difference
    steps, at first ``widths`` ``(d,)``, adapt to a fall of the log density by half a unit, which
    averages over kinks.
    """
    heights = log_density(candidates)
    # Direction-dependent losses make several peaks, and the best candidate may climb a lower one.
    order = [i for i in np.argsort(-heights)[:climbs] if np.isfinite(heights[i])]
    if not order:
        raise ValueError("every starting point has zero probability")
    peaks = [
        _climb(log_density, candidates[i], heights[i], max_steps, widths, on_step) for i in order
    ]
    return max(peaks, key=lambda peak: peak[1])[0]


def _climb(
    log_density: LogDensity,
    x: Array,
    height: float,
    max_steps: int,
    widths: Array | None,
    on_step: Callable[[Array], None],
) -> tuple[Array, float]:
    """Climb from one place until a step gains less than 1e-3; return the peak and its density."""
    damping = 1.0
    initial = 0.1 * (np.abs(x) + 1e-3) if widths is None else widths
    steps = _difference_steps(log_density, x, height, initial)
    for _ in range(max_steps):
        on_step(x)
        steps = _difference_steps(log_density, x, height, steps)
        gradient, hessian = _derivatives(log_density, x, height, steps)
        gradient, curvature = gradient * steps, -hessian * np.outer(steps, steps)
        values, vectors = np.linalg.eigh((curvature + curvature.T) / 2.0)
        rotated = vectors.T @ gradient
        # eight dampings are evaluated at once
        dampings = damping * 10.0 ** np.arange(-3.0, 5.0)
        clipped = np.clip(values, 1e-3, None)
        trials = x + np.array([vectors @ (rotated / (clipped + d)) for d in dampings]) * steps
        heights = log_density(trials)
        best = int(np.argmax(heights))
        gain = heights[best] - height
        if not gain > 0.0:
            if damping > 1e8:
                break
            damping *= 1e3
            continue
        x, height = trials[best], float(heights[best])
        damping = float(np.clip(dampings[best], 1e-6, 1e6))
        if gain < 1e-3:
            break
    return x, height


def _difference_steps(log_density: LogDensity, x: Array, height: float, steps: Array) -> Array:
    """Find steps ``(d,)`` that change the log density by half a unit or end at a bound."""
    steps = steps.copy()
    # near a bound: do not widen again
    too_wide = np.zeros(x.size, dtype=bool)
    for _ in range(20):
        trials = np.concatenate([x + np.diag(steps), x - np.diag(steps)])
        fall = np.abs(log_density(trials) - height).reshape(2, -1).max(axis=0)
        narrow, wide = fall < 0.1, ~(fall < 4.0)
        # if the density is constant, keep a finite step
        narrow &= steps < 1e3 * (np.abs(x) + 1.0)
        too_wide |= wide
        narrow &= ~too_wide
        if not (narrow | wide).any():
            break
        steps[narrow] *= 2.0
        steps[wide] /= 3.0
    return steps


def _derivatives(
    log_density: LogDensity, x: Array, height: float, steps: Array
) -> tuple[Array, Array]:
    """Gradient ``(d,)`` and Hessian ``(d, d)`` by central differences, in one batch."""
    d = x.size
    rows, columns = np.triu_indices(d, 1)
    pair = np.zeros((rows.size, d))
    pair[np.arange(rows.size), rows] = steps[rows]
    pair[np.arange(rows.size), columns] = steps[columns]
    step = np.diag(steps)
    values = log_density(np.concatenate([x + step, x - step, x + pair, x - pair]))
    # outside the support the density falls steeply
    values = np.where(np.isfinite(values), values, height - 50.0)
    up, down, both, neither = np.split(values, [d, 2 * d, 2 * d + rows.size])
    gradient = (up - down) / (2.0 * steps)
    hessian = np.diag((up - 2.0 * height + down) / steps**2)
    curvature = up + down
    mixed = (both + neither + 2.0 * height - curvature[rows] - curvature[columns]) / 2.0
    hessian[rows, columns] = hessian[columns, rows] = mixed / (steps[rows] * steps[columns])
    return gradient, hessian
