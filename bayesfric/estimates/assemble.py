"""The numbers of an estimate: totals, derived quantities and parameters of one fitted vector.

Each has standard deviations, the bound that it is on, and, where the scale between leg and alpha is
open (section 4.2), the range of values that fit as well.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.information import Information
from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.estimates.point_estimate import Bound, Estimate, EstimatedValue, Kind, Knowledge
from bayesfric.estimates.torque import filtered_torque, torque_jacobian, typical_load
from bayesfric.mechanism.derived import derivatives, derive
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import Parameter, State
from bayesfric.mechanism.scaling import Scaling, scalings
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.signals import Signals


def open_scalings(
    joint: Joint, knowledge: Knowledge, observations: Sequence[Signals]
) -> tuple[Scaling, ...]:
    """List the scalings that no known load or parameter fixes (section 4.2).

    The same known mass in all recordings counts as leg, and a known zero times any factor is zero:
    neither fixes a scale.
    """
    masses = {o.inputs.load(joint.load.motion) for o in observations}
    if len(masses) > 1 or any(o.inputs.load_torque is not None for o in observations):
        return ()
    fixed, priors = knowledge.fixed, knowledge.priors
    return tuple(
        scaling
        for scaling in scalings(joint, *next(iter(masses), (0.0, 0.0)))
        if not any(
            name in priors or (name in fixed and fixed[name] + shift != 0.0)
            for name, (shift, _) in scaling.rules.items()
        )
    )


def open_directions(
    joint: Joint, knowledge: Knowledge, observations: Sequence[Signals], values: Array
) -> Array:
    """Give the tangents ``(k, d)`` of the open scalings at a vector ``(n_parameters,)``."""
    columns = [joint.names.index(name) for name in knowledge.free(joint)]
    tangents = [s.tangent(values)[columns] for s in open_scalings(joint, knowledge, observations)]
    return np.array(tangents).reshape(-1, len(columns))


def centred(
    joint: Joint, knowledge: Knowledge, observations: Sequence[Signals], values: Array
) -> Array:
    """Move a vector along open scalings to the geometric middle of what gearbox and limits allow.

    All of these vectors fit equally well (section 4.2).
    """
    free = knowledge.free(joint)
    limits = dict(zip(free, zip(*knowledge.limits(joint), strict=True), strict=True))
    for scaling in open_scalings(joint, knowledge, observations):
        low, high = scaling.bounds(values, limits)
        if 0.0 < low < high:
            values = scaling.scaled(values, np.sqrt(low * high))
    return values


def units_of(joint: Joint, free: Sequence[str], values: Array) -> Array:
    """Give the unit change of each free parameter: its value; for mu_1, mu_2 1/alpha, eq. (6)."""
    units = []
    for p in (joint.parameters[joint.names.index(name)] for name in free):
        value = float(values[joint.names.index(p.name)])
        if (sign := alpha_sign(p)) > 0:
            units.append(1.0 + value)
        elif sign < 0:
            units.append(max(abs(1.0 - value), 1e-3))
        else:
            units.append(abs(value) or 1e-9)
    return np.array(units)


def alpha_sign(p: Parameter) -> int:
    """Give the sign of mu in ``alpha_1 = 1/(1 + mu_1)``, ``alpha_2 = 1/(1 - mu_2)``, eq. (6).

    Zero for a mu of both power flows, which has no alpha, and for all other parameters.
    """
    if p.row.role != "loss" or p.row.column is None:
        return 0
    still = State(0.0, 0.0, 0.0, 1.0, 0.0)
    driving, driven = (p.row.column(still._replace(transmitted=x)) for x in (1.0, -1.0))
    return int(np.sign(driving - driven))


def assemble(
    joint: Joint,
    observations: Sequence[Signals],
    knowledge: Knowledge,
    values: Array,
    information: Information,
    at_bound: NDArray[np.int_],
) -> tuple[EstimatedValue, ...]:
    """Compute totals of eq. (11), derived quantities and parameters of a vector, with sds.

    First order: ``sqrt(g' C g)``, gradients ``g`` by central differences. ``information`` leaves
    bounds out: with a parameter on a bound held, others would look far too certain.
    """
    columns = np.array([joint.names.index(name) for name in knowledge.free(joint)], dtype=np.int64)
    directions = information.directions
    scale = np.zeros(values.size)
    # these also suit parameters that are zero
    scale[columns] = directions.units
    still_open = open_scalings(joint, knowledge, observations)

    def value_of(
        number: tuple[str, str, str, str, float],
        gradient: Array,
        kind: Kind,
        *,
        gauge_free: bool = True,
        along: Callable[[Array], Array] | None = None,
    ) -> EstimatedValue:
        # a function of parameters on bounds alone is on a bound, too
        by_free, sds, span = gradient[columns], (np.nan, np.nan), None
        bound: Bound | None = None
        if np.any(by_free) and not np.any(by_free[at_bound == 0]):
            bound = "lower" if by_free @ at_bound < 0 else "upper"
        else:
            sds = information.sds(directions.off_known(by_free) if gauge_free else by_free)
        if along is not None and not np.isfinite(sds[0]) and len(still_open) == 1:
            span = _span(still_open[0], values, along)
        return EstimatedValue(*number, *sds, kind, gauge_free, bound, span)

    numbers: list[EstimatedValue] = []
    projection = TotalsProjection(joint, observations)
    if projection.names:
        torque = np.concatenate([filtered_torque(joint, o, values[None])[0] for o in observations])
        totals = projection.solve(torque)
        gradients = projection.solve(torque_jacobian(joint, observations, values, 1e-6 * scale))
        for i, (name, label) in enumerate(zip(projection.names, projection.labels, strict=True)):
            if label in joint.names:
                continue  # a parameter, listed as such
            number = label, *projection.describe(name), float(totals[i])
            if projection.open[i]:
                numbers.append(EstimatedValue(*number, np.inf, np.inf))
            else:
                numbers.append(value_of(number, gradients[i], "total"))

    listed, load = {value.name for value in numbers}, typical_load(joint, observations, values)
    for q, value, gradient in derivatives(joint, values, 1e-5 * scale, load):
        if q.name in listed or not np.isfinite([*gradient, value]).all() or not any(gradient):
            continue  # a total, undefined here, or a function of fixed values only

        def along(x: Array, name: str = q.name) -> Array:
            return next(d.values for d in derive(joint, x, load) if d.name == name)

        number = q.name, q.unit, q.symbol, q.meaning, value
        numbers.append(value_of(number, gradient, "derived", gauge_free=q.gauge_free, along=along))

    scaled = {name for scaling in scalings(joint) for name in scaling.names}
    open_names = {name for scaling in still_open for name in scaling.names}
    for column in columns.tolist():
        p = joint.parameters[column]
        numbers.append(
            value_of(
                (p.name, p.unit, p.symbol, p.meaning, float(values[column])),
                np.eye(values.size)[column],
                "parameter",
                gauge_free=p.name not in scaled,
                along=(lambda x, c=column: x[:, c]) if p.name in open_names else None,  # type: ignore[misc]
            )
        )
    return tuple(numbers)


def _span(
    scaling: Scaling, values: Array, along: Callable[[Array], Array]
) -> tuple[float, float] | None:
    """Range of a number along an open scaling that a passive gearbox allows."""
    low, high = scaling.bounds(values)
    # the lower end of k is where alpha_2 would be one; at zero it is no end at all
    numbers = along(scaling.scaled(values, np.geomspace(max(low, 1e-6 * high), high, 101)))
    numbers = numbers[np.isfinite(numbers)]
    return (float(numbers.min()), float(numbers.max())) if numbers.size else None


def bounds_met(
    values: Array, lower: Array, upper: Array, sizes: Array, *, share: float = 1e-6
) -> NDArray[np.int_]:
    """Give -1 for each free parameter on its lower bound, 1 on its upper one, else 0.

    It is on a bound that is closer than the ``share`` of its size.
    """
    width = share * np.maximum(np.abs(values), sizes)
    ends = np.zeros(values.size, dtype=np.int_)
    ends[values - lower <= width] = -1
    ends[upper - values <= width] = 1
    return ends


def collinear_losses(
    joint: Joint, estimate: Estimate, known: Collection[str], *, share: float = 0.5
) -> tuple[str, ...]:
    """Name the load-dependent frictions of several elements where none is identified separately.

    The torque behind one element enters the next, so a motion determines little more than the sum
    of their losses. Sampling would be slow: 20000 steps of 37 ms on the UR10e, where a single
    load-dependent friction takes a minute.
    """
    lossy = [e.name for e in joint.elements if e.load_loss != "none"]
    names = [p.name for p in joint.parameters if p.owner in lossy and p.row.role == "loss"]
    if len(lossy) < 2 or any(n in known for n in names):
        return ()
    values = [estimate[n] for n in names]
    total = sum(abs(v.value) for v in values)
    # one is identified if its sd is less than a share of the sum of all; not one on a limit, which
    # has no sd
    identified = (v.determined and v.larger_sd < share * total for v in values)
    return () if any(identified) else tuple(names)
