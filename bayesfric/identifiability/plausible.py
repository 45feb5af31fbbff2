"""Where to look: the point estimate with its noise, and other vectors that may be true."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayesfric.identifiability.local import LocalInformation, jacobian_of, units_of
from bayesfric.inference.likelihood.autoregression import burg
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array

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


def estimate_point(target: Target, estimate: Mapping[str, float]) -> Array:
    """Put a point estimate into sampled parameters, the most likely noise scales added.

    Of the ``estimate``, a value of every free parameter of the chain, what lies outside its
    prior is moved to its edge.
    """
    values = np.array(
        [
            np.clip(prior.turned(np.array(estimate[name])), prior.lower, prior.upper)
            for name, prior in zip(target.free, target.priors, strict=False)
        ]
    )
    return np.concatenate([values, _likely_scales(target, values)])


def points_around(
    target: Target,
    estimate: Array,
    local: LocalInformation,
    rng: np.random.Generator,
    around: int = 8,
) -> list[Array]:
    """Draw other vectors that may be true.

    So many ``around`` the estimate, whose picture is ``local``: from the normal distribution that
    data and priors leave there, in logarithms. They are then moved by the least that makes their
    output that of the estimate again, which straight lines in logarithms do not keep. Only those
    the priors allow and the model has finite outputs for: maybe fewer.
    """
    k = len(target.free)
    sds = np.array([p.sd() for p in target.priors[:k]])
    # beyond a factor e the normal in logarithms is no guide: further draws are the prior's job
    confined = np.maximum(np.nan_to_num(np.abs(local.units) / sds), 1.0 / _WIDEST)
    values, vectors = np.linalg.eigh(local.information + np.diag(confined**2))
    goal = _outputs(target, estimate)
    noise = estimate[k:]
    found: list[Array] = []
    for _ in range(_TRIES):
        if len(found) >= around:
            break
        step = vectors @ (rng.standard_normal(k) / np.sqrt(values))
        drawn = np.concatenate([local.moved(estimate[:k], step), noise])
        suiting = _refitted(target, drawn, goal)
        if suiting is not None:
            found.append(suiting)
    return found


def _refitted(target: Target, parameters: Array, goal: Array) -> Array | None:
    """Bring the output of parameters ``(d,)`` to a goal; nothing where that does not succeed."""
    k = len(target.free)
    for _ in range(_REFITS):
        outputs = _possible(target, parameters)
        if outputs is None:
            return None
        gap = goal - outputs
        if gap @ gap < _SUITS * k:
            return parameters
        at = units_of(target, parameters)
        jacobian = jacobian_of(target, parameters, at.units)
        if not np.isfinite(jacobian).all():
            return None
        left, size, right = np.linalg.svd(jacobian, full_matrices=False)
        # what the data hardly feel stays as it was drawn
        step = right.T @ np.where(size > 1.0, (left.T @ gap) / np.maximum(size, 1.0), 0.0)
        step *= min(1.0, 1.0 / max(float(np.abs(step).max()), 1e-12))
        parameters = np.concatenate([at.moved(parameters[:k], step), parameters[k:]])
    return None


def _outputs(target: Target, parameters: Array) -> Array:
    """Compute the outputs over their noise at parameters ``(d,)``."""
    scales = target.noise.scales(parameters[None, len(target.free) :])[0]
    outputs = target.likelihood.standardised(target.chain_values(parameters[None]), scales)
    return np.asarray(np.concatenate(outputs, axis=1)[0])


def _possible(target: Target, parameters: Array) -> Array | None:
    """Compute the same where priors and model have something there."""
    if not np.isfinite(target.log_prior(parameters[None])).all():
        return None
    outputs = _outputs(target, parameters)
    return outputs if np.isfinite(outputs).all() else None


def _likely_scales(target: Target, values: Array) -> Array:
    """Noise scales that make the measurements about most likely."""
    likelihood, size = target.likelihood, len(target.noise.names)
    chain = target.chain_values(np.concatenate([values, np.ones(size)])[None])
    if isinstance(likelihood, TorqueLikelihood):
        return _noise_of_residuals(target, likelihood, chain)
    return _finest_scales(target, chain)


def _noise_of_residuals(target: Target, likelihood: TorqueLikelihood, chain: Array) -> Array:
    """Memory by Burg's method, and scales from what it leaves; ``chain`` ``(1, n_parameters)``."""
    noise, order = target.noise, likelihood.noise.order
    predicted = likelihood.predict(chain)
    residuals = [o.measured - p[0] for o, p in zip(likelihood.outputs, predicted, strict=True)]
    scales = np.tile(likelihood.noise.starts(1.0)[0], (len(residuals), 1))
    if order:
        sizes = [float(np.sqrt(np.mean(r**2))) or 1.0 for r in residuals]
        unit = [r / size for r, size in zip(residuals, sizes, strict=True)]
        scales[:, 1:] = burg(unit, [o.follows for o in likelihood.outputs], order)
    scales[:, 0] = 1.0
    left = likelihood.innovations(residuals, scales)
    scales[:, 0] = [np.sqrt(np.mean(x**2)) for x in left]
    if len(set(noise.places[:, 0].tolist())) == 1:
        scales[:, 0] = np.sqrt(np.average(scales[:, 0] ** 2, weights=likelihood.sizes))
    found = np.empty(len(noise.names))
    found[noise.places] = scales
    low, high = np.array([(p.lower, p.upper) for p in noise.priors]).T
    return np.asarray(np.clip(found, np.nextafter(low, np.inf), np.nextafter(high, -np.inf)))


def _finest_scales(target: Target, chain: Array) -> Array:
    """Search torque and position noise on a grid that gets finer; each recording may have one."""
    noise = target.noise
    kinds = len(dict.fromkeys(noise.quantities))
    sets = len(noise.names) // kinds
    tiny = np.finfo(np.float64).tiny
    low = np.log(np.maximum([p.lower for p in noise.priors[:kinds]], tiny))
    high = np.log(np.minimum([p.upper for p in noise.priors[:kinds]], 1e12))
    low = np.maximum(low, high - np.log(1e9))
    lows, highs = np.tile(low, (sets, 1)), np.tile(high, (sets, 1))
    index = np.indices((_GRID,) * kinds).reshape(kinds, -1).T
    best = lows
    for _ in range(_ROUNDS):
        axes = np.linspace(lows, highs, _GRID)  # (grid, sets, kinds)
        grid = axes[index[:, None, :], np.arange(sets)[:, None], np.arange(kinds)]
        scales = np.broadcast_to(np.exp(grid), (len(grid), len(noise.places), kinds))
        terms = target.likelihood.pointwise(np.tile(chain, (len(grid), 1)), scales)
        sums = np.stack([t.sum(axis=1) for t in terms], axis=1)  # (grid, recordings)
        sums = sums.sum(axis=1, keepdims=True) if sets == 1 else sums
        highest = np.argmax(np.nan_to_num(sums, nan=-np.inf), axis=0)
        best = grid[highest, np.arange(sets)]
        # the best and its neighbours, inside the priors
        reach = (highs - lows) / (_GRID - 1)
        lows, highs = np.maximum(best - reach, low), np.minimum(best + reach, high)
    return np.asarray(np.exp(best).reshape(-1))
