"""Where to look: the point estimate with its noise, and other vectors that may be true."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.identifiability.local import LocalInformation, jacobian_of, units_of
from bayesfric.inference.likelihood.autoregression import burg
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.target import Target

Array = NDArray[np.float64]
Origin = Literal["estimate", "data and prior", "prior"]

# Grid of the search for noise scales: points a scale, and how often it is made finer.
_GRID = 7
_ROUNDS = 7
# What nothing confines moves by no more than this in a logarithm.
_WIDEST = 1.0
_TRIES = 40
# Rounds of bringing a drawn vector's output back, and the summed square of what may stay
# apart, in noise sds and for each parameter.
_REFITS = 8
_SUITS = 4.0


@dataclass(frozen=True, eq=False)
class Point:
    """One vector of sampled parameters, and where it comes from.

    Attributes
    ----------
    origin
        ``estimate``; ``data and prior``, drawn around it as far as both leave open;
        ``prior``, drawn from the priors alone.
    parameters
        ``(d,)`` noise scales last.
    """

    origin: Origin
    parameters: Array


def estimate_point(target: Target, estimate: Mapping[str, float]) -> Point:
    """Put a point estimate into sampled parameters, the most likely noise scales added.

    Parameters
    ----------
    target
        Likelihood, priors and noise.
    estimate
        Value of every free parameter of the chain; what lies outside its prior is moved
        to its edge.
    """
    free = target.free
    values = np.array(
        [
            np.clip(prior.turned(np.array(estimate[name])), prior.lower, prior.upper)
            for name, prior in zip(free, target.priors, strict=False)
        ]
    )
    return Point("estimate", np.concatenate([values, _likely_scales(target, values)]))


def points_around(
    target: Target,
    estimate: Point,
    local: LocalInformation,
    rng: np.random.Generator,
    *,
    around: int = 8,
    prior: int = 8,
) -> list[Point]:
    """Draw other vectors that may be true.

    Parameters
    ----------
    target
        Likelihood, priors and noise.
    estimate
        From :func:`estimate_point`.
    local
        Of the target at the estimate.
    rng
        Source of randomness.
    around
        How many to draw from the normal distribution that data and priors leave around
        the estimate, in logarithms; they are then moved by the least that makes their
        output that of the estimate again, which straight lines in logarithms do not keep.
    prior
        How many to draw from the priors.

    Returns
    -------
    list of Point
        Only those the priors allow and the model has finite outputs for: maybe fewer.
    """
    k = len(target.free)
    sds = np.array([p.sd() for p in target.priors[:k]])
    # beyond a factor e the normal in logarithms is no guide: further draws are the prior's job
    beforehand = np.maximum(np.nan_to_num(np.abs(local.units) / sds), 1.0 / _WIDEST)
    precision = local.information + np.diag(beforehand**2)
    values, vectors = np.linalg.eigh(precision)
    found: list[Point] = []
    goal = _outputs(target, estimate.parameters)
    for _ in range(_TRIES):
        if len(found) >= around:
            break
        step = vectors @ (rng.standard_normal(k) / np.sqrt(values))
        moved = moved_by(local, estimate.parameters[:k], step)
        drawn = _possible(target, "data and prior", moved, estimate)
        found += [one for point in drawn for one in _refitted(target, point, estimate, goal)]
    for row in np.stack([p.draw(prior, rng) for p in target.priors[:k]], axis=1):
        found += _possible(target, "prior", row, estimate)
    return found


def moved_by(local: LocalInformation, values: Array, step: Array) -> Array:
    """Move free parameters ``(k,)`` by a step in the local units, along logarithms."""
    return _moved(values, step, local.units, local.names, local.labels, local.shifted)


def _moved(
    values: Array,
    step: Array,
    units: Array,
    names: Sequence[str],
    labels: Sequence[str],
    shifted: NDArray[np.bool_],
) -> Array:
    out = values + step * units
    grown = np.exp(np.clip(step, -50.0, 50.0))
    for j, label in enumerate(labels):
        if label == names[j]:
            if not shifted[j]:
                out[j] = values[j] * grown[j]
        elif label.endswith("alpha_drive"):
            out[j] = (1.0 + values[j]) / grown[j] - 1.0
        else:
            out[j] = 1.0 - (1.0 - values[j]) / grown[j]
    return out


def _refitted(target: Target, point: Point, estimate: Point, goal: Array) -> list[Point]:
    """Bring a point's output back to the estimate's; nothing where that does not succeed."""
    k = len(target.free)
    for _ in range(_REFITS):
        gap = goal - _outputs(target, point.parameters)
        if gap @ gap < _SUITS * k:
            return [point]
        here = point.parameters
        units, labels, shifted = units_of(target, here[:k])
        scales = target.noise.scales(here[None, k:])[0]
        jacobian = jacobian_of(target, here, units, scales)
        if not np.isfinite(jacobian).all():
            return []
        left, size, right = np.linalg.svd(jacobian, full_matrices=False)
        # what the data hardly feel stays as it was drawn
        step = right.T @ np.where(size > 1.0, (left.T @ gap) / np.maximum(size, 1.0), 0.0)
        step *= min(1.0, 1.0 / max(float(np.abs(step).max()), 1e-12))
        moved = _moved(here[:k], step, units, target.free, labels, shifted)
        found = _possible(target, point.origin, moved, estimate)
        if not found:
            return []
        (point,) = found
    return []


def _outputs(target: Target, parameters: Array) -> Array:
    scales = target.noise.scales(parameters[None, len(target.free) :])[0]
    values = target.chain_values(parameters[None])
    outputs = target.likelihood.standardised(values, scales)
    return np.asarray(np.concatenate(outputs, axis=1)[0])


def _possible(target: Target, origin: Origin, values: Array, estimate: Point) -> list[Point]:
    k = len(target.free)
    parameters = np.concatenate([values, estimate.parameters[k:]])
    if not np.isfinite(target.log_prior(parameters[None])).all():
        return []
    scales = target.noise.scales(parameters[None, k:])[0]
    outputs = target.likelihood.standardised(target.chain_values(parameters[None]), scales)
    if not all(np.isfinite(block).all() for block in outputs):
        return []
    return [Point(origin, parameters)]


def _noise_of_residuals(target: Target, likelihood: TorqueLikelihood, chain: Array) -> Array:
    """Memory by Burg's method, and scales from what it leaves; ``chain`` ``(1, n_parameters)``."""
    noise = target.noise
    residuals = [
        o.measured - p[0]
        for o, p in zip(likelihood.outputs, likelihood.predict(chain), strict=True)
    ]
    runs = [o.follows for o in likelihood.outputs]
    scales = np.tile(likelihood.noise.starts(1.0)[0], (len(residuals), 1))
    sizes = np.array([float(np.sqrt(np.mean(r**2))) for r in residuals])
    order = likelihood.noise.order
    if order:
        unit = [r / s if s > 0.0 else r for r, s in zip(residuals, sizes, strict=True)]
        scales[:, 1:] = burg(unit, runs, order)
    for r, (residual, follows) in enumerate(zip(residuals, runs, strict=True)):
        left = likelihood.noise.standard(residual, follows, np.array([1.0, *scales[r, 1:]]))[0]
        scales[r, 0] = np.sqrt(np.mean(left**2))
    found = np.empty(len(noise.names))
    if len(set(noise.places[:, 0].tolist())) == 1:
        scales[:, 0] = np.sqrt(np.average(scales[:, 0] ** 2, weights=likelihood.sizes))
    found[noise.places] = scales
    low = np.array([p.lower for p in noise.priors])
    high = np.array([p.upper for p in noise.priors])
    return np.clip(found, np.nextafter(low, np.inf), np.nextafter(high, -np.inf))


def _likely_scales(target: Target, values: Array) -> Array:
    """Noise scales that make the measurements about most likely."""
    noise, likelihood = target.noise, target.likelihood
    chain = target.chain_values(np.concatenate([values, np.ones(len(noise.names))])[None])
    if isinstance(likelihood, TorqueLikelihood):
        return _noise_of_residuals(target, likelihood, chain)
    # torque and position noise: a grid that gets finer
    kinds = tuple(dict.fromkeys(noise.quantities))
    sets = len(noise.names) // len(kinds)
    tiny = np.finfo(np.float64).tiny
    low = np.log(np.maximum([p.lower for p in noise.priors[: len(kinds)]], tiny))
    high = np.log(np.minimum([p.upper for p in noise.priors[: len(kinds)]], 1e12))
    low = np.maximum(low, high - np.log(1e9))
    best = np.empty((sets, len(kinds)))
    # each set of scales has a grid of its own
    lows, highs = np.tile(low, (sets, 1)), np.tile(high, (sets, 1))
    for _ in range(_ROUNDS):
        axes = np.linspace(lows, highs, _GRID)  # (grid, sets, kinds)
        index = np.stack(
            np.meshgrid(*[np.arange(_GRID)] * len(kinds), indexing="ij"), axis=-1
        ).reshape(-1, len(kinds))
        grid = axes[index[:, None, :], np.arange(sets)[:, None], np.arange(len(kinds))]
        scales = np.broadcast_to(np.exp(grid), (len(grid), sets, len(kinds)))
        whole = np.broadcast_to(scales, (len(grid), len(noise.places), len(kinds)))
        terms = likelihood.pointwise(np.tile(chain, (len(grid), 1)), whole)
        sums = np.stack([t.sum(axis=1) for t in terms], axis=1)  # (grid, recordings)
        if sets == 1:
            sums = sums.sum(axis=1, keepdims=True)
        for r in range(sets):
            best[r] = grid[int(np.argmax(np.nan_to_num(sums[:, r], nan=-np.inf))), r]
        # the best and its neighbours, inside the priors
        reach = (highs - lows) / (_GRID - 1)
        lows, highs = np.maximum(best - reach, low), np.minimum(best + reach, high)
    return np.exp(best).reshape(-1)
