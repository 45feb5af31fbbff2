"""What an estimate states of one fitted parameter vector: totals, derived quantities, parameters.

Each number has standard deviations, says on which bound it stands, and, where the scale between
leg and alpha is open (section 4.2), which values fit as well.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.information import Information
from bayesfric.estimates.knowledge import Knowledge
from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.estimates.point_estimate import Bound, Estimate, EstimatedValue, Kind
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
    """Scalings that neither known loads nor a known value of a parameter takes away (section 4.2).

    One known mass in all recordings alike might as well be more leg, and zero times any factor is
    zero: neither fixes a scale.
    """
    masses = {o.inputs.load(chain.load.motion) for o in observations}
    if len(masses) > 1 or any(o.inputs.load_torque is not None for o in observations):
        return ()
    fixed, told = knowledge.fixed, knowledge.priors
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
    """Directions of the open scalings at a vector.

    Shapes: values (n_parameters,); returns (k, d).
    """
    columns = [chain.names.index(name) for name in knowledge.free(chain)]
    found = [s.tangent(values)[columns] for s in open_scalings(chain, knowledge, observations)]
    return np.array(found).reshape(-1, len(columns))


def centred(
    chain: Joint, knowledge: Knowledge, observations: Sequence[Observation], values: Array
) -> Array:
    """Move a fit along open scalings to the middle of what gearbox and limits leave open.

    All vectors that it may become fit as well (section 4.2).

    Shapes: values (n_parameters,); returns (n_parameters,).
    """
    free = knowledge.free(chain)
    limits = dict(zip(free, zip(*knowledge.limits(chain), strict=True), strict=True))
    for scaling in open_scalings(chain, knowledge, observations):
        low, high = scaling.bounds(values, limits)
        if 0.0 < low < high:
            values = scaling.scaled(values, np.sqrt(low * high))
    return values


def units_of(chain: Joint, free: Sequence[str], values: Array) -> Array:
    """Say what counts as a change of one: the value; for mu_1 and mu_2 that of 1/alpha, eq. (6).

    Shapes: values (n_parameters,); returns (len(free),).
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
    """Sign in ``alpha_1 = 1/(1 + mu_1)`` and ``alpha_2 = 1/(1 - mu_2)``, eq. (6).

    Only ``mu_1`` and ``mu_2`` have an alpha, not one mu of both power flows: what a term takes
    while power flows either way says which it is.
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
    """State totals, derived quantities and parameters of a fitted vector.

    Standard deviations are of first order: ``sqrt(g' C g)`` with the gradient ``g`` of a number by
    the parameters and their covariance ``C``. Gradients are central differences.

    Shapes: values (n_parameters,); at_bound (d,).
    """
    columns = np.array([chain.names.index(name) for name in knowledge.free(chain)], dtype=np.int64)
    scale = np.zeros(values.size)
    # these also suit parameters that are zero
    scale[columns] = information.directions.units
    still_open = open_scalings(chain, knowledge, observations)
    stated = _Stated(values, columns, information, at_bound, still_open)
    found = list(_totals(chain, observations, values, scale, stated))
    taken = {value.name for value in found}
    load = typical_load(chain, observations, values)
    found += [v for v in _derived(chain, values, load, scale, stated) if v.name not in taken]
    gauged = {name for scaling in scalings(chain) for name in scaling.names}
    moving = {name for scaling in still_open for name in scaling.names}
    for column in columns.tolist():
        p = chain.parameters[column]
        found.append(
            stated(
                (p.name, p.unit, p.symbol, p.meaning, float(values[column])),
                np.eye(values.size)[column],
                "parameter",
                gauge_free=p.name not in gauged,
                along=(lambda x, c=column: x[:, c]) if p.name in moving else None,  # type: ignore[misc]
            )
        )
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Stated:
    """States numbers that a fitted vector makes up."""

    values: Array  # (n_parameters,)
    columns: NDArray[np.int64]  # (d,) the free ones among them
    information: Information  # Of the free ones
    at_bound: NDArray[np.int_]
    scalings: tuple[Scaling, ...]  # Those that are open

    def __call__(
        self,
        number: tuple[str, str, str, str, float],
        gradient: Array,
        kind: Kind,
        *,
        gauge_free: bool = True,
        along: Callable[[Array], Array] | None = None,
    ) -> EstimatedValue:
        """State a number by its gradient ``(n_parameters,)``, and by what it is of other vectors.

        Where only parameters on a bound make it up, it stands on one, too.
        """
        own, directions = gradient[self.columns], self.information.directions
        bound: Bound | None = None
        sds = np.nan, np.nan
        if np.any(own) and not np.any(own[self.at_bound == 0]):
            bound = "lower" if own @ self.at_bound < 0 else "upper"
        else:
            sds = self.information.sds(directions.off_known(own) if gauge_free else own)
        span = None if along is None or np.isfinite(sds[0]) else self._span(along)
        return EstimatedValue(*number, *sds, kind, gauge_free, bound, span)

    def _span(self, along: Callable[[Array], Array]) -> tuple[float, float] | None:
        """Range of a number along the one open scaling that a passive gearbox allows."""
        if len(self.scalings) != 1:
            return None
        low, high = self.scalings[0].bounds(self.values)
        # the lower end of k is where alpha_2 would be one; at zero it is no end at all
        factors = np.geomspace(max(low, 1e-6 * high), high, 101)
        found = along(self.scalings[0].scaled(self.values, factors))
        found = found[np.isfinite(found)]
        return (float(found.min()), float(found.max())) if found.size else None


def bounds_met(values: Array, lower: Array, upper: Array, sizes: Array) -> NDArray[np.int_]:
    """Find which free parameters stand on a bound.

    Shapes: values, lower, upper (d,) each; sizes (d,); returns (d,).
    """
    width = _ON_BOUND * np.maximum(np.abs(values), sizes)
    out = np.zeros(values.size, dtype=np.int_)
    out[values - lower <= width] = -1
    out[upper - values <= width] = 1
    return out


def _totals(
    chain: Joint, observations: Sequence[Observation], values: Array, scale: Array, stated: _Stated
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
        number = label, *projection.describe(name), float(found[i])
        if projection.open[i]:
            yield EstimatedValue(*number, np.inf, np.inf)
        else:
            yield stated(number, gradients[i], "total")


def _derived(
    chain: Joint, values: Array, load: float, scale: Array, stated: _Stated
) -> Iterator[EstimatedValue]:
    """State derived quantities, their gradients by central differences; none without a gradient."""
    steps = 1e-5 * scale
    moving = np.flatnonzero(steps)
    k = moving.size
    beside = np.eye(values.size)[moving] * steps
    moved = values + np.concatenate([beside, -beside, np.zeros((1, values.size))])
    for q in derive(chain, moved, load):
        middle = float(q.values[-1])
        gradient = np.zeros(values.size)
        gradient[moving] = (q.values[:k] - q.values[k : 2 * k]) / (2 * steps[moving])
        if not np.isfinite(middle) or not np.isfinite(gradient).all() or not gradient.any():
            continue  # undefined here, or made of known numbers only

        def along(vectors: Array, name: str = q.name) -> Array:
            return next(one.values for one in derive(chain, vectors, load) if one.name == name)

        number = q.name, q.unit, q.symbol, q.meaning, middle
        yield stated(number, gradient, "derived", gauge_free=q.gauge_free, along=along)


# A loss is told where its sd is less than this share of all of them together.
_TOLD = 0.5


def collinear_losses(chain: Joint, estimate: Estimate, known: Collection[str]) -> tuple[str, ...]:
    """Name load-dependent frictions of several elements where data identify none by itself.

    The torque that leaves one element is that which enters the next but for what stands between: a
    motion tells little more than the sum of their losses. Sampling that is slow: walkers wander
    along it, and two load losses make no moments that the likelihood would be cheap with (20000
    steps of 37 ms on the UR10e, where one load loss takes a minute).
    """
    lossy = [e.name for e in chain.elements if e.load_loss != "none"]
    names = [p.name for p in chain.parameters if p.owner in lossy and p.row.role == "loss"]
    if len(lossy) < 2 or any(n in known for n in names):
        return ()
    values = [estimate[n] for n in names]
    whole = sum(abs(v.value) for v in values)
    # what stands on a limit has no sd, and is not told either
    told = (v.determined and v.larger_sd < _TOLD * whole for v in values)
    return () if any(told) else tuple(names)
