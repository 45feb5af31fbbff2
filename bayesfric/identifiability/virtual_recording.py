"""Recordings that nobody made: the same joint, simulated with another mass or torque.

They are looked at through the filters of a recording that was made; what they tell is weighed with
its noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesfric.identifiability.local import torque_changes
from bayesfric.inference.likelihood.torque_likelihood import TorqueLikelihood
from bayesfric.inference.local_units import LocalUnits
from bayesfric.inference.moments.residual_moments import follows
from bayesfric.inference.noise.autoregressive import Autoregressive
from bayesfric.inference.target import Target
from bayesfric.mechanism import excitation
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.filters import derivative, lay_windows, lowpass
from bayesfric.recordings.inputs import AT_ROOM, Inputs
from bayesfric.recordings.moving import moving_samples
from bayesfric.recordings.observation import Observation, as_position
from bayesfric.recordings.timing import retimed

# No more of a recording is simulated than this, in samples and in s.
_LONGEST_SAMPLES = 20_000
_LONGEST = 10.0
# Time constant of a current loop, as in the paper's bench.
LAG = 0.005
# Sines that tell most, as multiples of how often the joint goes to and fro; and of a torque's
# peak, the share of the square wave that carries them.
LINES: Array = np.array([0.37, 0.73, 1.3, 2.9, 5.3])
_SQUARE_SHARE = 0.6
# A mass where the load tells none, kg and m, and the most that anyone would bolt on.
_MASS, _RADIUS = 2.0, 0.35
HEAVIEST = 5.0
# With fewer outputs than this, of twenty times as many samples or more, the joint stood still.
_FEWEST = 20


def sample_period(observation: Observation) -> float:
    """Time from one raw sample to the next, s."""
    step = np.diff(observation.filter.starts)
    return observation.period / max(int(step.min(initial=step[:1].sum())), 1)


def of_load(chain: Joint, values: Array) -> dict[str, float]:
    """Give the load's own parameters among ``values`` ``(n_parameters,)``, by quantity."""
    pairs = zip(chain.parameters, values.tolist(), strict=True)
    return {p.quantity: value for p, value in pairs if p.owner == "load"}


def known_mass(chain: Joint, values: Array) -> Inputs:
    """Choose a mass and a radius about as heavy as the load itself, rounded."""
    of = of_load(chain, values)
    inertia, moment = of.get("inertia", 0.0), of.get("first_moment", 0.0)
    # all inertia there is, seen at the joint, for a load that is no parameter of its own
    time = np.zeros(2)
    motion = [0.0, 0.0], [0.0, 0.0], [0.0, 1.0]
    still = inverse_torque(chain, values, *motion, inputs=AT_ROOM, time=time)
    felt = inertia if inertia > 0.0 else float(chain.ratio * (still[1] - still[0]))
    radius = 0.0 if chain.load.motion == "linear" else _RADIUS
    if radius == 0.0 or moment <= 0.0:
        mass = felt / (radius**2 or 1.0)
        return Inputs(_two_digits(min(mass, HEAVIEST)) if felt > 0.0 else _MASS, radius)
    if inertia > 0.0:
        radius = float(np.clip(inertia / moment, 0.05, 1.0))
    elif moment <= 0.1:
        radius = 0.1
    return Inputs(_two_digits(min(moment / radius, HEAVIEST)), _two_digits(radius))


def square_with_sines(time: Array, hertz: float, lines: Array) -> Array:
    """Make a signal of peak one, a square wave with a multisine of ``lines`` Hz on it, ``(N,)``."""
    return excitation.square(time, _SQUARE_SHARE, hertz) + (1.0 - _SQUARE_SHARE) * sines(
        time, lines
    )


def sines(time: Array, lines: Array) -> Array:
    """Make a multisine of peak one and ``lines`` Hz, ``(N,)``."""
    made = excitation.multisine(time, 1.0, lines)
    return np.asarray(made / max(float(np.abs(made).max()), 1e-12))


@dataclass(frozen=True, eq=False)
class TorqueNoise:
    """Noise of the filtered torque."""

    model: Autoregressive  # White or autoregressive
    scales: Array  # (Q,) its size, N m or N, then partial autocorrelations

    def whitened(self, rows: Array, observation: Observation) -> Array:
        """Turn changes of the torque ``(..., M)`` into ones with independent unit noise."""
        return self.model.standard(rows, follows(observation), self.scales)[0]


def torque_noise(target: Target, parameters: Array, number: int) -> TorqueNoise:
    """Give the noise of a recording's filtered torque, whatever the likelihood is of.

    Shapes: parameters (d,).
    """
    scales = target.noise.scales(parameters[None, len(target.free) :])[0, number]
    likelihood = target.likelihood
    if isinstance(likelihood, TorqueLikelihood):
        return TorqueNoise(likelihood.noise, scales)
    # the noise of a sample, then filtered
    taps = likelihood.observations[number].filter.taps
    return TorqueNoise(Autoregressive(), scales[:1] * float(np.linalg.norm(taps)))


def scaled_jacobian(
    target: Target, observation: Observation, values: Array, at: LocalUnits, noise: TorqueNoise
) -> Array:
    """Differentiate a recording's filtered torque over its noise.

    Shapes: values (n_parameters,); returns (n_outputs, d).
    """
    jacobian = torque_changes(target.likelihood.chain, [observation], values, at) * at.units
    return noise.whitened(jacobian.T, observation).T


def longest_stretch(observation: Observation, most: float | None = _LONGEST) -> slice:
    """Find the longest stretch without a gap that outputs come from."""
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
    chain: Joint,
    values: Array,
    observation: Observation,
    torque: Array,
    inputs: Inputs,
    state: tuple[float, float] | None = None,
) -> Observation:
    """Play a torque to the joint, and look at it as one looks at a recording.

    Shapes: torque (N,).
    """
    if state is None:
        first = longest_stretch(observation).start
        state = float(observation.q[first]), float(observation.qd[first])
    period, size = sample_period(observation), torque.size
    inputs = replace(inputs, recording=observation.inputs.recording)
    q0, qd0 = state
    motion = simulate(chain, values, torque, period, q0=q0, qd0=qd0, inputs=inputs, substeps=4)
    told, whole = observation.settings, ((0, torque.size),)
    q, qd, qdd = motion.q, motion.qd, motion.qdd
    cutoff, order = float(told.get("lowpass", 0.0)), int(told.get("order", 0))
    # filtered and differentiated like the recording, so that it blurs as much
    if cutoff and order and told.get("motion") != "refined":
        reach = int(told.get("reach", 1))
        q = lowpass(q, whole, 1.0 / period, cutoff, order)
        qd = derivative(q, whole, period, reach)
        qdd = derivative(qd, whole, period, reach)
    slow = 0.01 * float(np.quantile(np.abs(observation.qd), 0.99))
    trim = int(told.get("trim_samples", 0))
    step = max(round(observation.period / period), 1)
    guard = int(told.get("guard", size))
    moving = moving_samples(qd, whole, float(told.get("dead_zone", slow)), guard)
    kept = (trim, max(size - trim, trim))
    chosen = lay_windows(observation.filter.taps, (kept,), step, moving & (motion.qd != 0.0))
    if chosen.n_outputs < _FEWEST:
        raise ValueError("the joint hardly moves")
    made = replace(
        observation,
        name="simulated",
        q=q,
        qd=qd,
        qdd=qdd,
        smooth=None,
        torque=torque,
        filter=chosen,
        time=motion.time[chosen.centres],
        measured=chosen.apply(as_position(torque, whole, period, told)),
        speed=qd[chosen.centres],
        segment_of=np.zeros(chosen.n_outputs, dtype=np.int64),
        stamps=motion.time,
        inputs=inputs,
    )
    if not chain.delay:
        return made
    return retimed(made, whole, period, float(chain.delays(values[None])[0]))


def _two_digits(x: float) -> float:
    return float(f"{x:.2g}")
