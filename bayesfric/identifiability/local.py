"""The Fisher information of the likelihood at one parameter vector.

Null directions of the Jacobian, standard deviations from the data alone, and from them the verdict
whether data, prior or both determine a parameter.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.estimates.assemble import open_directions
from bayesfric.estimates.autoregression import burg
from bayesfric.estimates.information import NULL, Directions, directions
from bayesfric.estimates.point_estimate import Knowledge
from bayesfric.estimates.torque import torque_jacobian, typical_load
from bayesfric.inference.likelihood import TorqueLikelihood
from bayesfric.inference.priors import Prior
from bayesfric.inference.target import LocalUnits, Target, units_of
from bayesfric.mechanism.derived import Derived, derivatives
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import scales_with_torque
from bayesfric.recordings.arrays import Array, rms
from bayesfric.recordings.signals import Signals
from bayesfric.results.reported import Determined

# Central differences of a linear torque err by rounding alone, 1e-16 of the torque over twice this
# step: 1e-10 of the largest singular value, a thousandth of NULL.
_STEP = 1e-6
# A simulation's rounding is larger by the number of its steps, and it is not quite linear.
_NULL_SIMULATED = 1e-6
# A direction with a larger sd of the logarithm is weak: a factor exp(0.5) = 1.6 either way.
WEAK = 0.5
# Share of the prior's sd above which data do not determine a number.
WIDE = 0.5
# Entries of a null direction smaller than this are rounding.
_ROUNDING = 1e-5


def meaning_of(exponents: Mapping[str, float], in_units: Mapping[str, str] | None = None) -> str:
    """Describe in words a change that the data do not show."""
    names, in_units = ", ".join(exponents), in_units or {}
    if len(exponents) == 1:
        return f"{names} does not show in the data at all"
    if not in_units and all(abs(x - 1.0) < _ROUNDING for x in exponents.values()):
        return f"{names} can all be multiplied by one factor: the data stay the same"
    changes = (
        f"{name} by {x:+.2g} {in_units[name]}" if name in in_units else f"{name} by k^{x:.3g}"
        for name, x in exponents.items()
    )
    together = ", ".join(map(str.strip, changes))
    return f"changing {together} together leaves the data the same, for k near 1"


@dataclass(frozen=True, eq=False)
class LocalInformation(LocalUnits):
    """Fisher information of the torque near one parameter vector, in :class:`LocalUnits`."""

    # (d,) sd from the data alone, in the parameter's unit; infinite in a null direction
    data_sd: Array
    # (n_null, d) null directions in those units, the largest entry one; scalings first
    null_rows: Array
    directions: Directions  # of the Jacobian over the noise
    from_theory: int = 0  # how many null directions are scalings of section 4.2

    @property
    def null_directions(self) -> tuple[dict[str, float], ...]:
        """Null directions in the order of ``null_rows``: by label its power of a common factor.

        Of a parameter next to zero it is the change in units of the prior's standard deviation.
        """
        return tuple(
            {
                label: round(x, 9)
                for label, x in zip(self.labels, row.tolist(), strict=True)
                if abs(x) > _ROUNDING
            }
            for row in self.null_rows
        )

    @property
    def information(self) -> Array:
        """Fisher information ``(d, d)`` in those units; exactly nothing along null directions."""
        rows = self.directions.identified
        return np.asarray(rows.T @ rows)

    def data_sd_of(self, gradient: Array, *, gauge_free: bool = False) -> float:
        """Give the sd from the data alone of a function of gradient ``(d,)``."""
        if gauge_free:
            gradient = self.directions.off_known(gradient)
        return self.directions.sd(gradient)


def local_information(target: Target, parameters: Array) -> LocalInformation:
    """Compute the Fisher information at sampled parameters ``(d,)``.

    For load-dependent friction the logarithm is that of ``alpha_1 = 1/(1 + mu_1)`` and ``alpha_2 =
    1/(1 - mu_2)``, in which leg and gearbox scale along a straight line.
    """
    chain, observations = target.likelihood.chain, target.likelihood.observations
    at = units_of(target, parameters)
    units = at.units
    values = target.chain_values(parameters[None])[0]
    scalings = open_directions(chain, fixed_in(target, values), observations, values) / units
    jacobian = jacobian_of(target, parameters, units)
    if not np.isfinite(jacobian).all():
        raise BadInput(
            "identifiability",
            "the simulated motion cannot be differentiated at these parameters",
            'use method = "input-error", or priors that keep parameters off their bounds',
        )
    tolerance = NULL if target.likelihood.method == "input-error" else _NULL_SIMULATED
    from_theory, of_torque = len(scalings), _torque_scaling(target, values) / units
    least = tolerance * np.linalg.norm(jacobian, ord=2) * np.linalg.norm(of_torque)
    if of_torque.any() and np.linalg.norm(jacobian @ of_torque) < least:
        scalings = np.vstack([scalings, of_torque])
    decomposed = directions(jacobian, np.ones(units.size), tolerance, known_null=scalings)
    # the Jacobian is in these units already
    decomposed = replace(decomposed, units=units)
    rows = _null_basis(decomposed.rows[decomposed.null], scalings)
    unknown = np.full(units.size, np.nan)
    local = LocalInformation(**vars(at), data_sd=unknown, null_rows=rows, directions=decomposed)
    sds = np.array([local.data_sd_of(gradient) for gradient in np.eye(units.size)])
    return replace(local, data_sd=sds, from_theory=from_theory)


def _torque_scaling(target: Target, values: Array) -> Array:
    """Give the change ``(d,)`` of everything that is a torque by one factor, with a free kp."""
    rows = {p.name: p for p in target.likelihood.chain.parameters}
    named = dict(zip(target.likelihood.chain.names, values.tolist(), strict=True))
    free = "drive.kp" in target.free
    return np.array([named[n] * (free and scales_with_torque(rows[n].unit)) for n in target.free])


def fixed_in(target: Target, values: Array) -> Knowledge:
    """Give the values ``(n_parameters,)`` that are not free as knowledge."""
    named = zip(target.likelihood.chain.names, values.tolist(), strict=True)
    return Knowledge({name: value for name, value in named if name not in target.free})


def in_natural_units(
    target: Target, parameters: Array, local: LocalInformation
) -> LocalInformation:
    """Use units of torque for values that are small next to their sd from the data.

    The logarithm of a value that may be zero means nothing. Where its sd from the data is finite
    and its logarithm would be weak, the unit change is the one that makes a tenth of the measured
    torque (or the prior's sd, if less). Load-dependent friction keeps its logarithm of alpha.
    """
    likelihood = target.likelihood
    values = target.chain_values(parameters[None])[0]
    jacobian = torque_changes(likelihood.chain, likelihood.observations, values, local)
    effect = np.linalg.norm(jacobian, axis=0)
    measured = np.concatenate([o.measured for o in likelihood.observations])
    k = len(local.names)
    sds = np.array([p.sd() for p in target.priors[:k]])
    with np.errstate(divide="ignore"):
        floor = np.fmin(0.1 * np.linalg.norm(measured) / effect, sds)
    size = np.abs(parameters[:k])
    small = np.isfinite(local.data_sd) & (WEAK * size < local.data_sd) & (size < floor)
    small &= local.ways == 0
    units = np.where(small, floor, local.units)
    d = local.directions
    decomposed = directions(d.identified * (units / local.units), np.ones(k), d.tolerance)
    return replace(
        local,
        units=units,
        shifted=local.shifted | small,
        directions=replace(decomposed, units=units),
    )


def torque_changes(
    chain: Joint, observations: Sequence[Signals], values: Array, at: LocalUnits
) -> Array:
    """Differentiate the filtered torque by the free parameters: ``(n_outputs, d)``."""
    columns = [chain.names.index(name) for name in at.names]
    steps = np.zeros(values.size)
    steps[columns] = _STEP * np.abs(at.units)
    return torque_jacobian(chain, observations, values, steps)[:, columns]


def joined(*rows: Array) -> Directions:
    """Decompose several Jacobians ``(n, d)`` together."""
    return directions(np.concatenate(rows), np.ones(rows[0].shape[1]), 1e-13)


def prior_rows(target: Target, local: LocalInformation) -> Array:
    """Give the priors' information as a Jacobian ``(d, d)`` in the local units."""
    sds = np.array([p.sd() for p in target.priors[: len(target.free)]])
    ratio = np.abs(local.units) / sds
    return np.diag(np.where(np.isfinite(ratio), ratio, 0.0))


def derived_gradients(
    target: Target, parameters: Array, local: LocalInformation
) -> Iterator[tuple[Derived, float, Array]]:
    """Give each derived quantity at sampled parameters, with its gradient in local units."""
    chain, observations = target.likelihood.chain, target.likelihood.observations
    values, columns = (
        target.chain_values(parameters[None])[0],
        [*map(chain.names.index, local.names)],
    )
    steps = np.zeros(values.size)
    steps[columns] = 1e-5 * np.abs(local.units)
    load = typical_load(chain, observations, values)
    for q, value, slopes in derivatives(chain, values, steps, load):
        yield q, value, slopes[columns] * local.units


def verdict(posterior_sd: float, prior_sd: float, data_sd: float) -> Determined:
    """Whether data, prior or both determined a parameter."""
    if not data_sd > 0.0 or not posterior_sd > 0.0:  # or nan
        return "prior"
    width = prior_sd if np.isfinite(prior_sd) and prior_sd > 0 else np.inf
    left, share = posterior_sd / width, posterior_sd / data_sd
    if left > 0.9 or share < (0.5 if data_sd > WIDE * width else 0.2):
        return "prior"
    return "data" if 0.85 < share < 1.5 and left < WIDE else "weak"


def given_by(
    local: LocalInformation,
    priors: Sequence[Prior],
    gradient: Array,
    sd: float,
    prior_sd: float,
    own: int | None = None,
    wider: float = 1.5,
) -> list[str]:
    """Name the informative priors that determine a number which the data leave open.

    Where a common factor changes no torque, the data leave each number in it open, and a prior on
    one, such as a weight on scales, determines all. With these priors the sd is at most ``wider``
    times what it is, without them at least twice as much.
    """
    if (np.isfinite(prior_sd) and sd >= WIDE * prior_sd) or not np.isfinite(gradient).all():
        return []
    free_priors = priors[: len(local.names)]
    with np.errstate(divide="ignore"):
        weights = np.abs(local.units) / np.array([prior.sd() for prior in free_priors])
    weights = np.nan_to_num(weights, nan=0.0, posinf=0.0)
    if own is not None:
        weights[own] = 0.0
    default = np.array([prior.default for prior in free_priors])
    informative = [int(i) for i in np.flatnonzero(~default & (weights > 0.0))]

    def sd_with(chosen: Collection[int]) -> float:
        counted = default | np.isin(np.arange(weights.size), list(chosen))
        rows = np.diag(np.where(counted, weights, 0.0))
        return joined(local.directions.identified, rows).sd(gradient * local.units)

    with_all = sd_with(informative)
    # bounds, or its own prior, narrow the number further
    if not informative or not with_all < wider * sd or sd_with(()) < 2.0 * with_all:
        return []
    best = min(informative, key=lambda i: sd_with((i,)))
    if sd_with((best,)) < wider * with_all:
        return [local.names[best]]
    needed = [i for i in informative if sd_with({*informative} - {i}) > wider * with_all]
    return [local.names[i] for i in needed or informative]


def jacobian_of(target: Target, parameters: Array, units: Array) -> Array:
    """Differentiate the modelled outputs over their noise, ``(n_outputs, d)`` per unit.

    Central differences, one-sided on a bound of the support.
    """
    k = units.size
    support = {p.name: (p.lower, p.upper) for p in target.likelihood.chain.parameters}
    low, high = np.array([support[name] for name in target.free]).T
    point, steps = parameters[:k], _STEP * units
    points = np.tile(parameters, (2 * k, 1))
    index = np.arange(k)
    # one-sided on a bound: nothing can be simulated beyond it
    points[index, index] = np.clip(point + steps, low, high)
    points[k + index, index] = np.clip(point - steps, low, high)
    widths = (points[index, index] - points[k + index, index]) / units
    scales = target.noise.scales(parameters[None, k:])[0]
    outputs = target.likelihood.standardised(target.chain_values(points), scales)
    return np.concatenate([(o[:k] - o[k:]) / widths[:, None] for o in outputs], axis=1).T


def _null_basis(rows: Array, theory: Array) -> Array:
    """Give a sparse basis ``(n_null, d)`` of the null space, scalings first.

    The others are determined up to scalings: one entry for each of those is eliminated, so that
    fewest remain.
    """
    named = [row / row[int(np.argmax(np.abs(row)))] for row in theory if row.any()]
    rest = rows
    for row in named:
        if len(rest) < 2:
            rest = rest[:0]
            break
        choices = [
            _sparse(np.linalg.svd(rest - np.outer(rest[:, c] / row[c], row))[2][: len(rest) - 1])
            for c in np.flatnonzero(np.abs(row) > 1e-6)
        ]
        rest = min(choices, key=lambda basis: float(np.abs(basis).sum()))
    return np.array([*named, *_sparse(rest)]).reshape(-1, rows.shape[1])


def _sparse(rows: Array) -> Array:
    """Bring a basis of the null space to reduced row echelon form."""
    basis = rows.copy()
    for i in range(basis.shape[0]):
        pivot = int(np.argmax(np.abs(basis[i])))
        basis[i] /= basis[i, pivot]
        for j in range(basis.shape[0]):
            if j != i:
                basis[j] -= basis[j, pivot] * basis[i]
    return np.array([row / row[int(np.argmax(np.abs(row)))] for row in basis]).reshape(rows.shape)


def estimate_point(target: Target, estimate: Mapping[str, float]) -> Array:
    """Complete a point estimate to sampled parameters ``(d,)`` by the most likely noise.

    For a likelihood of the torque, partial autocorrelations are Burg's and the scale is the root
    mean square of the innovations; noise of torque and position are searched on a grid.
    """
    pairs = zip(target.free, target.priors, strict=False)
    turned = [(p.turned(np.array(estimate[name])), p.lower, p.upper) for name, p in pairs]
    values = np.array([np.clip(*bounded) for bounded in turned])
    return np.concatenate([values, _likely_scales(target, values)])


def _likely_scales(target: Target, values: Array) -> Array:
    """Estimate the noise scales at which the measurements are about most likely."""
    noise, likelihood = target.noise, target.likelihood
    chain = target.chain_values(np.concatenate([values, np.ones(len(noise.names))])[None])
    if not isinstance(likelihood, TorqueLikelihood):
        return _finest_scales(target, chain)
    predicted = likelihood.predict(chain)
    residuals = [o.measured - p[0] for o, p in zip(likelihood.outputs, predicted, strict=True)]
    scales = np.tile(likelihood.noise.starts(1.0)[0], (len(residuals), 1))
    if order := likelihood.noise.order:
        sizes = [rms(x) or 1.0 for x in residuals]
        unit = [x / size for x, size in zip(residuals, sizes, strict=True)]
        scales[:, 1:] = burg(unit, [o.follows for o in likelihood.outputs], order)
    scales[:, 0] = 1.0
    innovations = likelihood.innovations(residuals, scales)
    scales[:, 0] = [np.sqrt(np.mean(x**2)) for x in innovations]
    if len(set(noise.places[:, 0].tolist())) == 1:
        scales[:, 0] = np.sqrt(np.average(scales[:, 0] ** 2, weights=likelihood.sizes))
    likely = np.empty(len(noise.names))
    likely[noise.places] = scales
    low, high = np.array([(p.lower, p.upper) for p in noise.priors]).T
    return np.asarray(np.clip(likely, np.nextafter(low, np.inf), np.nextafter(high, -np.inf)))


def _finest_scales(target: Target, chain: Array, points: int = 7) -> Array:
    """Search noise scales of torque and position on a grid in logarithms, refined seven times."""
    noise = target.noise
    kinds = len(dict.fromkeys(noise.quantities))
    sets = len(noise.names) // kinds
    tiny = np.finfo(np.float64).tiny
    low = np.log(np.maximum([p.lower for p in noise.priors[:kinds]], tiny))
    high = np.log(np.minimum([p.upper for p in noise.priors[:kinds]], 1e12))
    low = np.maximum(low, high - np.log(1e9))
    lows, highs = np.tile(low, (sets, 1)), np.tile(high, (sets, 1))
    index = np.indices((points,) * kinds).reshape(kinds, -1).T
    best = lows
    for _ in range(7):
        axes = np.linspace(lows, highs, points)  # (grid, sets, kinds)
        grid = axes[index[:, None, :], np.arange(sets)[:, None], np.arange(kinds)]
        scales = np.broadcast_to(np.exp(grid), (len(grid), len(noise.places), kinds))
        terms = target.likelihood.pointwise(np.tile(chain, (len(grid), 1)), scales)
        sums = np.stack([t.sum(axis=1) for t in terms], axis=1)  # (grid, recordings)
        sums = sums.sum(axis=1, keepdims=True) if sets == 1 else sums
        highest = np.argmax(np.nan_to_num(sums, nan=-np.inf), axis=0)
        best = grid[highest, np.arange(sets)]
        # the best and its neighbours, inside the priors
        reach = (highs - lows) / (points - 1)
        lows, highs = np.maximum(best - reach, low), np.minimum(best + reach, high)
    return np.asarray(np.exp(best).reshape(-1))
