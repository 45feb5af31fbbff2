"""Default priors: weakly informative, scaled by what the recordings move and take.

No single term is expected to need much more torque than the largest measured
one. So a constant loss gets a half-normal with that torque as its scale, a
viscous loss that torque over the typical speed, an inertia that torque over the
typical acceleration, each at its own element's shaft. What a term stores the motor need not
give: gravity and inertia of a pendulum that swings carry each other. So these get the torque that
least squares is sure that one of the terms takes, where that is larger. Scales are rounded to one
digit: they state an order of magnitude, not a measurement.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bayesfric.errors import BadInput
from bayesfric.estimates.least_squares import TotalsProjection, least_squares
from bayesfric.inference.prior.priors import Prior, PriorText, read_prior
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.own_term import CarriedTerm, along
from bayesfric.mechanism.parameter import TURN, Parameter
from bayesfric.mechanism.quantities import Sizes, State
from bayesfric.recordings.observation import Observation

# Share of the samples that a size is the largest of: a glitch must not set a scale.
_NEARLY_ALL = 0.999


@dataclass(frozen=True)
class Scales:
    """Sizes of what was measured."""

    torque: float  # largest measured of the motor (99.9th percentile), N m or N
    speed: float  # root mean square at the joint
    acceleration: float
    lean: float = 1.0  # largest sine of the joint's angle that gravity was seen at
    exchanged: float = 0.0  # torque that one term surely takes, from another maybe
    position: float = 1.0  # range of the joint's, rad or m
    duration: float = 1.0  # of the longest recording, s
    position_step: float = 0.0  # finest that one was read in; 0 where it is not known
    # root mean square torque of each term with a shape of its own, for a value of one
    columns: Mapping[str, float] = field(default_factory=dict)


def measured_scales(chain: Joint, observations: Sequence[Observation]) -> Scales:
    """Take the scales of the default priors from all recordings together."""
    torque = np.concatenate([o.measured for o in observations])
    # only where outputs are: an excluded glitch must not set a scale
    speed = np.concatenate([o.qd[o.filter.centres] for o in observations])
    acceleration = np.concatenate([o.qdd[o.filter.centres] for o in observations])
    duration = sum(o.period * o.measured.size for o in observations)
    return Scales(
        torque=float(np.quantile(np.abs(torque), _NEARLY_ALL)),
        lean=_lean(chain, observations),
        exchanged=_surely_taken(chain, observations),
        speed=_rms(speed),
        # a motion that hardly accelerates still changes its speed once in the recording
        acceleration=max(_rms(acceleration), _rms(speed) / duration),
        position=max(float(np.ptp(o.q[o.filter.centres])) for o in observations),
        duration=max(float(np.ptp(o.stamps)) for o in observations),
        position_step=min(o.position_step for o in observations),
        columns={
            chain.names[c.index]: _rms(np.concatenate([_at_outputs(c, o) for o in observations]))
            for c in chain.carried
        },
    )


def _lean(chain: Joint, observations: Sequence[Observation]) -> float:
    # from an unknown zero it may be any
    if any(p.circular for p in chain.parameters):
        return 1.0
    most = max(float(np.abs(np.sin(o.q[o.filter.centres])).max()) for o in observations)
    return most or 1.0


def _surely_taken(chain: Joint, observations: Sequence[Observation]) -> float:
    """Give the largest torque that least squares finds in one term, less two of its sds."""
    projection = TotalsProjection(chain, observations)
    with suppress(BadInput):
        found = least_squares(chain, observations, projection)
        sizes = np.quantile(np.abs(projection.regressors), _NEARLY_ALL, axis=0)
        known = np.array([v.determined for v in found.values])
        sds = np.array([max(v.sd, np.nan_to_num(v.sd_robust)) for v in found.values])
        least = np.abs([v.value for v in found.values]) - 2.0 * sds
        return float(np.max(least[known] * sizes[known], initial=0.0))
    return 0.0


def _at_outputs(carried: CarriedTerm, o: Observation) -> NDArray[np.float64]:
    at = o.filter.centres
    return along(carried.row, carried.reach, o.q[at], o.qd[at], o.stamps[at], o.inputs)


def _rms(x: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(x**2)))


def default_prior(chain: Joint, p: Parameter, scales: Scales) -> Prior:
    """Choose the default prior of one parameter, by what :func:`measured_scales` gives."""
    text = _text(chain, p, scales)
    upper = min(p.upper, p.row.prior_upper)
    return read_prior(p.name, text, lower=p.lower, upper=upper, default=True, circular=p.circular)


def sizes_at(chain: Joint, owner: str, scales: Scales) -> Sizes:
    """Give the sizes at the input of an element, or of ``load``."""
    to_joint = chain.reaches[owner]
    return Sizes(
        scales.torque * (chain.ratio / to_joint),
        scales.speed * to_joint,
        scales.acceleration * to_joint,
        chain.load.gravity,
        scales.lean,
        scales.duration,
    )


def _text(chain: Joint, p: Parameter, scales: Scales) -> PriorText:
    """Word the default prior that the row of a quantity asks for, in the sizes at its own shaft."""
    row = p.row
    if row.prior == "uniform":
        return [-TURN / 2.0, TURN / 2.0] if row.circular else [row.lower, row.upper]
    if row.stores:
        scales = replace(scales, torque=max(scales.torque, scales.exchanged))
    sizes = sizes_at(chain, p.owner, scales)
    if row.spread is not None:
        scale = row.spread(sizes)
    elif row.role == "own" and (row.column is not None or row.signal):
        if row.column is None or row.power is None:
            size = scales.columns[p.name]
        else:  # some losses are there in one direction only
            ways = [State(w, w * sizes.speed, w * sizes.acceleration, w, 0.0) for w in (1.0, -1.0)]
            size = max(abs(row.column(way)) for way in ways)
        scale = sizes.torque / size if size > 0.0 else sizes.torque
    else:
        raise KeyError(f"{p.name}: the table gives {p.quantity!r} no default prior")
    if row.prior == "lognorm":
        return {"distribution": "lognorm", "s": scale}
    family = row.prior or ("halfnorm" if p.lower == 0.0 else "norm")
    return {"distribution": family, "scale": float(f"{scale:.0e}")}
