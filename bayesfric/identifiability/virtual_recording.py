"""Recordings that nobody made: the same joint, simulated with another mass or torque."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesfric.estimates.torque import torque_jacobian
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.moments.residual_moments import follows
from bayesfric.inference.noise.autoregressive import Autoregressive
from bayesfric.inference.noise.residual_noise import ResidualNoise
from bayesfric.inference.target import Target
from bayesfric.mechanism import excitation
from bayesfric.mechanism.chain import Chain
from bayesfric.mechanism.forward import Motion, simulate
from bayesfric.mechanism.inverse import inverse_torque, load_torque
from bayesfric.recordings.filters import derivative, lay_windows, lowpass
from bayesfric.recordings.observation import Observation, moving_samples

Array = NDArray[np.float64]

# No more of a recording is simulated than this, in samples and in s.
_LONGEST_SAMPLES = 20_000
_LONGEST = 10.0
# Time constant of a current loop, as in the paper's bench.
_LAG = 0.005
# A mass where the load tells none, kg and m, and the most that anyone would bolt on.
_MASS, _RADIUS = 2.0, 0.35
_MOST = 5.0
# With fewer outputs than this, of twenty times as many samples or more, the joint stood still.
_FEWEST = 20


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
        and is not too heavy; where it has neither, to the inertia of the whole.
    """
    # at rest and upright the load's torque is its inertia; level and still, its moment
    inertia = float(
        load_torque(chain, values, [0.0], [1.0])[0] - load_torque(chain, values, [0.0], [0.0])[0]
    )
    # all inertia there is, seen at the joint, for a load that is no parameter of its own
    still = inverse_torque(chain, values, [0.0, 0.0], [0.0, 0.0], [0.0, 1.0])
    felt = inertia if inertia > 0.0 else float(chain.ratio * (still[1] - still[0]))
    if chain.load.motion == "linear":
        return (_two_digits(min(felt, _MOST)) if felt > 0.0 else _MASS), 0.0
    names = chain.names
    moment = (
        float(values[names.index("load.first_moment")]) if "load.first_moment" in names else 0.0
    )
    if moment <= 0.0:
        return (_two_digits(min(felt / _RADIUS**2, _MOST)) if felt > 0.0 else _MASS), _RADIUS
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
    cut = longest_stretch(observation)
    return played(chain, values, observation, observation.torque[cut], added_mass, radius)


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
    cut = longest_stretch(observation)
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
    return played(chain, values, observation, torque, observation.added_mass, observation.radius)


def pace(observation: Observation) -> float:
    """How often the joint goes to and fro, Hz, rounded; at least five times a recording."""
    at = observation.filter.centres
    speed = observation.qd[at]
    turns = np.count_nonzero(np.diff(np.sign(speed)) != 0) / 2.0
    duration = max(observation.period * at.size, 1e-9)
    return _two_digits(max(turns, 5.0) / duration)


@dataclass(frozen=True, eq=False)
class TorqueNoise:
    """Noise of the filtered torque: its model, and the model's scales ``(Q,)``."""

    model: ResidualNoise
    scales: Array

    def whitened(self, rows: Array, observation: Observation) -> Array:
        """Turn changes of the torque ``(..., M)`` into ones with independent unit noise."""
        return self.model.standard(rows, follows(observation), self.scales)[0]


def torque_noise(target: Target, parameters: Array, number: int) -> TorqueNoise:
    """Give the noise of a recording's filtered torque, whatever the likelihood is of.

    ``parameters`` ``(d,)``, noise scales last.
    """
    scales = target.noise.scales(parameters[None, len(target.free) :])[0, number]
    likelihood = target.likelihood
    if isinstance(likelihood, TorqueLikelihood):
        return TorqueNoise(likelihood.noise, scales)
    # the noise of a sample, then filtered
    taps = likelihood.observations[number].filter.taps
    return TorqueNoise(Autoregressive(), scales[:1] * float(np.linalg.norm(taps)))


def scaled_jacobian(
    target: Target, observation: Observation, values: Array, units: Array, noise: TorqueNoise
) -> Array:
    """Differentiate a recording's filtered torque over its noise by the free parameters.

    Its square is the recording's Fisher information.

    Parameters
    ----------
    target
        Says which parameters are free.
    observation
        The recording; none of the target's, maybe.
    values
        ``(n_parameters,)`` in the order of the chain's names.
    units
        ``(k,)`` of the free parameters: what counts as a change of one.
    noise
        Of the filtered output.

    Returns
    -------
    ndarray
        ``(n_outputs, k)``, in units.
    """
    chain = target.likelihood.chain
    columns = [chain.names.index(name) for name in target.free]
    steps = np.zeros(values.size)
    steps[columns] = 1e-6 * units
    jacobian = torque_jacobian(chain, [observation], values, steps)[:, columns] * units
    return noise.whitened(jacobian.T, observation).T


def longest_stretch(observation: Observation, most: float | None = _LONGEST) -> slice:
    """Find the longest stretch that outputs come from, no more than ``most`` s of it."""
    number = observation.segment_of
    segments, counts = np.unique(number, return_counts=True)
    starts = observation.filter.starts[number == segments[int(np.argmax(counts))]]
    first = int(starts[0])
    last = int(starts[-1]) + len(observation.filter.taps)
    if most is None:
        return slice(first, last)
    samples = min(_LONGEST_SAMPLES, int(most / sample_period(observation)))
    return slice(first, min(last, first + samples))


def played(
    chain: Chain,
    values: Array,
    observation: Observation,
    torque: Array,
    added_mass: float,
    radius: float,
    state: tuple[float, float] | None = None,
) -> Observation:
    """Play a torque to the joint, and look at it as one looks at a recording.

    Parameters
    ----------
    chain, values
        The mechanism and its parameters, ``(n_parameters,)``.
    observation
        The recording whose sample rate, filter and dead zone are used.
    torque
        ``(N,)`` motor torque at every sample, N m or N.
    added_mass, radius
        kg and m.
    state
        Position and speed to begin with, rad or m and s; those of the recording if left out.

    Raises
    ------
    ValueError
        If the joint cannot be simulated, or then stands still.
    """
    if state is None:
        first = longest_stretch(observation).start
        state = float(observation.q[first]), float(observation.qd[first])
    motion = simulate(
        chain,
        values,
        torque,
        sample_period(observation),
        q0=state[0],
        qd0=state[1],
        added_mass=added_mass,
        radius=radius,
        substeps=4,
    )
    period, size = sample_period(observation), torque.size
    q, qd, qdd = _as_filtered(motion, observation)
    trim = int(observation.settings.get("trim_samples", 0))
    step = max(round(observation.period / period), 1)
    guard = int(observation.settings.get("guard", size))
    moving = moving_samples(qd, ((0, size),), _dead_zone(observation), guard)
    kept = (trim, max(size - trim, trim))
    chosen = lay_windows(observation.filter.taps, (kept,), step, moving & (motion.qd != 0.0))
    if chosen.n_outputs < _FEWEST:
        raise ValueError("the joint hardly moves")
    return replace(
        observation,
        name="simulated",
        q=q,
        qd=qd,
        qdd=qdd,
        torque=torque,
        filter=chosen,
        time=motion.time[chosen.centres],
        measured=chosen.apply(torque),
        speed=qd[chosen.centres],
        segment_of=np.zeros(chosen.n_outputs, dtype=np.int64),
        added_mass=added_mass,
        radius=radius,
    )


def _as_filtered(motion: Motion, observation: Observation) -> tuple[Array, Array, Array]:
    """Filter and differentiate a motion like the recording's, so that it blurs as much."""
    told = observation.settings
    cutoff, order = float(told.get("lowpass", 0.0)), int(told.get("order", 0))
    if not cutoff or not order:
        return motion.q, motion.qd, motion.qdd
    whole, period = ((0, motion.q.size),), sample_period(observation)
    q = lowpass(motion.q, whole, 1.0 / period, cutoff, order)
    reach = int(told.get("reach", 1))
    qd = derivative(q, whole, period, reach)
    return q, qd, derivative(qd, whole, period, reach)


def _dead_zone(observation: Observation) -> float:
    told = observation.settings.get("dead_zone")
    if told is not None:
        return float(told)
    return 0.01 * float(np.quantile(np.abs(observation.qd), 0.99))


def _two_digits(x: float) -> float:
    return float(f"{x:.2g}")
