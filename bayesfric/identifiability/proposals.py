"""Recordings that could be made next: what to play to the joint, and what it would do.

Candidates come with the torque lowered until the simulated joint keeps the limits of torque, speed
and position.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.identifiability.advice_options import AdviceOptions
from bayesfric.identifiability.virtual_recording import (
    HEAVIEST,
    LINES,
    known_mass,
    longest_stretch,
    of_load,
    played,
    sample_period,
    sines,
    square_with_sines,
)
from bayesfric.mechanism import excitation
from bayesfric.mechanism.forward import RunsAway
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.parameter import TURN
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.inputs import Inputs, steady
from bayesfric.recordings.observation import Observation

CandidateKind = Literal["excitation", "known mass", "longer"]

# Speed limit over the fastest that was measured, if none is given.
_FASTER = 1.2
# No longer than this, s and samples, unless it is asked for: the joint has told by then.
_LONGEST = 30.0
_LONGEST_SAMPLES = 60_000
# Frequencies, as multiples of how often the joint went to and fro.
_PACES = (0.5, 1.0, 2.0)
_CHIRPS = ((0.25, 2.0), (0.5, 5.0))
_LINES = {"slow multisine": np.array([0.13, 0.29, 0.53, 0.97, 1.9]), "multisine": LINES}
# What breaks a limit is made this much smaller, and at most so often.
_SMALLER = 0.85
_TRIES = 12


@dataclass(frozen=True)
class Limits:
    """Between what the next recording has to stay."""

    torque: float  # Largest command, N m or N
    speed: float  # Of the joint, rad/s or m/s
    angles: tuple[float, float] | None  # Lowest and highest position, rad or m; None for no limit
    duration: float  # s
    lag: float  # Time constant of the current loop, s
    masses: tuple[Inputs, ...]  # Each known mass that may be bolted on; none is one of them
    # Where the joint rests when the recording begins, rad or m: where gravity holds it, else where
    # the longest recording began
    start: float
    recorded_angles: tuple[float, float]  # Lowest and highest of the recordings, rad or m
    # Whether a controller seems to have held the joint: then what can be played is its motion
    held: bool = False


@dataclass(frozen=True, eq=False)
class Candidate:
    """A command for the motor, and what is bolted to the load meanwhile."""

    kind: CandidateKind  # What is new about it, and name of the signal, without the amplitude
    form: str
    amplitude: float  # Largest command, N m or N
    command: Array  # (N,) N m or N
    period: float  # From one sample of it to the next, and time constant of the current loop, s
    lag: float
    inputs: Inputs  # What is bolted on, and how warm it is
    q0: float  # Position and speed at the first sample, rad or m and s
    qd0: float
    # What would be recorded, where that is known without a simulation: the longest recording once
    # more, or its motion with another mass
    made: Observation | None = None
    # Factor on the torque that it took to keep the limits, and which limit that was
    lowered: float = 1.0
    because_of: str | None = None

    @property
    def duration(self) -> float:
        """How long it takes, s."""
        return self.period * self.command.size

    @property
    def rows(self) -> Array:
        """Time (s) and command (N m or N), ``(N, 2)``."""
        return np.stack([self.period * np.arange(self.command.size), self.command], axis=1)


def limits_of(
    options: AdviceOptions, chain: Joint, observations: Sequence[Observation], values: Array
) -> Limits:
    """Settle every limit that the configuration leaves out."""
    rotary = chain.load.motion == "rotary"
    recorded = (
        min(float(o.q.min()) for o in observations),
        max(float(o.q.max()) for o in observations),
    )
    carried = [replace(o.inputs, recording="") for o in observations if o.inputs.added_mass]
    on_hand = [Inputs(m.mass, m.radius) for m in options.masses or ()]
    for number, one in enumerate(on_hand, start=1):
        if rotary and not one.radius:
            where = f"advice.masses.{number}.radius"
            raise BadInput(where, "is missing", 'add radius, such as "0.35 m"')
    if options.masses is None and not carried:
        # what was bolted on once is on hand; a guess is for those who never did, and where it would
        # be too light to tell beside the load, or too heavy to bolt on, there is none
        guess = known_mass(chain, values)
        on_hand = [guess] if guess.added_mass < HEAVIEST else []
    base = longest(observations)
    # as warm as when it was recorded
    warmth = base.inputs.temperature
    warm = None if warmth is None else steady(float(np.mean(warmth.values)))
    period = sample_period(base)
    stretch = longest_stretch(base, None)
    whole = (stretch.stop - stretch.start) * period
    duration = options.duration or min(whole, _LONGEST, _LONGEST_SAMPLES * period)
    first = float(base.q[stretch.start])
    start = _hanging(chain, values, first)
    # a joint that never was where gravity would hold it was held by something else
    held = not recorded[0] <= start <= recorded[1]
    held = held or any("feedback" in o.settings for o in observations)
    # a joint that has gone round has no stops; any other may have them where nothing was recorded
    round_ = rotary and recorded[1] - recorded[0] >= TURN
    angles = options.angle_limits or (recorded if held or not round_ else None)
    low, high = angles or (-np.inf, np.inf)
    if not low <= start <= high:
        start = first
    if not low <= start <= high:
        unit = "rad" if rotary else "m"
        raise BadInput(
            "advice.angle_limits",
            f"[{low:g}, {high:g}] leaves out {first:.3g} {unit}, where the joint was when "
            f"recording {base.name!r} began",
            "give limits in the recordings' own angle",
        )
    return Limits(
        options.torque_limit or max(float(np.abs(o.measured).max()) for o in observations),
        options.speed_limit or _FASTER * max(fastest(o) for o in observations),
        angles,
        duration,
        options.lag,
        tuple(
            replace(one, temperature=warm) for one in dict.fromkeys([Inputs(), *on_hand, *carried])
        ),
        start,
        recorded,
        held,
    )


def longest(observations: Sequence[Observation]) -> Observation:
    """Find the recording with most outputs, which sets rate, filter and noise."""
    return max(observations, key=lambda o: o.filter.n_outputs)


def fastest(recording: Observation) -> float:
    """Find the highest speed of what is used of a recording, rad/s or m/s.

    What is not may be no motion of the joint's own, such as where a hand pushed.
    """
    taken = recording.filter
    used = np.zeros(recording.qd.size, dtype=np.bool_)
    for first in taken.starts.tolist():
        used[first : first + len(taken.taps)] = True
    return float(np.abs(recording.qd[used]).max())


def candidates(
    chain: Joint, values: Array, observations: Sequence[Observation], limits: Limits
) -> Iterator[Candidate]:
    """List everything that is worth trying; of a joint that was held, its recorded motion alone.

    The cheapest come first: what was recorded again, as it was, and with another known mass. Then
    square waves, sines, chirps and multisines, about the pace at which the joint went to and fro.
    """
    base = longest(observations)
    period, hertz, stretch = sample_period(base), base.pace, longest_stretch(base, None)
    peak = float(np.abs(base.measured).max())
    # noise of the measurement is no part of the torque there was
    again = np.clip(base.torque[stretch], -peak, peak)
    again[-1] = 0.0
    state = float(base.q[stretch.start]), float(base.qd[stretch.start])
    had = replace(base.inputs, recording="")
    # measured torque is behind the current loop already
    signal = peak, again, period, 0.0
    form = f"another recording just like {base.name!r}"
    yield Candidate("longer", form, *signal, had, *state, base)
    for bolted in limits.masses:
        if (bolted.added_mass, bolted.radius) == (had.added_mass, had.radius):
            continue
        # what costs least: the same program once more, with something bolted on or taken off
        made = _carrying(chain, values, base, bolted)
        asked = float(np.abs(made.measured).max()), made.torque[stretch], period, 0.0
        form = f"the motion of {base.name!r} again"
        yield Candidate("known mass", form, *asked, bolted, *state, made)
        if not limits.held and peak <= limits.torque:
            form = f"the torque of {base.name!r} again"
            yield Candidate("known mass", form, *signal, bolted, *state)
    if limits.held:
        return
    time = period * np.arange(max(round(limits.duration / period), 1), dtype=np.float64)
    bare = not any(o.inputs.added_mass for o in observations)
    for bolted in limits.masses:
        kind: CandidateKind = "known mass" if bolted.added_mass or not bare else "excitation"
        for form, shape in _shapes(time, hertz):
            # the drive is not left with a torque when the command ends
            shape[-1] = 0.0
            signal = limits.torque, limits.torque * shape, period, limits.lag
            yield Candidate(kind, form, *signal, bolted, limits.start, 0.0)


def _carrying(chain: Joint, values: Array, base: Observation, bolted: Inputs) -> Observation:
    """Repeat the motion of a recording, as its controller can, with a known mass bolted on."""
    warm = replace(bolted, temperature=base.inputs.temperature)
    torque = inverse_torque(chain, values, base.q, base.qd, base.qdd, inputs=warm, time=base.stamps)
    return replace(base, torque=torque, measured=base.filter.apply(torque), inputs=warm)


def _shapes(time: Array, hertz: float) -> Iterator[tuple[str, Array]]:
    """Make signals of peak one."""
    for pace_ in _PACES:
        f = pace_ * hertz
        yield f"square wave at {f:.3g} Hz", excitation.square(time, 1.0, f)
        yield f"sine at {f:.3g} Hz", excitation.sine(time, 1.0, f)
    for low, high in _CHIRPS:
        first, last = low * hertz, high * hertz
        form = f"chirp from {first:.3g} to {last:.3g} Hz"
        yield form, excitation.chirp(time, 1.0, first, last)
    for name, multiples in _LINES.items():
        lines = hertz * multiples
        span = f"of {lines.size} sines from {lines[0]:.2g} to {lines[-1]:.2g} Hz"
        yield f"{name} {span}", sines(time, lines)
        for pace_ in _PACES[:2]:
            f = pace_ * hertz
            form = f"square wave at {f:.3g} Hz with a {name} {span}"
            yield form, square_with_sines(time, f, lines)


def try_out(
    chain: Joint, values: Array, base: Observation, candidate: Candidate, limits: Limits
) -> tuple[Candidate, Observation] | str:
    """Play a candidate, lowering its torque until it keeps the limits."""
    if candidate.made is not None:  # as it was made it would be made again, or not at all
        if candidate.amplitude > limits.torque:
            return "the torque limit"
        broken = _broken(candidate.made, fastest(candidate.made), limits)
        return broken or (candidate, candidate.made)
    limit = None
    for factor in (_SMALLER ** np.arange(_TRIES)).tolist():
        trial = replace(
            candidate,
            amplitude=candidate.amplitude * factor,
            command=candidate.command * factor,
            lowered=factor,
            because_of=limit,
        )
        torque = excitation.current_loop(trial.command, trial.period, trial.lag)
        try:
            found = played(chain, values, base, torque, trial.inputs, (trial.q0, trial.qd0))
            limit = _broken(found, float(np.abs(found.qd).max()), limits)
        except RunsAway:
            limit = "the joint runs away"
        except ValueError as error:
            return str(error)
        if not limit:
            return trial, found
    return f"{limit}, even with {100.0 * factor:.0f} % of the torque"


def _broken(recording: Observation, speed: float, limits: Limits) -> str | None:
    if speed > limits.speed:
        return "the speed limit"
    low, high = limits.angles or (-np.inf, np.inf)
    inside = low <= float(recording.q.min()) and float(recording.q.max()) <= high
    return None if inside else "the limits of position"


def _hanging(chain: Joint, values: Array, near: float) -> float:
    """Position at which gravity holds the load, rad; where there is no gravity, ``near``."""
    of = of_load(chain, values)
    if "first_moment" not in of:
        return near
    angle = of.get("gravity_angle", 0.0) + (np.pi if chain.load.gravity < 0.0 else 0.0)
    return float(-angle + TURN * np.round((near + angle) / TURN))
