"""The next experiment: how well one quantity would be known after each candidate.

What a recording adds is its Fisher information, so the sd that a candidate would leave is predicted
from prior, present recordings and candidate without sampling anything: a local Bayesian design
[1]_, at the estimate.

References
----------
.. [1] K. Chaloner, I. Verdinelli, "Bayesian experimental design: a review", Statistical Science 10
   (1995) 273-304.

Simulated recordings pass the filters of a measured one, and have its noise.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from bayesfric.base.atomic_write import jsonable
from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.templates import percent
from bayesfric.estimates.assemble import open_directions
from bayesfric.estimates.autoregression import follows
from bayesfric.estimates.information import directions
from bayesfric.identifiability.advice_options import AdviceOptions
from bayesfric.identifiability.friction_curve import back_driving
from bayesfric.identifiability.local import (
    LocalInformation,
    derived_gradients,
    fixed_in,
    joined,
    prior_rows,
    torque_changes,
)
from bayesfric.inference.likelihood import TorqueLikelihood
from bayesfric.inference.noise import Autoregressive
from bayesfric.inference.target import LocalUnits, Target
from bayesfric.mechanism import experiment
from bayesfric.mechanism.forward import RunsAway, simulate
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import TURN
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.checks import moving_samples
from bayesfric.recordings.filters import derivative, lay_windows, lowpass
from bayesfric.recordings.measurement import AT_ROOM, Inputs, steady
from bayesfric.recordings.signals import Signals, as_position, retimed

if TYPE_CHECKING:
    import pandas as pd

CandidateKind = Literal["excitation", "known mass", "longer"]

ASSUMPTION = (
    "All sds here hold only if the model is right. Where it misses something, the ± of "
    "'bayesfric fit' is larger: see first what 'bayesfric explain' would add."
)
# Longest default recording, s and samples.
_LONGEST, _LONGEST_SAMPLES = 30.0, 60_000
# Time constant of a current loop, as in the paper's bench, s; and the largest mass to propose, kg.
LAG, HEAVIEST = 0.005, 5.0
# Sines that are most informative, and slower ones, as multiples of the joint's pace.
LINES: Array = np.array([0.37, 0.73, 1.3, 2.9, 5.3])
_LINES = {"slow multisine": np.array([0.13, 0.29, 0.53, 0.97, 1.9]), "multisine": LINES}

# Whitens changes of the torque (..., M) of a recording to unit noise.
Whitening = Callable[[Array, Signals], Array]


@dataclass(frozen=True)
class Limits:
    """Limits of the next recording."""

    torque: float  # largest command, N m or N
    speed: float  # of the joint, rad/s or m/s
    angles: tuple[float, float] | None  # lowest and highest position, rad or m; None for no limit
    duration: float  # s
    lag: float  # time constant of the current loop, s
    masses: tuple[Inputs, ...]  # known masses to bolt on, no mass among them
    start: float  # initial position: the equilibrium, else that of the longest recording, rad or m
    recorded_angles: tuple[float, float]  # lowest and highest of the recordings, rad or m
    held: bool = False  # whether a controller held the joint: only its motion can be repeated


@dataclass(frozen=True)
class Uncertainty:
    """How well the quantity is known."""

    sd: float = np.nan  # from recordings and prior, in the quantity's unit
    relative_sd: float | None = None  # as a share of the value, if recordings determine that
    data_sd: float = np.nan  # from the recordings alone; infinite where they leave it open


@dataclass(frozen=True, eq=False)
class Candidate:
    """A command for the motor and the mass on the load; and once it is simulated, its effect."""

    kind: CandidateKind
    form: str  # name of the signal, without the amplitude
    amplitude: float  # largest command, N m or N
    command: Array  # (N,) N m or N
    period: float  # of its samples, s
    lag: float  # time constant of the current loop, s
    inputs: Inputs  # mass and temperature
    q0: float  # position and speed at the first sample, rad or m and s
    qd0: float
    # the recording where it needs no simulation: the longest again, or its motion with another mass
    made: Signals | None = None
    lowered: float = 1.0  # factor on the torque that keeps the limits
    because_of: str | None = None  # the limit that required it
    after: Uncertainty = Uncertainty()  # with this recording
    # share of moving outputs in which the load drives each element
    load_drives: dict[str, float] = field(default_factory=dict)
    peak_speed: float = np.nan  # rad/s or m/s
    angles: tuple[float, float] = (np.nan, np.nan)  # lowest and highest position, rad or m

    @property
    def duration(self) -> float:
        """Duration, s."""
        return self.period * self.command.size

    @property
    def rows(self) -> Array:
        """Time (s) and command (N m or N), ``(N, 2)``."""
        return np.stack([self.period * np.arange(self.command.size), self.command], axis=1)


def limits_of(
    options: AdviceOptions, chain: Joint, observations: Sequence[Signals], values: Array
) -> Limits:
    """Complete the configured limits from the recordings."""
    rotary = chain.load.motion == "rotary"
    positions = np.concatenate([o.q for o in observations])
    recorded = float(positions.min()), float(positions.max())
    carried = [replace(o.inputs, recording="") for o in observations if o.inputs.added_mass]
    on_hand = [Inputs(m.mass, m.radius) for m in options.masses or ()]
    for number, mass in enumerate(on_hand, start=1):
        if rotary and not mass.radius:
            where = f"advice.masses.{number}.radius"
            raise BadInput(where, "is missing", 'add radius, such as "0.35 m"')
    if options.masses is None and not carried:
        # propose a mass only where none was recorded, and not one too heavy to bolt on
        guess = known_mass(chain, values)
        on_hand = [guess] if guess.added_mass < HEAVIEST else []
    base = longest(observations)
    period, stretch = sample_period(base), longest_stretch(base, None)
    longest_duration = min((stretch.stop - stretch.start) * period, _LONGEST)
    recorded_start = float(base.q[stretch.start])
    start = _equilibrium(chain, values, recorded_start)
    # a joint that never reached its equilibrium was held by a controller
    held = not recorded[0] <= start <= recorded[1]
    held = held or any("feedback" in o.settings for o in observations)
    # a joint that made a whole turn has no stops; others may have them beyond the recorded range
    revolved = rotary and recorded[1] - recorded[0] >= TURN
    angles = options.angle_limits or (recorded if held or not revolved else None)
    low, high = angles or (-np.inf, np.inf)
    start = start if low <= start <= high else recorded_start
    if not low <= start <= high:
        problem = f"[{low:g}, {high:g}] leaves out {start:.3g} {'rad' if rotary else 'm'}, where "
        problem += f"the joint was when recording {base.name!r} began"
        hint = "give limits in the recordings' own angle"
        raise BadInput("advice.angle_limits", problem, hint)
    masses = dict.fromkeys([Inputs(), *on_hand, *carried])
    return Limits(
        options.torque_limit or max(float(np.abs(o.measured).max()) for o in observations),
        options.speed_limit or 1.2 * max(fastest(o) for o in observations),
        angles,
        options.duration or min(longest_duration, _LONGEST_SAMPLES * period),
        options.lag,
        tuple(in_place_of(base, mass) for mass in masses),
        start,
        recorded,
        held,
    )


def in_place_of(base: Signals, mass: Inputs) -> Inputs:
    """Complete a mass by a recording's mean temperature, for a torque without a delay."""
    signal = base.inputs.temperature
    temperature = None if signal is None else steady(float(np.mean(signal.values)))
    return replace(mass, temperature=temperature, torque_rate=steady(0.0))


def longest(observations: Sequence[Signals]) -> Signals:
    """Find the recording with most outputs, whose rate, filter and noise candidates have."""
    return max(observations, key=lambda o: o.filter.n_outputs)


def fastest(recording: Signals) -> float:
    """Find the highest speed in the used samples of a recording, rad/s or m/s."""
    filter_ = recording.filter
    used = np.zeros(recording.qd.size, dtype=np.bool_)
    for first in filter_.starts.tolist():
        used[first : first + len(filter_.taps)] = True
    return float(np.abs(recording.qd[used]).max())


def candidates(
    chain: Joint, values: Array, observations: Sequence[Signals], limits: Limits
) -> Iterator[Candidate]:
    """List the candidates; for a joint that was held, its recorded motion alone.

    First the recorded motion and torque again, as they were and with other known masses. Then
    square waves, sines, chirps and multisines about the pace at which the joint oscillated.
    """
    base = longest(observations)
    period, hertz, stretch = sample_period(base), base.pace, longest_stretch(base, None)
    peak = float(np.abs(base.measured).max())
    # clip noise of the measurement
    command = np.clip(base.torque[stretch], -peak, peak)
    command[-1] = 0.0
    state = float(base.q[stretch.start]), float(base.qd[stretch.start])
    present = replace(base.inputs, recording="")
    # measured torque has passed the current loop
    signal = peak, command, period, 0.0
    again = f"another recording just like {base.name!r}"
    yield Candidate("longer", again, *signal, present, *state, base)
    for bolted in limits.masses:
        if (bolted.added_mass, bolted.radius) == (present.added_mass, present.radius):
            continue
        # the motion of the recording with another known mass
        warm = replace(bolted, temperature=base.inputs.temperature)
        torque = inverse_torque(
            chain, values, base.q, base.qd, base.qdd, inputs=warm, time=base.stamps
        )
        measured = base.filter.apply(torque)
        carrying = replace(base, torque=torque, measured=measured, inputs=warm)
        moved = float(np.abs(measured).max()), torque[stretch], period, 0.0
        form = f"the motion of {base.name!r} again"
        yield Candidate("known mass", form, *moved, bolted, *state, carrying)
        if not limits.held and peak <= limits.torque:
            form = f"the torque of {base.name!r} again"
            yield Candidate("known mass", form, *signal, bolted, *state)
    if limits.held:
        return
    time = period * np.arange(max(round(limits.duration / period), 1), dtype=np.float64)
    loaded = any(o.inputs.added_mass for o in observations)
    for bolted in limits.masses:
        kind: CandidateKind = "known mass" if bolted.added_mass or loaded else "excitation"
        for form, shape in _shapes(time, hertz):
            shape[-1] = 0.0  # end without a torque
            signal = limits.torque, limits.torque * shape, period, limits.lag
            yield Candidate(kind, form, *signal, bolted, limits.start, 0.0)


def _shapes(time: Array, hertz: float) -> Iterator[tuple[str, Array]]:
    """Make signals of peak one."""
    for pace in (0.5, 1.0, 2.0):
        f = pace * hertz
        yield f"square wave at {f:.3g} Hz", experiment.square(time, 1.0, f)
        yield f"sine at {f:.3g} Hz", experiment.sine(time, 1.0, f)
    for first, last in ((0.25 * hertz, 2.0 * hertz), (0.5 * hertz, 5.0 * hertz)):
        form = f"chirp from {first:.3g} to {last:.3g} Hz"
        yield form, experiment.chirp(time, 1.0, first, last)
    for name, multiples in _LINES.items():
        lines = hertz * multiples
        span = f"of {lines.size} sines from {lines[0]:.2g} to {lines[-1]:.2g} Hz"
        yield f"{name} {span}", sines(time, lines)
        for f in (0.5 * hertz, hertz):
            form = f"square wave at {f:.3g} Hz with a {name} {span}"
            yield form, square_with_sines(time, f, lines)


def try_out(
    chain: Joint, values: Array, base: Signals, candidate: Candidate, limits: Limits
) -> tuple[Candidate, Signals] | str:
    """Simulate a candidate with its torque lowered until it keeps the limits, or say why not."""
    if candidate.made is not None:  # repeated as it was
        if candidate.amplitude > limits.torque:
            return "the torque limit"
        violated = _violated(candidate.made, fastest(candidate.made), limits)
        return violated or (candidate, candidate.made)
    violated = None
    for lowered in (0.85 ** np.arange(12)).tolist():
        amplitude, command = candidate.amplitude * lowered, candidate.command * lowered
        torque = experiment.current_loop(command, candidate.period, candidate.lag)
        initial = candidate.q0, candidate.qd0
        tried = replace(candidate, amplitude=amplitude, command=command, lowered=lowered)
        tried = replace(tried, because_of=violated)
        try:
            recording = simulate_recording(chain, values, base, torque, tried.inputs, initial)
            violated = _violated(recording, float(np.abs(recording.qd).max()), limits)
        except RunsAway:
            violated = "the joint runs away"
        except ValueError as error:
            return str(error)
        if not violated:
            return tried, recording
    return f"{violated}, even with {100.0 * lowered:.0f} % of the torque"


def _violated(recording: Signals, speed: float, limits: Limits) -> str | None:
    if speed > limits.speed:
        return "the speed limit"
    low, high = limits.angles or (-np.inf, np.inf)
    inside = low <= float(recording.q.min()) and float(recording.q.max()) <= high
    return None if inside else "the limits of position"


def _equilibrium(chain: Joint, values: Array, near: float) -> float:
    """Position at which the load hangs, rad; ``near`` without gravity."""
    load = of_load(chain, values)
    if "first_moment" not in load:
        return near
    angle = load.get("gravity_angle", 0.0) + (np.pi if chain.load.gravity < 0.0 else 0.0)
    return float(-angle + TURN * np.round((near + angle) / TURN))


@dataclass(frozen=True, eq=False)
class Ranking:
    """Candidates by the sd that they would leave of one quantity, the best first."""

    quantity: str
    unit: str
    meaning: str
    value: float  # at the estimate; arbitrary where now.data_sd is infinite
    now: Uncertainty
    candidates: tuple[Candidate, ...]
    dropped: tuple[tuple[Candidate, str], ...]  # candidates that cannot be played, and why
    limits: Limits

    @property
    def determined(self) -> bool:
        """Whether present recordings and a candidate would determine it without the prior."""
        return any(np.isfinite(row.after.data_sd) for row in self.candidates)

    @property
    def worth(self) -> bool:
        """Whether the best candidate leaves less than 95 % of the sd that is left now."""
        best = self.candidates[0].after if self.candidates else self.now
        return bool(np.isfinite(best.sd)) and best.sd < 0.95 * self.now.sd

    @property
    def verdict(self) -> str:
        """Whether a candidate is worth the effort, in a sentence."""
        if not self.candidates:
            return "None of the candidates can be played within the limits."
        if not self.determined:
            mass = "; a known mass (masses in [advice]) may" * (len(self.limits.masses) < 2)
            problem = f"None of the candidates determines {self.quantity}"
            return f"{problem}: with any of them, it depends on the priors{mass}."
        share = self.candidates[0].after.sd / self.now.sd
        if not self.worth:
            left = f"the best leaves {100.0 * share:.0f} % of the sd there is"
            return f"None of the candidates is worth the effort: {left}."
        if not np.isfinite(self.candidates[0].after.data_sd):
            return "The best leaves it to the priors where they are narrower than the data are."
        if not np.isfinite(self.now.data_sd):
            open_ = "The recordings there are leave it open"
            return f"{open_}; the best of the next would determine it."
        return f"The best of the next would leave {percent(share)} % of that sd."

    @property
    def left_out(self) -> Counter[str]:
        """Count the reasons why candidates cannot be played."""
        return Counter(why for _, why in self.dropped)

    def as_json(self) -> dict[str, Any]:
        """Give what ``identify --advise --json`` prints; what is infinite is ``None``."""
        names = "after", "load_drives", "peak_speed", "angles", "because_of"
        rows = [
            _described(row)
            | {"rank": rank, "torque_lowered_to": row.lowered}
            | {name: getattr(row, name) for name in names}
            for rank, row in enumerate(self.candidates, start=1)
        ]
        masses = [(m.added_mass, m.radius) for m in self.limits.masses if m.added_mass]
        fields = {name: getattr(self, name) for name in ("quantity", "unit", "meaning", "value")}
        fields |= {
            "determined": bool(np.isfinite(self.now.data_sd)),
            "now": self.now,
            "limits": {**vars(self.limits), "masses": masses},
            "assumption": ASSUMPTION,
            "verdict": self.verdict,
            "candidates": rows,
            "dropped": [_described(tried) | {"reason": why} for tried, why in self.dropped],
        }
        return dict(jsonable(fields))

    @property
    def frame(self) -> pd.DataFrame:
        """One row a candidate, the best first, as :meth:`as_json` has them."""
        import pandas as pd

        return pd.json_normalize(self.as_json()["candidates"]).set_index("rank")

    def __repr__(self) -> str:
        return self.frame.to_string(float_format="{:.4g}".format)


def _described(candidate: Candidate) -> dict[str, Any]:
    return {
        "kind": candidate.kind,
        "form": candidate.form,
        "peak_torque": candidate.amplitude,
        "duration": candidate.duration,
        "added_mass": candidate.inputs.added_mass,
        "radius": candidate.inputs.radius,
        "start": candidate.q0,
    }


def ranking(
    target: Target,
    point: Array,
    local: LocalInformation,
    options: AdviceOptions,
    name: str,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> Ranking:
    """Rank candidates for the next recording by the sd they would leave of one quantity.

    With the output error, a candidate still adds the information of its torque, at the noise of a
    torque sample.

    With J the Jacobians over the noise, of present recordings (0) and candidate (1), P the priors'
    variances and g the gradient, ``sd² = g' (J0'J0 + J1'J1 + P^-1)^-1 g``, c-optimality's.
    """
    chain, observations = target.likelihood.chain, target.likelihood.observations
    unit, meaning, value, gradient = _quantity(target, point, local, name)
    at_estimate = target.chain_values(point[None])[0]
    limits = limits_of(options, chain, observations, at_estimate)
    values = _simulable(target, point, local)
    base, priors = longest(observations), prior_rows(target, local)
    noise = torque_noise(target, point, next(i for i, o in enumerate(observations) if o is base))

    def uncertainty_with(*added: Signals) -> Uncertainty:
        rows = [scaled_jacobian(target, o, values, local, noise) for o in added]
        jacobian, scalings = np.concatenate([local.directions.identified, *rows]), None
        if added:
            # project out what all recordings together leave open: rounding makes no finite sd
            fixed, recordings = fixed_in(target, values), [*observations, *added]
            scalings = open_directions(chain, fixed, recordings, values) / local.units
        if not np.isfinite(jacobian).all():
            return Uncertainty(float("inf"), None, float("inf"))
        unit_steps, tolerance = np.ones(jacobian.shape[1]), local.directions.tolerance
        informed = directions(jacobian, unit_steps, tolerance, known_null=scalings)
        sd = joined(informed.identified, priors).sd(gradient)
        data_sd = informed.sd(gradient)
        # a share of an undetermined value has no meaning
        share = sd / abs(value) if np.isfinite(data_sd) and value != 0.0 else None
        return Uncertainty(sd, share, data_sd)

    ranked, dropped = [], []
    for candidate in candidates(chain, at_estimate, observations, limits):
        progress(f"simulating {candidate.form}")
        result = try_out(chain, values, base, candidate, limits)
        if isinstance(result, str):
            dropped.append((candidate, result))
            continue
        played, o = result
        effect: dict[str, Any] = {
            "after": uncertainty_with(o),
            "load_drives": back_driving(chain, [o], values),
            "peak_speed": fastest(o) if played.made else float(np.abs(o.qd).max()),
            "angles": (float(o.q.min()), float(o.q.max())),
        }
        ranked.append(replace(played, **effect))
    ranked.sort(key=lambda row: (row.after.sd, row.after.data_sd))
    return Ranking(
        name, unit, meaning, value, uncertainty_with(), tuple(ranked), tuple(dropped), limits
    )


def _quantity(
    target: Target, point: Array, local: LocalInformation, name: str
) -> tuple[str, str, float, Array]:
    """Give unit, meaning, value and gradient ``(d,)``, in local units, of a quantity."""
    chain, where = target.likelihood.chain, f"--advise {name}"
    parameters = {p.name: p for p in chain.parameters}
    if name in target.free:
        j, p = target.free.index(name), parameters[name]
        return p.unit, p.meaning, float(point[j]), np.eye(local.units.size)[j] * local.units
    derived = {q.name: (q, value, x) for q, value, x in derived_gradients(target, point, local)}
    if name not in derived | parameters:
        hint = nearest(name, [*parameters, *derived])
        raise BadInput(where, "no parameter or derived quantity has that name", hint)
    if name in parameters:
        value = target.chain_values(point[None])[0, chain.names.index(name)]
        hint = f"give priors.{name} a width, or choose another quantity"
        raise BadInput(where, f"is fixed at {value:.6g} by its prior", hint)
    q, value, gradient = derived[name]
    if not np.isfinite(gradient).all() or not gradient.any():
        problem = "is not defined at the estimate, or made of fixed values only"
        raise BadInput(where, problem, "give these priors a width, or choose another quantity")
    return q.unit, q.meaning, value, gradient


def _simulable(target: Target, parameters: Array, local: LocalInformation) -> Array:
    """Give values of the chain ``(n_parameters,)`` that can be simulated.

    A shape of zero, as a Stribeck velocity on its bound, leaves a term undefined at standstill: it
    is moved off zero by less than any sample shows.
    """
    chain, moved = target.likelihood.chain, parameters.copy()
    for k, name in enumerate(target.free):
        row = chain.parameters[chain.names.index(name)].row
        if row.role == "form" and row.lower == 0.0 < row.default:
            moved[k] = max(moved[k], 1e-3 * abs(float(local.units[k])))
    return np.asarray(target.chain_values(moved[None])[0])


# Recordings simulated at the estimate with another mass or torque


def sample_period(observation: Signals) -> float:
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
    target: Target, observation: Signals, values: Array, at: LocalUnits, whiten: Whitening
) -> Array:
    """Differentiate a recording's filtered torque over its noise, ``(n_outputs, d)``."""
    jacobian = torque_changes(target.likelihood.chain, [observation], values, at) * at.units
    return whiten(jacobian.T, observation).T


def longest_stretch(observation: Signals, duration: float | None = 10.0) -> slice:
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
    observation: Signals,
    torque: Array,
    inputs: Inputs,
    initial: tuple[float, float] | None = None,
) -> Signals:
    """Simulate a torque ``(N,)`` and prepare it like a recording; ValueError at standstill."""
    if initial is None:
        first = longest_stretch(observation).start
        initial = float(observation.q[first]), float(observation.qd[first])
    period, (q0, qd0) = sample_period(observation), initial
    motion = simulate(chain, values, torque, period, q0=q0, qd0=qd0, inputs=inputs, substeps=4)
    kinematics = motion.q, motion.qd, motion.qdd
    return prepared(chain, values, observation, kinematics, torque, inputs)


def designed_recording(
    chain: Joint, values: Array, observation: Signals, torque: Array, inputs: Inputs
) -> Signals:
    """Prepare about the motion of a torque ``(N,)``, with the torque that the model needs for it.

    Steps of Euler with tabulated weight, losses and inertia: the exact integration takes longer to
    compile than all else of a fit. ValueError where no inertia resists the torque.
    """
    period, inputs = sample_period(observation), in_place_of(observation, inputs)
    time = period * np.arange(torque.size, dtype=np.float64)
    places = np.linspace(-TURN, TURN, 1001)
    places += float(np.mean(observation.q[longest_stretch(observation)]))
    still, slow, fast = np.zeros(places.size), 1e-3, fastest(observation)

    def torque_at(q: Array, qd: Array, qdd: Array) -> Array:
        return inverse_torque(chain, values, q, qd, qdd, inputs=inputs, time=still)

    # at rest, what neither loses nor accelerates; then losses, and inertia
    forward, backward = (torque_at(places, still + v, still) for v in (slow, -slow))
    weight, constant = 0.5 * (forward + backward), 0.5 * float(np.mean(forward - backward))
    total = float(np.mean(torque_at(places, still + fast, still) - weight))
    viscous = (total - constant) / fast
    inertia = float(
        np.mean(torque_at(places, still, still + 1.0) - torque_at(places, still, still))
    )
    if not inertia > 0.0:
        raise ValueError("no inertia resists the torque")
    q, qd = float(places[places.size // 2]), 0.0
    positions, speeds = np.empty(torque.size), np.empty(torque.size)
    for k, pushed in enumerate(torque.tolist()):
        positions[k], speeds[k] = q, qd
        moved = qd + period * (pushed - float(np.interp(q, places, weight))) / inertia
        loss = period * (constant + viscous * abs(qd)) / inertia
        qd = math.copysign(max(abs(moved) - loss, 0.0), moved)
        q += period * qd
    motion = positions, speeds, np.diff(speeds, append=qd) / period
    torque = inverse_torque(chain, values, *motion, inputs=inputs, time=time)
    return prepared(chain, values, observation, motion, torque, inputs)


def prepared(
    chain: Joint,
    values: Array,
    observation: Signals,
    motion: tuple[Array, Array, Array],
    torque: Array,
    inputs: Inputs,
) -> Signals:
    """Filter a motion and torque ``(N,)`` like a recording; ValueError at standstill."""
    (q, qd, qdd), moves = motion, motion[1] != 0.0
    settings, segments, size = observation.settings, ((0, torque.size),), torque.size
    period, inputs = (
        sample_period(observation),
        replace(inputs, recording=observation.inputs.recording),
    )
    stamps = period * np.arange(size, dtype=np.float64)
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
    windows = lay_windows(observation.filter.taps, (span,), step, moving & moves)
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
        time=stamps[windows.centres],
        measured=windows.apply(as_position(torque, segments, period, settings)),
        speed=qd[windows.centres],
        segment_of=np.zeros(windows.n_outputs, dtype=np.int64),
        stamps=stamps,
        inputs=inputs,
    )
    if not chain.delay:
        return recording
    return retimed(recording, segments, period, float(chain.delays(values[None])[0]))


def _two_digits(x: float) -> float:
    return float(f"{x:.2g}")
