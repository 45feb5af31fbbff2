"""Where identifiability is looked at: the point estimate, with noise to fit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayesfric.inference.likelihood.autoregression import burg
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.target import Target
from bayesfric.recordings.arrays import Array

# Grid of the search for noise scales: points a scale, and how often it is made finer.
_GRID = 7
_ROUNDS = 7


def estimate_point(target: Target, estimate: Mapping[str, float]) -> Array:
    """Put a point estimate into sampled parameters, the most likely noise scales added.

    For a likelihood of the torque, partial autocorrelations are Burg's and the scale is the root
    mean square of the innovations; else noise of torque and position are searched on a grid.

    Shapes: returns (d,).
    """
    values = np.array(
        [
            np.clip(prior.turned(np.array(estimate[name])), prior.lower, prior.upper)
            for name, prior in zip(target.free, target.priors, strict=False)
        ]
    )
    return np.concatenate([values, _likely_scales(target, values)])


def _likely_scales(target: Target, values: Array) -> Array:
    """Noise scales that make the measurements about most likely."""
    likelihood, size = target.likelihood, len(target.noise.names)
    chain = target.chain_values(np.concatenate([values, np.ones(size)])[None])
    if isinstance(likelihood, TorqueLikelihood):
        return _noise_of_residuals(target, likelihood, chain)
    return _finest_scales(target, chain)


def _noise_of_residuals(target: Target, likelihood: TorqueLikelihood, chain: Array) -> Array:
    """Autocorrelation by Burg's method, and scales from what it leaves.

    ``chain`` is ``(1, n_parameters)``; scales are kept inside their priors.
    """
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
    """Search torque and position noise on a grid that gets finer; each recording may have one.

    Seven points a scale, seven times around the best, in logarithms and within the priors.
    """
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
