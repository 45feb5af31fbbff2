"""What the modelled torque is behind the filter of the measured one, and its derivatives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from bayesfric.mechanism.inverse import load_torque, torque_at
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

# Outputs further apart than this are taken to know nothing of each other.
_FAR = 2000

# Numbers of unfiltered torque held at once.
_ROWS_AT_ONCE = 2_000_000
# The load torque at which efficiencies are stated: nearly the largest of the recordings.
_LOAD_QUANTILE = 0.95


def filtered_torque(chain: Joint, observation: Observation, values: Array) -> Array:
    """Motor torque along a measured motion, behind the filter of the measured torque.

    Shapes: values (n, n_parameters); returns (n, n_outputs).
    """
    out = np.empty((values.shape[0], observation.filter.n_outputs))
    for part, torque in _torques(chain, observation, values):
        out[part] = observation.filter.apply(torque)
    return out


def weighed_torque(chain: Joint, observation: Observation, weights: Array, values: Array) -> Array:
    """Weigh the samples of the modelled torque before any filter.

    Shapes: weights (k, n_samples); returns (k, n).
    """
    out = np.empty((len(weights), values.shape[0]))
    for part, torque in _torques(chain, observation, values):
        # no threads: for products this small those of @ cost more, on a busy machine fifty times
        out[:, part] = np.einsum("ks,ns->kn", weights, torque)
    return out


def _torques(
    chain: Joint, observation: Observation, values: Array
) -> Iterator[tuple[slice, Array]]:
    """Give unfiltered torque of a few vectors at a time: of a long recording it is large."""
    o = observation
    samples = chain.samples(o.q, o.qd, o.qdd, o.inputs, o.stamps)
    rows = max(1, _ROWS_AT_ONCE // max(o.q.size, 1))
    for first in range(0, values.shape[0], rows):
        part = slice(first, first + rows)
        yield part, torque_at(chain, values[part], samples, o.inputs)


def torque_jacobian(
    chain: Joint, observations: Sequence[Observation], values: Array, steps: Array
) -> Array:
    """Differentiate the filtered torque by the chain's parameters.

    The torque is linear in every parameter that adds to it, so a difference to one side is exact up
    to rounding except where a step changes the direction of power; in what only shapes other terms
    differences are central.

    Shapes: values (n_parameters,); steps (n_parameters,); returns (n_outputs, n_parameters).
    """
    moving = np.flatnonzero(steps)
    beside = np.eye(values.size)[moving] * steps
    shaping = np.array([chain.parameters[k].row.role == "form" for k in moving], dtype=bool)
    moved = np.concatenate([values[None], values + beside, values - beside[shaping]])
    blocks = []
    for o in observations:
        torque = filtered_torque(chain, o, moved)
        here, up, down = np.split(torque, [1, 1 + moving.size])
        change = up - here
        change[shaping] = (up[shaping] - down) / 2.0
        block = np.zeros((o.filter.n_outputs, values.size))
        block[:, moving] = (change / steps[moving, None]).T
        blocks.append(block)
    return np.concatenate(blocks)


def load_at_outputs(chain: Joint, o: Observation, values: Array) -> Array:
    """Torque ``(n_outputs,)`` that moves the load itself at the middles of the outputs, eq. (3).

    ``values`` ``(n_parameters,)`` in the order of ``chain.names``; N m or N at the joint.
    """
    at = o.filter.centres
    return load_torque(chain, values, o.q[at], o.acceleration, inputs=o.inputs, time=o.stamps[at])


def typical_load(chain: Joint, observations: Sequence[Observation], values: Array) -> float:
    """Joint torque at which efficiencies are stated: the 95th percentile of the recordings.

    Shapes: values (n_parameters,).
    """
    loads = [load_at_outputs(chain, o, values) for o in observations]
    return float(np.quantile(np.abs(np.concatenate(loads)), _LOAD_QUANTILE))


def places(observations: Sequence[Observation]) -> NDArray[np.int64]:
    """Position of every output on an even grid of time. Shapes: returns (n_outputs,)."""
    found, begin = [], 0
    for o in observations:
        step = max(int(np.diff(o.filter.starts).min(initial=len(o.filter.taps))), 1)
        raw = o.filter.starts // step
        # a gap after each segment as long as a tenth of the recording keeps them apart; with
        # thousands of segments more than what any kernel spans would only be zeros
        apart = min(int(raw[-1] - raw[0]) // 10 + 1, _FAR)
        found.append(raw - raw[0] + o.segment_of * apart + begin)
        begin = int(found[-1][-1]) + apart
    return np.concatenate(found)
