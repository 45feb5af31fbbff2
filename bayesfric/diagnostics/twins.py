"""Twins: the recording once more, simulated, with its encoder, rate and filters, a known joint.

Twins are what a recording looks like where the model is right: by them estimates are tried, and
what a check finds in a recording is held against what it finds in them. So a twin must differ from
the recording as another one would. Its encoder has the same steps elsewhere, and its samples come
at other instants between them: were all rounded alike, their error would be the same in each.

A joint that is given a recorded torque alone drifts away from the recorded motion: what is
integrated twice forgives nothing, least of all where the torque came out of a closed loop. So
the simulated motor is held by a soft spring and damper to the recorded motion, and what they pull
is part of the torque that the simulated sensor sees. Nothing is lost by it: the torque is known at
every instant, and it is the one that made the motion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.estimates.fine_motion import fine_motion
from bayesfric.mechanism.forward import simulate_segments
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.own_term import Term, written_out
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.filters import later, lowpass
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.observation import Observation, observe
from bayesfric.recordings.processing import Processing
from bayesfric.recordings.resolution import Resolution, finest_step
from bayesfric.recordings.timing import timed

# Steps of the simulation a sample. The torque between samples is a cubic: a straight line would
# be a torque that no filter lets pass, and its bias one that no recording has.
_FINE = 5
# Natural frequency of the spring, as a multiple of how often the joint goes to and fro, and the
# most of it as a share of the band that is compared.
_FOLLOWING, _HIGHEST = 3.0, 0.2
# Two instants at which only the acceleration differs.
_NOW = np.zeros(2)
# Where a modelled torque ends, as a multiple of the band, and at most as a share of the rate.
_ABOVE, _HIGHEST_SHARE = 1.3, 0.4


class NoTwin(Exception):
    """A joint that no torque moves in one way only."""


def _position(position: float, _speed: float, _way: float, _time: float, _shape: float) -> float:
    return position


def _speed(_position: float, speed: float, _way: float, _time: float, _shape: float) -> float:
    return speed


def spring_of(chain: Joint, values: Array, observation: Observation) -> tuple[float, float]:
    """Choose what holds a simulated motor to the recorded motion.

    Below the band it leaves alone what the comparison is about; above the pace it keeps the
    simulated motion, and with it reversals and rests, where the recorded one is.

    Parameters
    ----------
    chain, values
        The joint, and ``(n_parameters,)`` that say how much inertia J the motor feels.
    observation
        Its band, and how often the joint goes to and fro.

    Returns
    -------
    stiffness, damping : float
        In measured torque per motor's rad (or m) and rad/s.

    Raises
    ------
    NoTwin
        If the motor feels no inertia.

    Notes
    -----
    ``J w^2`` and ``2 J w``, critical, with w of three times the pace, and of a fifth of the band at
    most.
    """
    still = inverse_torque(
        chain, values, [0.0, 0.0], [0.0, 0.0], [0.0, 1.0], inputs=observation.inputs, time=_NOW
    )
    inertia = float(still[1] - still[0]) / chain.ratio
    if not inertia > 0.0:
        raise NoTwin("the joint has no inertia, so a torque does not determine its motion")
    hertz = _FOLLOWING * observation.pace
    if band := float(observation.settings["band"]):
        hertz = min(hertz, _HIGHEST * band)
    omega = 2.0 * math.pi * hertz
    return inertia * omega**2, 2.0 * inertia * omega


def twins(
    chain: Joint,
    values: Array,
    recording: Measurement,
    observation: Observation,
    processing: Processing,
    seeds: Sequence[np.random.SeedSequence],
    driver: Array | None = None,
) -> Iterator[Observation | None]:
    """Simulate a recording at parameter vectors ``(n, n_parameters)``, and look at each alike.

    Parameters
    ----------
    chain, values
        The joint, and the vectors.
    recording, observation, processing
        What is repeated, as read and as prepared by which filters.
    seeds
        Of each vector's sample phase, encoder grid and noise in the position.
    driver
        ``(N,)`` the torque that acts, N m or N; the recorded one if left out, see
        :func:`modelled_driver`.

    Yields
    ------
    Observation or None
        What was made of it, with the torque free of noise; ``None`` where the joint cannot be
        simulated with these parameters or the filters leave nothing.

    Raises
    ------
    NoTwin
        If the joint has no inertia.
    """
    spring = spring_of(chain, np.median(values, axis=0), observation)
    held = _Held(chain, recording, observation, spring, driver)
    alike = settled_as(processing, observation)
    for one, seed in zip(values, seeds, strict=True):
        rng = np.random.default_rng(seed)
        motion = held.simulated(one, rng.uniform(-0.5, 0.5))
        seen = _seen(recording, observation, motion, rng)
        yield None if seen is None else _observed(chain, one, seen, observation, alike)


def modelled_driver(
    chain: Joint, values: Array, recording: Measurement, observation: Observation
) -> Array:
    """Give the model's torque along the recorded motion, up to above the band.

    It has the encoder's noise where the recorded one has the torque sensor's, which as a driver
    would be true torque.

    Parameters
    ----------
    chain, values
        The joint and its parameters ``(n_parameters,)``.

    Returns
    -------
    ndarray
        ``(N,)`` N m or N, low-passed at 1.3 times the band; without a delay.
    """
    o, told = observation, observation.settings
    now = np.where([name == chain.delay_name for name in chain.names], 0.0, values)
    torque = inverse_torque(chain, now, o.q, o.qd, o.qdd, inputs=o.inputs, time=o.stamps)
    fs = 1.0 / recording.period
    cutoff = min(_ABOVE * float(told["band"] or told["lowpass"]), _HIGHEST_SHARE * fs)
    torque = np.where(np.isfinite(torque), torque, o.compared)
    return lowpass(torque, recording.segments, fs, cutoff, int(told["order"]))


def excerpt(
    chain: Joint,
    values: Array,
    recording: Measurement,
    observation: Observation,
    processing: Processing,
    most: int,
) -> tuple[Measurement, Observation]:
    """Cut a recording to ``most`` samples, prepared as the whole was; the same if it has fewer.

    ``values`` ``(n_parameters,)`` are those that its motion is refined with.

    Raises
    ------
    NoTwin
        If the filters leave nothing of it.
    """
    short = recording.excerpt(most)
    if short is recording:
        return recording, observation
    alike = settled_as(processing, observation)
    seen = _observed(chain, values, short, observation, alike)
    if seen is None:
        raise NoTwin("an excerpt hardly moves")
    return short, seen


def settled_as(processing: Processing, observation: Observation) -> Processing:
    """Write down the filters of a recording, so that its twins are treated alike.

    Low-pass, decimation, dead zone and trim become those that were used, whoever chose them.
    """
    told = observation.settings
    numbers = {key: told[key] for key in ("lowpass", "decimate", "dead_zone", "trim")}
    return processing.model_copy(update=numbers)


class _Held:
    """The joint on its spring, and what drives the two.

    Spring and damper are two more terms of the motor; the driver has what they pull along the
    recorded motion on top, so that they pull nothing where the simulated motion is the recorded
    one.
    """

    def __init__(
        self,
        chain: Joint,
        recording: Measurement,
        observation: Observation,
        spring: tuple[float, float],
        driver: Array | None,
    ) -> None:
        self._recording, self._observation, self._spring = recording, observation, spring
        motor = chain.elements[0].name
        terms = (
            Term(f"{motor}.replay_stiffness", written_out(_position), positive=True),
            Term(f"{motor}.replay_damping", written_out(_speed), positive=True),
        )
        self._given, self._ratio = chain, chain.ratio
        # the torque that acts is taken when it does, and recorded earlier by a delay
        self._chain = replace(chain, terms=(*chain.terms, *terms), delay=False)
        told = observation.settings
        fs = 1.0 / recording.period
        if driver is None:
            cutoff, order = float(told["lowpass"]), int(told["order"])
            driver = lowpass(observation.torque, recording.segments, fs, cutoff, order)
            if chain.delay:
                driver = self._shifted(driver, float(told["delay"]) * fs)
        self._driver = driver + self._pull(observation.q, observation.qd)

    def _shifted(self, x: Array, samples: float) -> Array:
        """Give a signal some samples later."""
        out = x.copy()
        for a, b in self._recording.segments:
            out[a:b] = later(x[a:b], samples)
        return out

    def _pull(self, q: Array, qd: Array) -> Array:
        """Torque of spring and damper at a motion of the joint."""
        stiffness, damping = self._spring
        return self._ratio * (stiffness * q + damping * qd)

    def simulated(self, values: Array, phase: float) -> tuple[Array, Array, Array]:
        """Simulate a vector ``(n_parameters,)``, ``phase`` samples late.

        Gives position, speed and the torque that makes them at the samples, ``(N,)`` each; NaN if
        that cannot be.
        """
        recording, observation = self._recording, self._observation
        vectors = self._with_spring(values[None])
        driver = self._shifted(self._driver, phase)
        q, qd, torque = (np.full(recording.time.size, np.nan) for _ in range(3))
        for a, b in recording.segments:
            finely = _finely(driver[a:b])
            fine_q, fine_qd = simulate_segments(
                self._chain,
                vectors,
                finely,
                recording.period / _FINE,
                [(0, finely.size)],
                [observation.q[a]],
                [observation.qd[a]],
                inputs=observation.inputs,
                begin=float(recording.time[a]),
                substeps=1,
            )
            q[a:b], qd[a:b] = fine_q[0, ::_FINE], fine_qd[0, ::_FINE]
            torque[a:b] = driver[a:b] - self._pull(q[a:b], qd[a:b])
        if self._given.delay:
            late = float(self._given.delays(values[None])[0])
            torque = self._shifted(torque, -late / recording.period)
        return q, qd, torque

    def _with_spring(self, values: Array) -> Array:
        """Add spring and damper to vectors of the joint's own parameters."""
        given = self._given
        gain = np.ones(len(values))
        for p, column in zip(given.parameters, values.T, strict=True):
            if p.quantity == "gain":  # the driver is in measured torque, the terms are not
                gain = column
        found = dict(zip(given.names, values.T, strict=True))
        motor = given.elements[0].name
        for name, size in zip(("replay_stiffness", "replay_damping"), self._spring, strict=True):
            found[f"{motor}.{name}"] = size * gain
        return np.stack([found[name] for name in self._chain.names], axis=1)


def _finely(x: Array) -> Array:
    """Interpolate samples ``(n,)`` by a cubic spline, ``_FINE`` steps from one to the next."""
    from scipy.interpolate import CubicSpline

    if x.size < 2:
        return x
    spline = CubicSpline(np.arange(x.size), x)
    return np.asarray(spline(np.arange((x.size - 1) * _FINE + 1) / _FINE))


def _seen(
    recording: Measurement,
    observation: Observation,
    motion: tuple[Array, Array, Array],
    rng: np.random.Generator,
) -> Measurement | None:
    """Read a motion with the recording's sensors, without noise of the torque's."""
    q, qd, torque = motion
    if not np.isfinite(q).all():
        return None
    noise = float(observation.settings["noise_seen"])
    moved = recording.velocity is None
    position = _sensed(recording.position, q, noise if moved else 0.0, rng)
    velocity = None if recording.velocity is None else _sensed(recording.velocity, qd, noise, rng)
    # what it is driven by goes smoothly from sample to sample, and no maker has filtered it
    return replace(
        recording,
        position=position,
        velocity=velocity,
        torque=torque,
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
    """Filter what was read, and refine its motion, as the recording's was.

    ``None`` where the filters leave nothing, as of a joint that hardly moves.
    """
    told, looked = observation.settings, None
    if told["motion"] != "refined":  # what the position resolves is not asked then
        looked = Resolution(float(told["band"]), "asked", float(told["noise_seen"]), math.inf)
    try:
        found = observe(seen, processing, looked)
        late = told.get("delay")
        found = found if late is None else timed(found, seen, float(late))
    except BadInput:  # with these parameters the joint hardly moves
        return None
    return found if looked else fine_motion(chain, values, seen, found)


def _sensed(recorded: Array, true: Array, noise: float, rng: np.random.Generator) -> Array:
    """Read a signal as the recorded one was: in its steps, with what noise it has besides.

    The steps lie anywhere.
    """
    step = finest_step(recorded)
    besides = math.sqrt(max(noise**2 - step**2 / 12.0, 0.0))
    noisy = true + besides * rng.standard_normal(true.size)
    if not step:
        return noisy
    grid = recorded[0] + step * rng.uniform()
    return np.asarray(grid + step * np.round((noisy - grid) / step))
