"""Recordings that nobody made: the same joint, simulated with another mass or torque."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.torque import torque_jacobian
from bayesfric.mechanism import excitation
from bayesfric.mechanism.chain import Chain
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.inverse import load_torque
from bayesfric.recordings.filters import ParallelFilter
from bayesfric.recordings.observation import Observation

Array = NDArray[np.float64]

# No more of a recording is simulated than this, in samples and in s.
_LONGEST_SAMPLES = 20_000
_LONGEST = 10.0
# Time constant of a current loop, as in the paper's bench.
_LAG = 0.005
# A mass where the load tells none, kg and m, and the most that anyone would bolt on.
_MASS, _RADIUS = 2.0, 0.35
_MOST = 5.0


def sample_period(observation: Observation) -> float:
    """Time from one raw sample to the next, s."""
    step = np.diff(observation.filter.starts)
    return observation.period / max(int(step.min(initial=step[:1].sum())), 1)


def known_mass(chain: Chain, values: Array) -> tuple[float, float]:
    """Choose a mass and a radius about as heavy as the load itself, rounded.

    Parameters
    ----------
    chain
        The mechanism.
    values
        ``(n_parameters,)``.

    Returns
    -------
    tuple of float
        kg and m, whose inertia and first moment come to those of the load where it has both
        and is not too heavy.
    """
    # at rest and upright the load's torque is its inertia; level and still, its moment
    inertia = float(
        load_torque(chain, values, [0.0], [1.0])[0] - load_torque(chain, values, [0.0], [0.0])[0]
    )
    if chain.load.motion == "linear":
        return (_two_digits(min(inertia, _MOST)) if inertia > 0.0 else _MASS), 0.0
    names = chain.names
    moment = (
        float(values[names.index("load.first_moment")]) if "load.first_moment" in names else 0.0
    )
    if moment <= 0.0:
        return _MASS, _RADIUS
    if inertia <= 0.0:
        radius = _RADIUS if moment > 0.1 else 0.1
        return _two_digits(min(moment / radius, _MOST)), radius
    radius = float(np.clip(inertia / moment, 0.05, 1.0))
    return _two_digits(min(moment / radius, _MOST)), _two_digits(radius)


def with_mass(
    chain: Chain, values: Array, observation: Observation, added_mass: float, radius: float
) -> Observation:
    """Play the measured torque to the joint with a known mass on its load.

    Raises
    ------
    ValueError
        If the joint cannot be simulated, or then stands still.
    """
    cut = _whole(observation)
    return _simulated(chain, values, observation, observation.torque[cut], added_mass, radius)


def with_torque(
    chain: Chain, values: Array, observation: Observation, form: str, share: float = 1.0
) -> Observation:
    """Play another torque to the joint, with the recording's largest torque as its peak.

    Parameters
    ----------
    chain, values, observation
        The mechanism, its parameters ``(n_parameters,)``, and the recording that sets
        rate, length, filter and peak.
    form
        ``square`` behind a current loop, ``square-multisine``, or ``same``.
    share
        Factor on the torque.

    Raises
    ------
    ValueError
        If the joint cannot be simulated, or then stands still.
    """
    cut = _whole(observation)
    measured = observation.torque[cut]
    period = sample_period(observation)
    time = period * np.arange(measured.size)
    peak = share * float(np.quantile(np.abs(measured), 0.99))
    hertz = pace(observation)
    if form == "same":
        torque = share * measured
    elif form == "square":
        torque = excitation.square(time, peak, hertz)
    else:
        many = excitation.multisine(time, 1.0, hertz * np.array([0.37, 0.73, 1.3, 2.9, 5.3]))
        torque = excitation.square(time, 0.6 * peak, hertz)
        torque = torque + many * 0.4 * peak / float(np.abs(many).max())
    if form != "same":
        torque = excitation.current_loop(torque, period, _LAG)
    return _simulated(
        chain, values, observation, torque, observation.added_mass, observation.radius
    )


def pace(observation: Observation) -> float:
    """How often the joint goes to and fro, Hz, rounded; at least five times a recording."""
    at = observation.filter.centres
    speed = observation.qd[at]
    turns = np.count_nonzero(np.diff(np.sign(speed)) != 0) / 2.0
    duration = max(observation.period * at.size, 1e-9)
    return _two_digits(max(turns, 5.0) / duration)


def torque_information(
    chain: Chain, observation: Observation, values: Array, units: Array, sigma: float
) -> Array:
    """Fisher information of a recording's torque, ``(n_parameters, n_parameters)``, in units.

    ``units`` is zero for parameters that are known; ``sigma`` is the noise of a filtered
    output.
    """
    jacobian = torque_jacobian(chain, [observation], values, 1e-6 * units) * units / sigma
    return np.asarray(jacobian.T @ jacobian)


def _whole(observation: Observation) -> slice:
    """Find the longest stretch that outputs come from, cut to what is worth simulating."""
    number = observation.segment_of
    segments, counts = np.unique(number, return_counts=True)
    starts = observation.filter.starts[number == segments[int(np.argmax(counts))]]
    first = int(starts[0])
    last = int(starts[-1]) + len(observation.filter.taps)
    most = min(_LONGEST_SAMPLES, int(_LONGEST / sample_period(observation)))
    return slice(first, min(last, first + most))


def _simulated(
    chain: Chain,
    values: Array,
    observation: Observation,
    torque: Array,
    added_mass: float,
    radius: float,
) -> Observation:
    first = _whole(observation).start
    motion = simulate(
        chain,
        values,
        torque,
        sample_period(observation),
        q0=float(observation.q[first]),
        qd0=float(observation.qd[first]),
        added_mass=added_mass,
        radius=radius,
        substeps=4,
    )
    taps, period = observation.filter.taps, sample_period(observation)
    step = max(round(observation.period / period), 1)
    slow = np.abs(motion.qd) < _dead_zone(observation)
    # a window counts where the joint moves, in one direction, in all of it
    ends = np.concatenate([[0], np.cumsum(slow)])
    starts = np.arange(0, torque.size - len(taps) + 1, step, dtype=np.int64)
    starts = starts[ends[starts + len(taps)] == ends[starts]]
    if starts.size < 20:
        raise ValueError("the joint hardly moves")
    chosen = ParallelFilter(taps, starts)
    return replace(
        observation,
        name="simulated",
        q=motion.q,
        qd=motion.qd,
        qdd=motion.qdd,
        torque=torque,
        filter=chosen,
        time=motion.time[chosen.centres],
        measured=chosen.apply(torque),
        speed=motion.qd[chosen.centres],
        segment_of=np.zeros(starts.size, dtype=np.int64),
        added_mass=added_mass,
        radius=radius,
    )


def _dead_zone(observation: Observation) -> float:
    told = observation.settings.get("dead_zone")
    if told is not None:
        return float(told)
    return 0.01 * float(np.quantile(np.abs(observation.qd), 0.99))


def _two_digits(x: float) -> float:
    return float(f"{x:.2g}")
