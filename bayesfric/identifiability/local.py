"""What the likelihood alone determines near one parameter vector: its Fisher information.

Null directions of the Jacobian, standard deviations that the data alone would leave, and from them
the verdict by whom a parameter was determined: the data, the prior, or both.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.estimates.assemble import open_directions
from bayesfric.estimates.information import NULL, Directions, directions
from bayesfric.estimates.knowledge import Knowledge
from bayesfric.estimates.torque import torque_jacobian, typical_load
from bayesfric.inference.likelihood.autoregression import burg
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.local_units import LocalUnits, units_of
from bayesfric.inference.prior.priors import Prior
from bayesfric.inference.target import Target
from bayesfric.mechanism.derived import Derived, derive
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation
from bayesfric.results.reported import Determined

# Central differences of a torque that is linear are wrong by rounding alone: some 1e-16 of
# the torque over twice this step. That is 1e-10 of the largest singular value, a thousandth
# of what NULL allows; what any real recording leaves open is far above both.
_STEP = 1e-6
# A simulation's rounding is larger by the number of its steps, and it is not quite linear.
_NULL_SIMULATED = 1e-6
# A direction along which the data leave more than this in a logarithm is weak: a factor
# exp(0.5) = 1.6 either way.
WEAK = 0.5
# Share of the prior's sd from which on data do not determine a number.
WIDE = 0.5
# What told priors settle is, without its own, not much wider than it came out, and at least so many
# times as wide without those.
_WIDER, _BETTER = 1.5, 2.0
# Share of the measured torque that counts as one for values the data cannot tell from zero.
_FELT = 0.1
# Step of the derivatives of what is derived, in the local units.
_BESIDE = 1e-5
# Singular values below this share of the largest are rounding once null directions are out.
_JOINED = 1e-13
# Entries of a null direction smaller than this do not belong to it.
_ROUNDING = 1e-5


@dataclass(frozen=True)
class NullDirection:
    """Parameters that can change together without changing any predicted torque."""

    # By parameter (or alpha of a load loss) its relative change, the largest being one: the powers
    # of one factor. One that is next to zero changes in units of its prior sd
    exponents: dict[str, float]

    @property
    def meaning(self) -> str:
        """The same in words, see :func:`meaning_of`."""
        return meaning_of(self.exponents)


def meaning_of(exponents: Mapping[str, float], in_units: Mapping[str, str] | None = None) -> str:
    """Say in words what no torque tells."""
    names, in_units = ", ".join(exponents), in_units or {}
    if len(exponents) == 1:
        return f"{names} does not show in the torque at all"
    if not in_units and all(abs(x - 1.0) < _ROUNDING for x in exponents.values()):
        return f"{names} can all be multiplied by one factor: no torque changes"
    changes = (
        f"{name} by {x:+.2g} {in_units[name]}" if name in in_units else f"{name} by k^{x:.3g}"
        for name, x in exponents.items()
    )
    return f"changing {', '.join(map(str.strip, changes))} together changes no torque, for k near 1"


@dataclass(frozen=True, eq=False)
class LocalInformation(LocalUnits):
    """Fisher information of the torque near one parameter vector, in :class:`LocalUnits`."""

    # (d,) sd that the data alone would leave, in the parameter's unit; infinite where a null
    # direction touches it
    data_sd: Array
    # (n_null, d) null directions in those units, the largest entry of each one; scalings known from
    # theory first
    null_rows: Array
    directions: Directions  # Singular values and vectors of the Jacobian over the noise
    # How many null directions, the first, are scalings that hold everywhere (section 4.2)
    from_theory: int = 0

    @property
    def null_directions(self) -> tuple[NullDirection, ...]:
        """What no torque can tell, by name, in the order of ``null_rows``."""
        named = (zip(self.labels, row.tolist(), strict=True) for row in self.null_rows)
        return tuple(
            NullDirection({label: round(x, 9) for label, x in pairs if abs(x) > _ROUNDING})
            for pairs in named
        )

    @property
    def information(self) -> Array:
        """Fisher information ``(d, d)`` in those units; exactly nothing along null directions."""
        told = self.directions.identified
        return np.asarray(told.T @ told)

    def data_sd_of(self, gradient: Array, *, gauge_free: bool = False) -> float:
        """Give the sd that the data alone would leave of a function of the parameters.

        Shapes: gradient (d,).
        """
        if gauge_free:
            gradient = self.directions.off_known(gradient)
        return self.directions.sd(gradient)


def local_information(target: Target, parameters: Array) -> LocalInformation:
    """Look at the likelihood near one vector of sampled parameters.

    For load losses the logarithm is that of ``alpha_1 = 1/(1 + mu_1)`` and ``alpha_2 = 1/(1 -
    mu_2)``, in which leg and gearbox scale along one straight line.

    Shapes: parameters (d,).
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
    found = directions(jacobian, np.ones(units.size), tolerance, known_null=scalings)
    # the Jacobian was taken in these units already
    found = replace(found, units=units)
    rows = _null_basis(found.rows[found.null], scalings)
    unknown = np.full(units.size, np.nan)
    local = LocalInformation(**vars(at), data_sd=unknown, null_rows=rows, directions=found)
    sds = np.array([local.data_sd_of(one) for one in np.eye(units.size)])
    return replace(local, data_sd=sds, from_theory=len(scalings))


def fixed_in(target: Target, values: Array) -> Knowledge:
    """Give what is known of a chain: what of ``values`` ``(n_parameters,)`` is not free."""
    named = zip(target.likelihood.chain.names, values.tolist(), strict=True)
    return Knowledge({name: value for name, value in named if name not in target.free})


def in_natural_units(
    target: Target, parameters: Array, local: LocalInformation
) -> LocalInformation:
    """Measure a value that is small beside its sd from the data by what the torque shows.

    Of a value that may as well be zero, the logarithm says nothing. Where the sd from the data is
    finite and so large beside the value that its logarithm would be weak, a change that makes a
    tenth of the measured torque counts as one instead (or the prior's sd, if that is less). Null
    directions do not touch such parameters, and load losses keep their logarithm of alpha.
    """
    likelihood = target.likelihood
    values = target.chain_values(parameters[None])[0]
    jacobian = torque_changes(likelihood.chain, likelihood.observations, values, local)
    effect = np.linalg.norm(jacobian, axis=0)
    measured = np.concatenate([o.measured for o in likelihood.observations])
    k = len(local.names)
    sds = np.array([p.sd() for p in target.priors[:k]])
    with np.errstate(divide="ignore"):
        floor = np.fmin(_FELT * np.linalg.norm(measured) / effect, sds)
    size = np.abs(parameters[:k])
    small = np.isfinite(local.data_sd) & (WEAK * size < local.data_sd) & (size < floor)
    small &= local.ways == 0
    units = np.where(small, floor, local.units)
    d = local.directions
    found = directions(d.identified * (units / local.units), np.ones(k), d.tolerance)
    return replace(
        local, units=units, shifted=local.shifted | small, directions=replace(found, units=units)
    )


def torque_changes(
    chain: Joint, observations: Sequence[Observation], values: Array, at: LocalUnits
) -> Array:
    """Differentiate the filtered torque by the free parameters, each in its own unit.

    Shapes: values (n_parameters,); returns (n_outputs, d).
    """
    columns = [chain.names.index(name) for name in at.names]
    steps = np.zeros(values.size)
    steps[columns] = _STEP * np.abs(at.units)
    return torque_jacobian(chain, observations, values, steps)[:, columns]


def joined(*rows: Array) -> Directions:
    """Take the information of several Jacobians together. Shapes: rows (n, d)."""
    return directions(np.concatenate(rows), np.ones(rows[0].shape[1]), _JOINED)


def prior_rows(target: Target, local: LocalInformation) -> Array:
    """Give the priors' information as a Jacobian ``(d, d)`` in the local units."""
    sds = np.array([p.sd() for p in target.priors[: len(target.free)]])
    ratio = np.abs(local.units) / sds
    return np.diag(np.where(np.isfinite(ratio), ratio, 0.0))


def derived_gradients(
    target: Target, parameters: Array, local: LocalInformation
) -> Iterator[tuple[Derived, float, Array]]:
    """Give each derived quantity at sampled parameters, with its gradient."""
    chain, observations = target.likelihood.chain, target.likelihood.observations
    steps = _BESIDE * np.abs(local.units)
    beside = np.eye(steps.size, parameters.size) * steps[:, None]
    vectors = target.chain_values(parameters + np.concatenate([beside, -beside, 0.0 * beside[:1]]))
    for q in derive(chain, vectors, typical_load(chain, observations, vectors[-1])):
        up, down = q.values[:-1].reshape(2, -1)
        yield q, float(q.values[-1]), (up - down) / (2.0 * steps) * local.units


def verdict(posterior_sd: float, prior_sd: float, data_sd: float) -> Determined:
    """Say whether data or prior determined a parameter."""
    if not data_sd > 0.0 or not posterior_sd > 0.0:  # also where it is no number
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
) -> list[str]:
    """Name the priors, not default ones, that settle a number which the data leave open.

    Where a factor common to several numbers changes no torque, the data leave each of them open. A
    prior on one, such as a weight that was put on scales, settles the factor, and with it all
    others.

    Shapes: gradient (d,).
    """
    if (np.isfinite(prior_sd) and sd >= WIDE * prior_sd) or not np.isfinite(gradient).all():
        return []
    few = priors[: len(local.names)]
    with np.errstate(divide="ignore"):
        weights = np.abs(local.units) / np.array([prior.sd() for prior in few])
    weights = np.nan_to_num(weights, nan=0.0, posinf=0.0)
    if own is not None:
        weights[own] = 0.0
    default = np.array([prior.default for prior in few])
    told = [int(i) for i in np.flatnonzero(~default & (weights > 0.0))]

    def left(some: Collection[int]) -> float:
        kept = default | np.isin(np.arange(weights.size), list(some))
        rows = np.diag(np.where(kept, weights, 0.0))
        return joined(local.directions.identified, rows).sd(gradient * local.units)

    every = left(told)
    # bounds, or a prior of its own, make what comes out narrower still
    if not every < _WIDER * sd or left(()) < _BETTER * every:
        return []
    best = min(told, key=lambda i: left((i,)))
    if left((best,)) < _WIDER * every:
        return [local.names[best]]
    needed = [i for i in told if left([j for j in told if j != i]) > _WIDER * every]
    return [local.names[i] for i in needed or told]


def jacobian_of(target: Target, parameters: Array, units: Array) -> Array:
    """Differentiate the modelled outputs over their noise, per unit.

    The torque is linear in nearly every parameter, so central differences are exact up to rounding
    except where a step changes the direction of power. On a bound of the support they are
    one-sided.

    Shapes: units (d,); returns (n_outputs, d).
    """
    k = units.size
    support = {p.name: (p.lower, p.upper) for p in target.likelihood.chain.parameters}
    low, high = np.array([support[name] for name in target.free]).T
    point, steps = parameters[:k], _STEP * units
    both = np.tile(parameters, (2 * k, 1))
    index = np.arange(k)
    # on a bound one side alone: nothing can be simulated beyond it
    both[index, index] = np.clip(point + steps, low, high)
    both[k + index, index] = np.clip(point - steps, low, high)
    widths = (both[index, index] - both[k + index, index]) / units
    scales = target.noise.scales(parameters[None, k:])[0]
    outputs = target.likelihood.standardised(target.chain_values(both), scales)
    return np.concatenate([(o[:k] - o[k:]) / widths[:, None] for o in outputs], axis=1).T


def _null_basis(rows: Array, theory: Array) -> Array:
    """Basis of the null space with many zeros, what theory names first, ``(n_null, d)``.

    The others are only given up to what theory names: one entry of each of those is
    eliminated, the one that leaves fewest entries.
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
    """Turn a basis of the null space so that it has many zeros (reduced row echelon)."""
    basis = rows.copy()
    for i in range(basis.shape[0]):
        pivot = int(np.argmax(np.abs(basis[i])))
        basis[i] /= basis[i, pivot]
        for j in range(basis.shape[0]):
            if j != i:
                basis[j] -= basis[j, pivot] * basis[i]
    return np.array([row / row[int(np.argmax(np.abs(row)))] for row in basis]).reshape(rows.shape)


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
