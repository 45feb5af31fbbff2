"""The modelled torque behind the filter of the measured one, and its derivatives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from bayesfric.mechanism.inverse import load_torque, torque_at
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.observation import Observation

# Outputs further apart than this are taken to be independent.
_FAR = 2000
# Numbers of unfiltered torque held at once.
_ROWS_AT_ONCE = 2_000_000
# The load torque at which efficiencies are stated: nearly the largest of the recordings.
_LOAD_QUANTILE = 0.95


def filtered_torque(chain: Joint, observation: Observation, values: Array) -> Array:
    """Model the motor torque ``(n, n_outputs)`` of vectors ``(n, n_parameters)``, filtered."""
    out = np.empty((values.shape[0], observation.filter.n_outputs))
    for part, torque in _torques(chain, observation, values):
        out[part] = observation.filter.apply(torque)
    return out


def weighted_torque(chain: Joint, observation: Observation, weights: Array, values: Array) -> Array:
    """Apply weights ``(k, n_samples)`` to the modelled torque before any filter: ``(k, n)``."""
    out = np.empty((len(weights), values.shape[0]))
    for part, torque in _torques(chain, observation, values):
        # einsum has no threads: for products this small those of @ cost up to fifty times as much
        out[:, part] = np.einsum("ks,ns->kn", weights, torque)
    return out


def _torques(
    chain: Joint, observation: Observation, values: Array
) -> Iterator[tuple[slice, Array]]:
    """Yield unfiltered torque of a few vectors at a time: that of a long recording is large."""
    o = observation
    samples = chain.samples(o.q, o.qd, o.qdd, o.inputs, o.stamps)
    rows = max(1, _ROWS_AT_ONCE // max(o.q.size, 1))
    for first in range(0, values.shape[0], rows):
        part = slice(first, first + rows)
        yield part, torque_at(chain, values[part], samples, o.inputs)


def torque_jacobian(
    chain: Joint, observations: Sequence[Observation], values: Array, steps: Array
) -> Array:
    """Differentiate the filtered torque by the parameters: ``(n_outputs, n_parameters)``.

    The torque is linear in every parameter that adds to it, so one-sided differences are exact up
    to rounding except where a step changes the direction of power; of what only shapes terms they
    are central. Columns are zero where the step ``(n_parameters,)`` is.
    """
    moving = np.flatnonzero(steps)
    shifts = np.eye(values.size)[moving] * steps
    shaping = np.array([chain.parameters[k].row.role == "form" for k in moving], dtype=bool)
    vectors = np.concatenate([values[None], values + shifts, values - shifts[shaping]])
    blocks = []
    for o in observations:
        torque = filtered_torque(chain, o, vectors)
        middle, up, down = np.split(torque, [1, 1 + moving.size])
        difference = up - middle
        difference[shaping] = (up[shaping] - down) / 2.0
        block = np.zeros((o.filter.n_outputs, values.size))
        block[:, moving] = (difference / steps[moving, None]).T
        blocks.append(block)
    return np.concatenate(blocks)


def load_at_outputs(chain: Joint, o: Observation, values: Array) -> Array:
    """Compute the load's own torque ``(n_outputs,)`` at the middles of the outputs, eq. (3).

    N m or N at the joint.
    """
    at = o.filter.centres
    return load_torque(chain, values, o.q[at], o.acceleration, inputs=o.inputs, time=o.stamps[at])


def typical_load(chain: Joint, observations: Sequence[Observation], values: Array) -> float:
    """Give the joint torque at which efficiencies are stated: the recordings' 95th percentile."""
    loads = [load_at_outputs(chain, o, values) for o in observations]
    return float(np.quantile(np.abs(np.concatenate(loads)), _LOAD_QUANTILE))


def places(observations: Sequence[Observation]) -> NDArray[np.int64]:
    """Give each output its place ``(n_outputs,)`` on an even grid of time, segments far apart."""
    numbers, first = [], 0
    for o in observations:
        step = max(int(np.diff(o.filter.starts).min(initial=len(o.filter.taps))), 1)
        raw = o.filter.starts // step
        # a gap of a tenth of the recording separates segments, at most what any kernel spans
        gap = min(int(raw[-1] - raw[0]) // 10 + 1, _FAR)
        numbers.append(raw - raw[0] + o.segment_of * gap + first)
        first = int(numbers[-1][-1]) + gap
    return np.concatenate(numbers)
