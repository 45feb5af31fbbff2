"""Default priors: weakly informative, scaled by what the recordings move and take.

No single term is expected to need much more torque than the largest measured
one. So Coulomb friction gets a half-normal with that torque as its scale, viscous
friction that torque over the typical speed, an inertia that torque over the
typical acceleration, each at its own element's shaft. What a term stores the motor need not
give: gravity and inertia of a pendulum that swings carry each other. So these get the torque that
least squares is sure that one of the terms takes, where that is larger. Scales are rounded to one
digit: they state an order of magnitude, not a measurement.
"""

from __future__ import annotations

from dataclasses import replace

from bayesfric.estimates.sizes import Scales, sizes_at
from bayesfric.inference.prior.priors import Prior, PriorText, read_prior
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.parameter import TURN, Parameter
from bayesfric.mechanism.quantities import State


def default_prior(chain: Joint, p: Parameter, scales: Scales) -> Prior:
    """Choose the default prior of one parameter."""
    text = _text(chain, p, scales)
    upper = min(p.upper, p.row.prior_upper)
    return read_prior(p.name, text, lower=p.lower, upper=upper, default=True, circular=p.circular)


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
