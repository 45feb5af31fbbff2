"""Parameter vectors to export: draws, and one that stands for them all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesfric.export.joint_model import Moved, torque_along
from bayesfric.fit.finished_run import Finished
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.parameter import turned
from bayesfric.mechanism.scaling import Scaling, scalings
from bayesfric.recordings.arrays import Array

# Draws that tell the median torque, and medians along an open scaling: whatever is exported, the
# middle is the same.
_MANY = 1000
# Share of the draws that count as near to the median torque.
_NEAR = 0.1


def open_scalings(found: Finished) -> tuple[Scaling, ...]:
    """Scalings of link and load losses that recordings and told priors of a run leave open."""
    rows = found.summary.rows
    settled = {name for name, row in rows.items() if row.given_by}
    ways = [set(n.parameters) for n in found.summary.identifiability.null_directions]
    named = {name for way in ways if not way & settled for name in way}
    return tuple(
        one
        for one in scalings(found.joint)
        if {f"{one.element}.alpha_drive", f"{one.element}.alpha_back"} & named
    )


@dataclass(frozen=True, eq=False)
class Vectors:
    """What a run exports.

    Where a scaling is open, every vector is moved along it to where driving and back-driving
    lose the same: no torque changes, and the motor's torque reaches the link whole on average.
    """

    scalings: tuple[Scaling, ...]
    middle: Array  # (d,), see :func:`central`
    kind: Literal["reported", "draw"]  # what it is: the run's reported values, where they fit
    draws: Array  # (n, d)


def vectors(found: Finished, motions: Sequence[Moved], most: int) -> Vectors:
    """Take at most so many draws of a run, evenly spread; and one central vector."""
    chain, moved = found.joint, open_scalings(found)
    draws, many = (_evened(_unbiased(found, found.picked(count)), moved) for count in (most, _MANY))
    middle = _evened(_middle(found, _medians(chain, many), moved)[None], moved)[0]
    better = central(chain, many, middle, motions)
    if better is not None:
        return Vectors(moved, better, "draw", draws)
    return Vectors(moved, middle, "reported", draws)


def central(chain: Joint, draws: Array, middle: Array, motions: Sequence[Moved]) -> Array | None:
    """Find a draw to stand for all where the medians together do not.

    Medians of parameters that only their sum determines need not sum up to it. ``None`` where the
    torque of the medians ``(d,)`` along the recordings is as near to the median torque as that of
    a tenth of the draws ``(n, d)``. Else the draw, of that tenth, whose parameters are nearest to
    their medians.
    """
    torque = torque_along(chain, np.vstack([draws, middle]), motions)
    away = np.sqrt(np.mean((torque - np.median(torque[:-1], axis=0)) ** 2, axis=1))
    near = away[:-1] <= np.quantile(away[:-1], _NEAR)
    if away[-1] <= away[:-1][near].max():
        return None
    low, high = np.quantile(draws, [0.16, 0.84], axis=0)
    spread = np.where(high > low, high - low, 1.0)
    apart = np.sum(((draws - middle) / spread) ** 2, axis=1)
    return np.asarray(draws[np.argmin(np.where(near, apart, np.inf))])


def _evened(values: Array, moved: tuple[Scaling, ...]) -> Array:
    for one in moved:
        names = one.chain.names
        drive, back = (values[:, names.index(name)] for name in (one.drive, one.back))
        factor = 1.0 + 0.5 * (drive - back)
        values = np.stack([one.scaled(v, f) for v, f in zip(values, factor, strict=True)])
    return values


def _unbiased(found: Finished, draws: Array) -> Array:
    """Move draws by what was taken off the reported values as bias, within their bounds."""
    values = found.values(draws)
    for k, p in enumerate(found.joint.parameters):
        row = found.summary.parameters.get(p.name)
        if row is not None and row.value != row.middle:
            values[:, k] = np.clip(values[:, k] + (row.value - row.middle), p.lower, p.upper)
    return values


def _middle(found: Finished, medians: Array, moved: Sequence[Scaling]) -> Array:
    """Put the run's reported values in place of medians of some draws, where none is moved."""
    out, scaled = medians.copy(), {name for one in moved for name in one.names}
    for k, name in enumerate(found.joint.names):
        if name in found.summary.parameters and name not in scaled:
            out[k] = found.summary.parameters[name].value
    return out


def _medians(chain: Joint, draws: Array) -> Array:
    out = np.median(draws, axis=0)
    for k, p in enumerate(chain.parameters):
        if p.circular:
            towards = float(np.angle(np.mean(np.exp(1j * draws[:, k]))))
            out[k] = float(np.median(turned(draws[:, k], towards)))
    return np.asarray(out)
