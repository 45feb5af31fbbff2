"""What a recording went through: who drove whom, how far it turned, whether it accelerated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.torque import filtered_torque
from bayesfric.mechanism.inverse import inverse_torque, load_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

# Share of the torque below which inertia does not show.
_LITTLE = 0.05


@dataclass(frozen=True)
class Coverage:
    """What one recording went through, at the point estimate where that needs one."""

    name: str  # Of the recording, and how many outputs it has
    outputs: int
    moving: float  # Share of outputs in which the joint moves
    # By element with a load loss, share of those in which the load drives it
    load_drives: dict[str, float]
    turn: float  # Range of the joint's position, rad or m
    steady: float  # Share of outputs in which inertia takes less than a twentieth of the torque
    added_mass: float  # Known mass on the load, kg, and its distance from the axis, m
    radius: float


def coverage_of(
    chain: Joint, observations: Sequence[Observation], values: Array
) -> tuple[Coverage, ...]:
    """Look at what every recording went through. Shapes: values (n_parameters,)."""
    return tuple(
        Coverage(
            name=o.name,
            outputs=int(o.measured.size),
            moving=float(np.mean(o.qd[o.filter.centres] != 0.0)),
            load_drives={
                k: float(x[0]) for k, x in back_driving_shares(chain, [o], values[None]).items()
            },
            turn=float(np.ptp(o.q[o.filter.centres])),
            steady=_steady(chain, o, values),
            added_mass=o.inputs.added_mass,
            radius=o.inputs.radius,
        )
        for o in observations
    )


def back_driving_shares(
    chain: Joint, observations: Sequence[Observation], values: Array
) -> dict[str, Array]:
    """Give how often the load drives each element that has a load loss."""
    found = {}
    for i, element in enumerate(chain.elements):
        if element.load_loss == "none":
            continue
        back, moving = np.zeros(values.shape[0]), 0
        for o in observations:
            outputs = np.flatnonzero(o.speed)
            passed = _behind(chain, i, o, outputs, values)
            back += np.count_nonzero(passed * o.speed[outputs] < 0.0, axis=1)
            moving += outputs.size
        found[element.name] = back / max(moving, 1)
    return found


def _behind(
    chain: Joint, i: int, o: Observation, outputs: NDArray[np.int64], values: Array
) -> Array:
    """Torque at the output of element ``i``, ``(n, len(outputs))``.

    Of the last element that is the load's; else that of the shorter chain behind it.
    """
    at = o.filter.centres[outputs]
    q, qd, qdd = o.q[at], o.qd[at], o.acceleration[outputs]
    if i + 1 == len(chain.elements):
        return np.stack(
            [load_torque(chain, v, q, qdd, inputs=o.inputs, time=o.stamps[at]) for v in values]
        )
    rest = Joint(chain.elements[i + 1 :], chain.load)
    columns = [chain.names.index(name) for name in rest.names]
    time = o.stamps[at]
    return inverse_torque(rest, values[:, columns], q, qd, qdd, inputs=o.inputs, time=time)


def _steady(chain: Joint, o: Observation, values: Array) -> float:
    """Share of outputs in which the torque would be the same without acceleration."""
    still = replace(o, qdd=np.zeros_like(o.qdd))
    whole = filtered_torque(chain, o, values[None])[0]
    without = filtered_torque(chain, still, values[None])[0]
    return float(np.mean(np.abs(whole - without) < _LITTLE * np.abs(whole)))
