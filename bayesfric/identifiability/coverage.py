"""What each recording covers: direction of power, range of position, acceleration."""

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


@dataclass(frozen=True)
class Coverage:
    """What one recording covers, at the point estimate."""

    name: str
    outputs: int
    moving: float  # share of outputs in which the joint moves
    # share of those in which the load drives each element with load-dependent friction
    load_drives: dict[str, float]
    turn: float  # range of the joint's position, rad or m
    steady: float  # share of outputs in which inertia takes less than a twentieth of the torque
    added_mass: float  # known mass on the load, kg
    radius: float  # its distance from the axis, m


def coverage_of(
    chain: Joint, observations: Sequence[Observation], values: Array
) -> tuple[Coverage, ...]:
    """Compute what every recording covers at ``values`` ``(n_parameters,)``."""
    return tuple(
        Coverage(
            name=o.name,
            outputs=int(o.measured.size),
            moving=float(np.mean(o.qd[o.filter.centres] != 0.0)),
            load_drives=back_driving(chain, [o], values),
            turn=float(np.ptp(o.q[o.filter.centres])),
            steady=_steady(chain, o, values),
            added_mass=o.inputs.added_mass,
            radius=o.inputs.radius,
        )
        for o in observations
    )


def back_driving(
    chain: Joint, observations: Sequence[Observation], values: Array
) -> dict[str, float]:
    """Share of moving outputs in which the load drives each lossy element, at one vector."""
    shares = back_driving_shares(chain, observations, values[None])
    return {name: float(share[0]) for name, share in shares.items()}


def back_driving_shares(
    chain: Joint, observations: Sequence[Observation], values: Array
) -> dict[str, Array]:
    """Share of moving outputs in which the load drives each element with load-dependent friction.

    Of vectors ``(n, n_parameters)``: ``(n,)`` each.
    """
    shares = {}
    for i, element in enumerate(chain.elements):
        if element.load_loss == "none":
            continue
        back, moving = np.zeros(values.shape[0]), 0
        for o in observations:
            outputs = np.flatnonzero(o.speed)
            transmitted = _behind(chain, i, o, outputs, values)
            back += np.count_nonzero(transmitted * o.speed[outputs] < 0.0, axis=1)
            moving += outputs.size
        shares[element.name] = back / max(moving, 1)
    return shares


def _behind(
    chain: Joint, i: int, o: Observation, outputs: NDArray[np.int64], values: Array
) -> Array:
    """Torque at the output of element ``i``, ``(n, len(outputs))``."""
    at = o.filter.centres[outputs]
    q, qd, qdd, time = o.q[at], o.qd[at], o.acceleration[outputs], o.stamps[at]
    if i + 1 == len(chain.elements):
        torques = (load_torque(chain, v, q, qdd, inputs=o.inputs, time=time) for v in values)
        return np.stack([*torques])
    rest = Joint(chain.elements[i + 1 :], chain.load)
    columns = [chain.names.index(name) for name in rest.names]
    return inverse_torque(rest, values[:, columns], q, qd, qdd, inputs=o.inputs, time=time)


def _steady(chain: Joint, o: Observation, values: Array) -> float:
    """Share of outputs in which inertia takes less than a twentieth of the torque."""
    steady = replace(o, qdd=np.zeros_like(o.qdd))
    torque = filtered_torque(chain, o, values[None])[0]
    steady_torque = filtered_torque(chain, steady, values[None])[0]
    return float(np.mean(np.abs(torque - steady_torque) < 0.05 * np.abs(torque)))
