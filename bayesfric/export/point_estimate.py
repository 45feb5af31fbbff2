"""Parameter vectors to export: draws, and a point estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesfric.export.joint_model import Trajectory, torque_along
from bayesfric.fit.model import Result
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import turned
from bayesfric.mechanism.scaling import Scaling, scalings
from bayesfric.recordings.arrays import Array

# Draws for the median torque, and for medians along an open scaling: the point estimate must not
# depend on how many draws are exported.
_DRAWS = 1000
# Share of the draws that count as near to the median torque.
_NEAR = 0.1


def open_scalings(run: Result) -> tuple[Scaling, ...]:
    """List scalings of link and load-dependent friction that data and priors leave open."""
    specified = {name for name, row in run.summary.rows.items() if row.given_by}
    directions = [set(n["parameters"]) for n in run.summary.identifiability.null_directions]
    unidentified = {name for names in directions if not names & specified for name in names}
    return tuple(
        scaling
        for scaling in scalings(run.joint)
        if {f"{scaling.element}.alpha_drive", f"{scaling.element}.alpha_back"} & unidentified
    )


@dataclass(frozen=True, eq=False)
class ParameterVectors:
    """Draws of a run and a point estimate.

    Where a scaling is open, every vector is scaled to equal losses in driving and back-driving: no
    torque changes, and the motor's torque is transmitted without loss on average.
    """

    scalings: tuple[Scaling, ...]
    point: Array  # (d,)
    kind: Literal["reported", "draw"]  # reported values, or a draw where they do not fit
    draws: Array  # (n, d)


def parameter_vectors(run: Result, motions: Sequence[Trajectory], count: int) -> ParameterVectors:
    """Take at most ``count`` evenly spread draws of a run, and a point estimate."""
    joint, opened, rows = run.joint, open_scalings(run), run.summary.parameters
    scaled = {name for scaling in opened for name in scaling.names}

    def corrected(number: int) -> Array:
        """Draws, shifted by the bias correction of the reported values within their bounds."""
        values = run.values(run.picked(number))
        for k, p in enumerate(joint.parameters):
            if p.name in rows and rows[p.name].value != rows[p.name].middle:
                shift = rows[p.name].value - rows[p.name].middle
                values[:, k] = np.clip(values[:, k] + shift, p.lower, p.upper)
        return _balanced(values, opened)

    many = corrected(_DRAWS)
    reported = np.median(many, axis=0)
    for k, p in enumerate(joint.parameters):
        if p.name in rows and p.name not in scaled:
            reported[k] = rows[p.name].value
        elif p.circular:
            mean = float(np.angle(np.mean(np.exp(1j * many[:, k]))))
            reported[k] = np.median(turned(many[:, k], mean))
    reported = _balanced(reported[None], opened)[0]
    draw = representative_draw(joint, many, reported, motions)
    point = reported if draw is None else draw
    return ParameterVectors(opened, point, "reported" if draw is None else "draw", corrected(count))


def representative_draw(
    joint: Joint, draws: Array, medians: Array, motions: Sequence[Trajectory]
) -> Array | None:
    """Choose a draw as point estimate where the medians together do not fit.

    Medians of parameters of which only the sum is identified need not add up to it. ``None`` where
    the torque of ``medians`` ``(d,)`` is as near to the median torque as that of a tenth of the
    draws ``(n, d)``; else the draw of that tenth whose parameters are nearest to their medians.
    """
    torque = torque_along(joint, np.vstack([draws, medians]), motions)
    error = np.sqrt(np.mean((torque - np.median(torque[:-1], axis=0)) ** 2, axis=1))
    near = error[:-1] <= np.quantile(error[:-1], _NEAR)
    if error[-1] <= error[:-1][near].max():
        return None
    low, high = np.quantile(draws, [0.16, 0.84], axis=0)
    spread = np.where(high > low, high - low, 1.0)
    distance = np.sum(((draws - medians) / spread) ** 2, axis=1)
    return np.asarray(draws[np.argmin(np.where(near, distance, np.inf))])


def _balanced(values: Array, opened: tuple[Scaling, ...]) -> Array:
    """Scale vectors ``(n, d)`` to equal losses in driving and back-driving."""
    for scaling in opened:
        names = scaling.chain.names
        drive, back = (values[:, names.index(name)] for name in (scaling.drive, scaling.back))
        factor = 1.0 + 0.5 * (drive - back)
        values = np.stack([scaling.scaled(v, f) for v, f in zip(values, factor, strict=True)])
    return values
