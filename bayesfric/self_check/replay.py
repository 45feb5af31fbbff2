"""The recording once more, simulated: the same torque, encoder, rate and filters, a known joint.

A joint that is given a recorded torque alone drifts away from the recorded motion: what is
integrated twice forgives nothing, least of all where the torque came out of a closed loop. So
the simulated motor is held by a soft spring and damper to the recorded motion, and what they pull
is part of the torque that the simulated sensor sees. Nothing is lost by it: the torque is known at
every instant, and it is the one that made the motion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesfric.errors import BadInput
from bayesfric.estimates.fine_motion import fine_motion
from bayesfric.identifiability.virtual_recording import pace
from bayesfric.mechanism.forward import simulate_segments
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.own_term import Term
from bayesfric.mechanism.quantities import State
from bayesfric.recordings.filters import later, lowpass
from bayesfric.recordings.measurement import Array, Measurement
from bayesfric.recordings.observation import Observation, observe
from bayesfric.recordings.processing import Processing
from bayesfric.recordings.resolution import finest_step
from bayesfric.recordings.timing import timed

# Steps of the simulation a sample. The torque between samples is a cubic: a straight line would
# be a torque that no filter lets pass, and its bias one that no recording has.
_FINE = 5
# Natural frequency of the spring, as a multiple of how often the joint goes to and fro, and the
# most of it as a share of the band that is compared.
_FOLLOWING, _HIGHEST = 3.0, 0.2
# Two instants at which only the acceleration differs.
_NOW = np.zeros(2)
# Numbers of a motion held at once.
_AT_ONCE = 4_000_000


class NoReplay(Exception):
    """A joint that no torque moves in one way only."""


def _position(motor: State) -> float:
    return float(motor.position)


def _speed(motor: State) -> float:
    return float(motor.speed)


@dataclass(frozen=True)
class Spring:
    """What holds a simulated motor to the recorded motion; critically damped.

    ``stiffness`` and ``damping`` are in measured torque per motor's rad (or m) and rad/s.
    """

    hertz: float
    stiffness: float
    damping: float


def spring_of(chain: Joint, values: Array, observation: Observation) -> Spring:
    """Choose a spring well below the band, and above how often the joint goes to and fro.

    Below the band it leaves alone what the comparison is about; above the pace it keeps the
    simulated motion, and with it reversals and rests, where the recorded one is. ``values``
    ``(n_parameters,)`` say how much inertia the motor feels.

    Raises
    ------
    NoReplay
        If it feels none.
    """
    still = inverse_torque(
        chain, values, [0.0, 0.0], [0.0, 0.0], [0.0, 1.0], inputs=observation.inputs, time=_NOW
    )
    inertia = float(still[1] - still[0]) / chain.ratio
    if not inertia > 0.0:
        raise NoReplay("the joint has no inertia, so a torque does not determine its motion")
    hertz = _FOLLOWING * pace(observation)
    if band := float(observation.settings["band"]):
        hertz = min(hertz, _HIGHEST * band)
    omega = 2.0 * math.pi * hertz
    return Spring(hertz, inertia * omega**2, 2.0 * inertia * omega)


def replays(
    chain: Joint,
    values: Array,
    recording: Measurement,
    observation: Observation,
    processing: Processing,
    seeds: Sequence[np.random.SeedSequence],
) -> Iterator[Observation | None]:
    """Simulate a recording at parameter vectors ``(n, n_parameters)``, and look at each alike.

    Gives what was made of it, with the torque free of noise, or ``None`` where the joint cannot
    be simulated with these parameters or the filters leave nothing. ``seeds`` are of each
    vector's noise in the position.

    Raises
    ------
    NoReplay
        If the joint has no inertia.
    """
    spring = spring_of(chain, np.median(values, axis=0), observation)
    held = _Held(chain, recording, observation, spring)
    alike = settled_as(processing, observation)
    rows = max(1, _AT_ONCE // (_FINE * recording.time.size))
    for first in range(0, len(values), rows):
        part = slice(first, first + rows)
        for one, motion, seed in zip(
            values[part], held.simulated(values[part]), seeds[part], strict=True
        ):
            seen = _seen(recording, observation, motion, np.random.default_rng(seed))
            yield None if seen is None else _observed(chain, one, seen, observation, alike)


def settled_as(processing: Processing, observation: Observation) -> Processing:
    """Write down the filters of a recording, so that its replays are treated alike."""
    told = observation.settings
    numbers = {key: told[key] for key in ("lowpass", "decimate", "dead_zone", "trim")}
    return processing.model_copy(update=numbers)


@dataclass(frozen=True, eq=False)
class _Motion:
    """A simulated motion and the torque that made it, at the samples, ``(N,)`` each."""

    q: Array
    qd: Array
    torque: Array


class _Held:
    """The joint on its spring, and what drives the two."""

    def __init__(
        self, chain: Joint, recording: Measurement, observation: Observation, spring: Spring
    ) -> None:
        self._recording, self._observation, self._spring = recording, observation, spring
        motor = chain.elements[0].name
        # compiled once: the columns are functions of this module
        terms = (
            Term(f"{motor}.replay_stiffness", _position, positive=True),
            Term(f"{motor}.replay_damping", _speed, positive=True),
        )
        self._given, self._ratio = chain, chain.ratio
        # the torque that acts is taken when it does, and recorded earlier by a delay
        self._chain = replace(chain, terms=(*chain.terms, *terms), delay=False)
        told = observation.settings
        torque = lowpass(
            observation.torque,
            recording.segments,
            1.0 / recording.period,
            float(told["lowpass"]),
            int(told["order"]),
        )
        if chain.delay:
            for a, b in recording.segments:
                torque[a:b] = later(torque[a:b], float(told["delay"]) / recording.period)
        self._driver = torque + self._pull(observation.q, observation.qd)

    def _pull(self, q: Array, qd: Array) -> Array:
        """Torque of spring and damper at a motion of the joint."""
        spring = self._spring
        return self._ratio * (spring.stiffness * q + spring.damping * qd)

    def simulated(self, values: Array) -> list[_Motion]:
        """Simulate vectors ``(n, n_parameters)``; NaN where that cannot be."""
        recording, observation = self._recording, self._observation
        vectors = self._with_spring(values)
        q, qd, torque = (np.full((len(values), recording.time.size), np.nan) for _ in range(3))
        for a, b in recording.segments:
            driver = _finely(self._driver[a:b])
            fine_q, fine_qd = simulate_segments(
                self._chain,
                vectors,
                driver,
                recording.period / _FINE,
                [(0, driver.size)],
                [observation.q[a]],
                [observation.qd[a]],
                inputs=observation.inputs,
                begin=float(recording.time[a]),
                substeps=1,
            )
            q[:, a:b], qd[:, a:b] = fine_q[:, ::_FINE], fine_qd[:, ::_FINE]
            torque[:, a:b] = self._driver[a:b] - self._pull(q[:, a:b], qd[:, a:b])
            if self._given.delay:
                delays = self._given.delays(values) / recording.period
                for row, delay in zip(torque[:, a:b], delays.tolist(), strict=True):
                    row[:] = later(row, -delay)
        return [_Motion(*rows) for rows in zip(q, qd, torque, strict=True)]

    def _with_spring(self, values: Array) -> Array:
        """Add spring and damper to vectors of the joint's own parameters."""
        given, spring = self._given, self._spring
        gain = np.ones(len(values))
        for p, column in zip(given.parameters, values.T, strict=True):
            if p.quantity == "gain":  # the driver is in measured torque, the terms are not
                gain = column
        found = dict(zip(given.names, values.T, strict=True))
        motor = given.elements[0].name
        found[f"{motor}.replay_stiffness"] = spring.stiffness * gain
        found[f"{motor}.replay_damping"] = spring.damping * gain
        return np.stack([found[name] for name in self._chain.names], axis=1)


def _finely(x: Array) -> Array:
    """Interpolate samples ``(n,)`` by a cubic spline, ``_FINE`` steps from one to the next."""
    from scipy.interpolate import CubicSpline

    if x.size < 4:
        return np.interp(np.arange((x.size - 1) * _FINE + 1) / _FINE, np.arange(x.size), x)
    spline = CubicSpline(np.arange(x.size), x)
    return np.asarray(spline(np.arange((x.size - 1) * _FINE + 1) / _FINE))


def _seen(
    recording: Measurement, observation: Observation, motion: _Motion, rng: np.random.Generator
) -> Measurement | None:
    """Read a motion with the recording's sensors, without noise of the torque's."""
    if not np.isfinite(motion.q).all():
        return None
    noise = float(observation.settings["noise_seen"])
    moved = recording.velocity is None
    position = _sensed(recording.position, motion.q, noise if moved else 0.0, rng)
    velocity = (
        None if recording.velocity is None else _sensed(recording.velocity, motion.qd, noise, rng)
    )
    # what it is driven by goes smoothly from sample to sample, and no maker has filtered it
    return replace(
        recording,
        position=position,
        velocity=velocity,
        torque=motion.torque,
        held=None,
        torque_lag=None,
        velocity_lag=None,
    )


def _observed(
    chain: Joint,
    values: Array,
    seen: Measurement,
    observation: Observation,
    processing: Processing,
) -> Observation | None:
    """Filter what was read, and refine its motion, as the recording's was."""
    try:
        found = observe(seen, processing)
        late = observation.settings.get("delay")
        found = found if late is None else timed(found, seen, float(late))
    except BadInput:  # with these parameters the joint hardly moves
        return None
    if observation.settings["motion"] != "refined":
        return found
    return fine_motion(chain, values, seen, found)


def _sensed(
    recorded: Array, true: Array, noise: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Read a signal as the recorded one was: in its steps, with what noise it has besides."""
    step = finest_step(recorded)
    besides = math.sqrt(max(noise**2 - step**2 / 12.0, 0.0))
    noisy = true + besides * rng.standard_normal(true.size)
    if not step:
        return noisy
    return np.asarray(recorded[0] + step * np.round((noisy - recorded[0]) / step))
