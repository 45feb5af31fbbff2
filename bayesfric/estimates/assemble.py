"""From one fitted parameter vector to everything an estimate states about it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.information import Information
from bayesfric.estimates.knowledge import Knowledge
from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.estimates.point_estimate import Bound, EstimatedValue
from bayesfric.estimates.torque import filtered_torque, torque_jacobian, typical_load
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.parameter import Parameter
from bayesfric.mechanism.quantities import State
from bayesfric.mechanism.scaling import Scaling, scalings
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

# Closer to a bound than this share of what is a large change is on it.
_ON_BOUND = 1e-6


def open_scalings(
    chain: Joint, knowledge: Knowledge, observations: Sequence[Observation]
) -> tuple[Scaling, ...]:
    """Scalings that neither known loads nor a known or told parameter takes away.

    One known mass in all recordings alike might as well be more leg, and zero times any
    factor is zero: neither fixes a scale.
    """
    masses = {o.inputs.load(chain.load.motion) for o in observations}
    if len(masses) > 1 or any(o.inputs.load_torque is not None for o in observations):
        return ()
    fixed, told = knowledge.fixed, knowledge.told
    return tuple(
        scaling
        for scaling in scalings(chain, *next(iter(masses), (0.0, 0.0)))
        if not any(
            name in told or (name in fixed and fixed[name] + shift != 0.0)
            for name, (shift, _) in scaling.rules.items()
        )
    )


def open_directions(
    chain: Joint, knowledge: Knowledge, observations: Sequence[Observation], values: Array
) -> Array:
    """Directions of the open scalings at a vector, in the free parameters, ``(k, d)``."""
    columns = [chain.names.index(name) for name in knowledge.free(chain)]
    found = [s.tangent(values)[columns] for s in open_scalings(chain, knowledge, observations)]
    return np.array(found).reshape(-1, len(columns))


def centred(
    chain: Joint, knowledge: Knowledge, observations: Sequence[Observation], values: Array
) -> Array:
    """Move a fit along open scalings to the middle of what gearbox and limits leave open.

    ``values`` ``(n_parameters,)`` within the limits; all vectors it may become fit as well.
    """
    free = knowledge.free(chain)
    limits = dict(zip(free, zip(*knowledge.limits(chain), strict=True), strict=True))
    for scaling in open_scalings(chain, knowledge, observations):
        low, high = scaling.bounds(values, limits)
        if 0.0 < low < high:
            values = scaling.scaled(values, np.sqrt(low * high))
    return values


def units_of(chain: Joint, free: Sequence[str], values: Array) -> Array:
    """Say what counts as a change of one, ``(len(free),)``: the value; for load losses alpha.

    ``values`` is ``(n_parameters,)`` in the order of ``chain.names``; no unit is zero.
    """
    units = []
    for p in (chain.parameters[chain.names.index(name)] for name in free):
        value = float(values[chain.names.index(p.name)])
        if (way := alpha_way(p)) > 0:
            units.append(1.0 + value)
        elif way < 0:
            units.append(max(abs(1.0 - value), 1e-3))
        else:
            units.append(abs(value) or 1e-9)
    return np.array(units)


def alpha_way(p: Parameter) -> int:
    """Sign in ``alpha_1 = 1/(1 + mu_1)`` and ``alpha_2 = 1/(1 - mu_2)``; zero for the others.

    Only one of two load losses has an alpha: what it takes while power flows its way says which.
    """
    if p.row.role != "loss" or p.row.column is None:
        return 0
    still = State(0.0, 0.0, 0.0, 1.0, 0.0)
    driving, driven = (p.row.column(still._replace(transmitted=x)) for x in (1.0, -1.0))
    return int(np.sign(driving - driven))


def assemble(
    chain: Joint,
    observations: Sequence[Observation],
    knowledge: Knowledge,
    values: Array,
    information: Information,
    at_bound: NDArray[np.int_],
) -> tuple[EstimatedValue, ...]:
    """State totals, derived quantities and parameters of a fitted vector ``(n_parameters,)``.

    ``information`` is of the free parameters, in the chain's order. Bounds are left out of it:
    beside a parameter that stands on one, others would look far too certain. ``at_bound``
    ``(d,)``: -1 on the lower bound, 1 on the upper, else 0.

    Gives totals of eq. (11) as least squares would see this vector's torque, derived quantities,
    parameters. What the data leave open has an infinite sd; what stands on a bound has none.
    """
    free = knowledge.free(chain)
    columns = np.array([chain.names.index(name) for name in free], dtype=np.int64)
    scale = np.zeros(values.size)
    # these also suit parameters that are zero
    scale[columns] = information.directions.units

    def sds(gradient: Array, gauge_free: bool) -> tuple[float, float]:
        own = gradient[columns]
        if bound_of(gradient):
            return np.nan, np.nan
        return information.sds(information.directions.off_known(own) if gauge_free else own)

    open_ = open_scalings(chain, knowledge, observations)

    def bound_of(gradient: Array) -> Bound | None:
        """Which bound a quantity stands on that only parameters on theirs make up."""
        own = gradient[columns]
        if not np.any(own) or np.any(own[at_bound == 0]):
            return None
        return "lower" if own @ at_bound < 0 else "upper"

    def span(function: Callable[[Array], Array]) -> tuple[float, float] | None:
        if len(open_) != 1:
            return None
        low, high = open_[0].bounds(values)
        # the lower end of k is where alpha_2 would be one; at zero it is no end at all
        along = open_[0].scaled(values, np.geomspace(max(low, 1e-6 * high), high, 101))
        found = function(along)
        found = found[np.isfinite(found)]
        return (float(found.min()), float(found.max())) if found.size else None

    stated = list(_totals(chain, observations, values, scale, sds))
    taken = {value.name for value in stated}
    load = typical_load(chain, observations, values)
    derived = _derived(chain, values, load, scale, sds, span, bound_of)
    stated += [v for v in derived if v.name not in taken]
    for column in columns.tolist():
        p, gradient = chain.parameters[column], np.eye(values.size)[column]
        scaled = any(p.name in s.names for s in open_)
        stated.append(
            EstimatedValue(
                *(p.name, p.unit, p.symbol, p.meaning, float(values[column])),
                *sds(gradient, False),
                kind="parameter",
                gauge_free=not any(p.name in s.names for s in scalings(chain)),
                at_bound=bound_of(gradient),
                span=span(lambda along, c=column: along[:, c]) if scaled else None,  # type: ignore[misc]
            )
        )
    return tuple(stated)


def bounds_met(
    values: Array, lower: Array, upper: Array, sizes: Array | None = None
) -> NDArray[np.int_]:
    """Which free parameters stand on a bound: -1 lower, 1 upper, else 0, ``(d,)``.

    ``sizes`` ``(d,)`` says what is a large change of each; the values themselves if left out.
    """
    width = _ON_BOUND * np.maximum(np.abs(values), 1e-9 if sizes is None else sizes)
    out = np.zeros(values.size, dtype=np.int_)
    out[values - lower <= width] = -1
    out[upper - values <= width] = 1
    return out


def _totals(
    chain: Joint,
    observations: Sequence[Observation],
    values: Array,
    scale: Array,
    sds: Callable[[Array, bool], tuple[float, float]],
) -> Iterator[EstimatedValue]:
    """Totals that least squares would find in the torque this vector makes."""
    projection = TotalsProjection(chain, observations)
    if not projection.names:
        return
    torque = np.concatenate([filtered_torque(chain, o, values[None])[0] for o in observations])
    found = projection.solve(torque)
    jacobian = torque_jacobian(chain, observations, values, 1e-6 * scale)
    gradients = projection.solve(jacobian)
    for i, (name, label) in enumerate(zip(projection.names, projection.labels, strict=True)):
        if label in chain.names:
            continue  # it is a parameter, stated as such
        both = (np.inf, np.inf) if projection.open[i] else sds(gradients[i], True)
        yield EstimatedValue(label, *projection.describe(name), float(found[i]), *both)


def _derived(
    chain: Joint,
    values: Array,
    load: float,
    scale: Array,
    sds: Callable[[Array, bool], tuple[float, float]],
    span: Callable[[Callable[[Array], Array]], tuple[float, float] | None],
    bound_of: Callable[[Array], Bound | None],
) -> Iterator[EstimatedValue]:
    steps = 1e-5 * scale
    moving = np.flatnonzero(steps)
    k = moving.size
    beside = np.eye(values.size)[moving] * steps
    moved = values + np.concatenate([beside, -beside, np.zeros((1, values.size))])
    for quantity in derive(chain, moved, load):
        middle = float(quantity.values[-1])
        gradient = np.zeros(values.size)
        gradient[moving] = (quantity.values[:k] - quantity.values[k : 2 * k]) / (2 * steps[moving])
        if not np.isfinite(middle) or not np.isfinite(gradient).all() or not gradient.any():
            continue  # undefined here, or made of known numbers only
        sd, robust = sds(gradient, quantity.gauge_free)

        def along(vectors: Array, name: str = quantity.name) -> Array:
            return next(q.values for q in derive(chain, vectors, load) if q.name == name)

        yield EstimatedValue(
            *(quantity.name, quantity.unit, quantity.symbol, quantity.meaning, middle),
            *(sd, robust),
            kind="derived",
            gauge_free=quantity.gauge_free,
            at_bound=bound_of(gradient),
            span=None if np.isfinite(sd) else span(along),
        )
