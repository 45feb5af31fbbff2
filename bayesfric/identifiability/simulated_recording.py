"""Recordings simulated at the estimate with another mass or torque, and their information.

They pass the filters of a measured recording, and have its noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bayesfric.estimates.autoregression import follows
from bayesfric.identifiability.local import torque_changes
from bayesfric.inference.likelihood import TorqueLikelihood
from bayesfric.inference.noise import Autoregressive
from bayesfric.inference.target import LocalUnits, Target
from bayesfric.mechanism import experiment
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.checks import moving_samples
from bayesfric.recordings.filters import derivative, lay_windows, lowpass
from bayesfric.recordings.measurement import AT_ROOM, Inputs
from bayesfric.recordings.observation import Observation, as_position, retimed

# Time constant of a current loop, as in the paper's bench.
LAG = 0.005
# Sines that are most informative, as multiples of the joint's pace.
LINES: Array = np.array([0.37, 0.73, 1.3, 2.9, 5.3])
# Largest mass to propose, kg.
HEAVIEST = 5.0

# Whitens changes of the torque (..., M) of a recording to unit noise.
Whitening = Callable[[Array, Observation], Array]


def sample_period(observation: Observation) -> float:
    """Time from one raw sample to the next, s."""
    step = np.diff(observation.filter.starts)
    return observation.period / max(int(step.min(initial=step[:1].sum())), 1)


def of_load(chain: Joint, values: Array) -> dict[str, float]:
    """Give the load's parameters among ``values`` ``(n_parameters,)``, by quantity."""
    pairs = zip(chain.parameters, values.tolist(), strict=True)
    return {p.quantity: value for p, value in pairs if p.owner == "load"}


def known_mass(chain: Joint, values: Array) -> Inputs:
    """Choose a mass and a radius about as heavy as the load, rounded."""
    load = of_load(chain, values)
    inertia, moment = load.get("inertia", 0.0), load.get("first_moment", 0.0)
    # total inertia at the joint, for a load without an inertia
    time = np.zeros(2)
    motion = [0.0, 0.0], [0.0, 0.0], [0.0, 1.0]
    torques = inverse_torque(chain, values, *motion, inputs=AT_ROOM, time=time)
    total_inertia = inertia if inertia > 0.0 else float(chain.ratio * (torques[1] - torques[0]))
    radius = 0.0 if chain.load.motion == "linear" else 0.35
    if radius == 0.0 or moment <= 0.0:
        mass = total_inertia / (radius**2 or 1.0)
        return Inputs(_two_digits(min(mass, HEAVIEST)) if total_inertia > 0.0 else 2.0, radius)
    if inertia > 0.0:
        radius = float(np.clip(inertia / moment, 0.05, 1.0))
    elif moment <= 0.1:
        radius = 0.1
    return Inputs(_two_digits(min(moment / radius, HEAVIEST)), _two_digits(radius))


def square_with_sines(time: Array, hertz: float, lines: Array) -> Array:
    """Make a signal of peak one, a square wave with a multisine of ``lines`` Hz on it, ``(N,)``."""
    return experiment.square(time, 0.6, hertz) + 0.4 * sines(time, lines)


def sines(time: Array, lines: Array) -> Array:
    """Make a multisine of peak one and ``lines`` Hz, ``(N,)``."""
    signal = experiment.multisine(time, 1.0, lines)
    return np.asarray(signal / max(float(np.abs(signal).max()), 1e-12))


def torque_noise(target: Target, parameters: Array, number: int) -> Whitening:
    """Return the whitening by the noise of a recording's filtered torque, for any likelihood."""
    scales = target.noise.scales(parameters[None, len(target.free) :])[0, number]
    likelihood, model = target.likelihood, Autoregressive()
    if isinstance(likelihood, TorqueLikelihood):
        model = likelihood.noise
    else:  # the noise of a sample, filtered
        taps = likelihood.observations[number].filter.taps
        scales = scales[:1] * float(np.linalg.norm(taps))
    return lambda rows, observation: model.standard(rows, follows(observation), scales)[0]


def scaled_jacobian(
    target: Target, observation: Observation, values: Array, at: LocalUnits, whiten: Whitening
) -> Array:
    """Differentiate a recording's filtered torque over its noise, ``(n_outputs, d)``."""
    jacobian = torque_changes(target.likelihood.chain, [observation], values, at) * at.units
    return whiten(jacobian.T, observation).T


def longest_stretch(observation: Observation, duration: float | None = 10.0) -> slice:
    """Give the longest segment that outputs come from, at most ``duration`` s of it."""
    segment_of = observation.segment_of
    segments, counts = np.unique(segment_of, return_counts=True)
    starts = observation.filter.starts[segment_of == segments[int(np.argmax(counts))]]
    first = int(starts[0])
    last = int(starts[-1]) + len(observation.filter.taps)
    if duration is None:
        return slice(first, last)
    samples = min(20_000, int(duration / sample_period(observation)))
    return slice(first, min(last, first + samples))


def simulate_recording(
    chain: Joint,
    values: Array,
    observation: Observation,
    torque: Array,
    inputs: Inputs,
    initial: tuple[float, float] | None = None,
) -> Observation:
    """Simulate a torque ``(N,)`` and prepare it like a recording; ValueError at standstill."""
    if initial is None:
        first = longest_stretch(observation).start
        initial = float(observation.q[first]), float(observation.qd[first])
    period, size = sample_period(observation), torque.size
    inputs = replace(inputs, recording=observation.inputs.recording)
    q0, qd0 = initial
    motion = simulate(chain, values, torque, period, q0=q0, qd0=qd0, inputs=inputs, substeps=4)
    settings, segments = observation.settings, ((0, torque.size),)
    q, qd, qdd = motion.q, motion.qd, motion.qdd
    cutoff, order = float(settings.get("lowpass", 0.0)), int(settings.get("order", 0))
    # filtered and differentiated like the recording, so that it blurs as much
    if cutoff and order and settings.get("motion") != "refined":
        reach = int(settings.get("reach", 1))
        q = lowpass(q, segments, 1.0 / period, cutoff, order)
        qd = derivative(q, segments, period, reach)
        qdd = derivative(qd, segments, period, reach)
    slow = 0.01 * float(np.quantile(np.abs(observation.qd), 0.99))
    trim = int(settings.get("trim_samples", 0))
    step = max(round(observation.period / period), 1)
    guard = int(settings.get("guard", size))
    moving = moving_samples(qd, segments, float(settings.get("dead_zone", slow)), guard)
    span = (trim, max(size - trim, trim))
    windows = lay_windows(observation.filter.taps, (span,), step, moving & (motion.qd != 0.0))
    if windows.n_outputs < 20:
        raise ValueError("the joint hardly moves")
    recording = replace(
        observation,
        name="simulated",
        q=q,
        qd=qd,
        qdd=qdd,
        smooth=None,
        torque=torque,
        filter=windows,
        time=motion.time[windows.centres],
        measured=windows.apply(as_position(torque, segments, period, settings)),
        speed=qd[windows.centres],
        segment_of=np.zeros(windows.n_outputs, dtype=np.int64),
        stamps=motion.time,
        inputs=inputs,
    )
    if not chain.delay:
        return recording
    return retimed(recording, segments, period, float(chain.delays(values[None])[0]))


def _two_digits(x: float) -> float:
    return float(f"{x:.2g}")
