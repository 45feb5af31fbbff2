"""The next experiment: how well one quantity would be known after each candidate.

What a recording adds is its Fisher information, so the sd that a candidate would leave is predicted
from prior, present recordings and candidate without sampling anything: a local Bayesian design
[1]_, at the estimate.

References
----------
.. [1] K. Chaloner, I. Verdinelli, "Bayesian experimental design: a review", Statistical Science 10
   (1995) 273-304.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from bayesfric.base.atomic_write import jsonable
from bayesfric.base.errors import BadInput, nearest
from bayesfric.base.templates import percent
from bayesfric.estimates.assemble import open_directions
from bayesfric.estimates.information import Directions, directions
from bayesfric.identifiability.advice_options import AdviceOptions
from bayesfric.identifiability.coverage import back_driving_shares
from bayesfric.identifiability.local import (
    LocalInformation,
    derived_gradients,
    fixed_in,
    joined,
    prior_rows,
)
from bayesfric.identifiability.simulated_recording import (
    HEAVIEST,
    LINES,
    TorqueNoise,
    known_mass,
    longest_stretch,
    of_load,
    sample_period,
    scaled_jacobian,
    simulate_recording,
    sines,
    square_with_sines,
    torque_noise,
)
from bayesfric.inference.target import Target
from bayesfric.mechanism import excitation
from bayesfric.mechanism.forward import RunsAway
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.parameter import TURN
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.inputs import Inputs, steady
from bayesfric.recordings.observation import Observation

if TYPE_CHECKING:
    import pandas as pd

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
            found = simulate_recording(
                chain, values, base, torque, trial.inputs, (trial.q0, trial.qd0)
            )
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


# Anything that a candidate leaves of the sd above this share is not worth the effort.
WORTH = 0.95
# What all standard deviations here take for granted.
ASSUMPTION = (
    "All sds here hold only if the model is right. Where it misses something, the ± of "
    "'bayesfric fit' is larger: see first what 'bayesfric explain' would add."
)
# Share of what counts as a change of one that is next to zero, but is not.
_OFF_ZERO = 1e-3


@dataclass(frozen=True)
class Uncertainty:
    """How well the quantity is known."""

    # Of recordings and prior together, in the quantity's unit; infinite where neither confines it
    sd: float
    relative_sd: float | None  # The same as a share of the value, if recordings determine that
    data_sd: float  # Of the recordings alone; infinite where they leave it open


@dataclass(frozen=True, eq=False)
class Advice:
    """One recording that could be made next, and what it would do."""

    candidate: Candidate  # What to play, with the torque that keeps the limits
    after: Uncertainty  # How well the quantity would be known then
    # By element with a load loss, share of the moving outputs in which the load drives it
    load_drives: dict[str, float]
    # Fastest that the joint becomes, rad/s or m/s; lowest and highest position, rad or m
    peak_speed: float
    angles: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Ranking:
    """Candidates by the sd that they would leave of one quantity, the best first."""

    quantity: str  # What is to be known
    unit: str
    meaning: str
    value: float  # At the estimate; it means nothing where now.data_sd is infinite
    now: Uncertainty  # How well it is known at present
    advices: tuple[Advice, ...]  # Candidates that keep the limits, the best first
    dropped: tuple[tuple[Candidate, str], ...]  # Candidates that are no use, and why
    limits: Limits  # What they had to keep

    @property
    def determined(self) -> bool:
        """Whether the recordings, there and to come, would determine it without the prior."""
        return any(np.isfinite(one.after.data_sd) for one in self.advices)

    @property
    def worth(self) -> bool:
        """Whether the best candidate leaves less than 95 % of the sd that is left now."""
        best = self.advices[0].after if self.advices else self.now
        if not np.isfinite(best.sd):
            return False
        return best.sd < WORTH * self.now.sd or not np.isfinite(self.now.sd)

    @property
    def verdict(self) -> str:
        """Whether any candidate is worth making, in a sentence."""
        if not self.advices:
            return "Nothing that was tried can be played within the limits."
        if not self.determined:
            mass = "; a known mass (masses in [advice]) may"
            return (
                f"No recording that was tried determines {self.quantity}: whatever is recorded, it "
                f"rests on the priors{mass * (len(self.limits.masses) < 2)}."
            )
        share = self.advices[0].after.sd / self.now.sd
        if not self.worth:
            return (
                "Nothing that was tried is worth the effort: the best leaves "
                f"{100.0 * share:.0f} % of the sd there is."
            )
        if not np.isfinite(self.advices[0].after.data_sd):
            return "The best leaves it to the priors where they are narrower than the data are."
        if not np.isfinite(self.now.data_sd):
            return (
                "The recordings there are leave it open; the best of the next would determine it."
            )
        return f"The best of the next would leave {percent(share)} % of that sd."

    @property
    def left_out(self) -> Counter[str]:
        """Reasons why candidates are no use, with how many there are of each."""
        return Counter(why for _, why in self.dropped)

    def as_json(self) -> dict[str, Any]:
        """Give what ``identify --advise --json`` prints; what is infinite is ``None``."""
        rows = [
            _described(one.candidate)
            | {"rank": rank, "after": one.after, "load_drives": one.load_drives}
            | {"peak_speed": one.peak_speed, "angles": one.angles}
            | {"torque_lowered_to": one.candidate.lowered, "because_of": one.candidate.because_of}
            for rank, one in enumerate(self.advices, start=1)
        ]
        masses = [(m.added_mass, m.radius) for m in self.limits.masses if m.added_mass]
        found = {name: getattr(self, name) for name in ("quantity", "unit", "meaning", "value")}
        found |= {"determined": bool(np.isfinite(self.now.data_sd)), "now": self.now}
        found |= {"limits": {**vars(self.limits), "masses": masses}}
        found |= {"assumption": ASSUMPTION, "verdict": self.verdict, "candidates": rows}
        found["dropped"] = [_described(one) | {"reason": why} for one, why in self.dropped]
        return dict(jsonable(found))

    @property
    def frame(self) -> pd.DataFrame:
        """One row a candidate, the best first, as :meth:`as_json` has them."""
        import pandas as pd

        return pd.json_normalize(self.as_json()["candidates"]).set_index("rank")

    def __repr__(self) -> str:
        return self.frame.to_string(float_format="{:.4g}".format)


def _described(one: Candidate) -> dict[str, Any]:
    found = {"kind": one.kind, "form": one.form, "peak_torque": one.amplitude}
    found |= {"duration": one.duration, "added_mass": one.inputs.added_mass}
    return found | {"radius": one.inputs.radius, "start": one.q0}


def ranking(
    target: Target,
    point: Array,
    local: LocalInformation,
    options: AdviceOptions,
    name: str,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> Ranking:
    """Rank candidates for the next recording by what they would leave of one quantity.

    With the output error, a candidate still adds the information of its torque, at the noise of a
    torque sample.

    With J the Jacobians over the noise, of present recordings (0) and candidate (1), P the priors'
    variances and g the gradient, ``sd² = g' (J0'J0 + J1'J1 + P^-1)^-1 g``, c-optimality's.

    Shapes: point (d,).
    """
    chain, observations = target.likelihood.chain, target.likelihood.observations
    unit, meaning, value, gradient = _asked(target, point, local, name)
    limits = limits_of(options, chain, observations, target.chain_values(point[None])[0])
    values = _movable(target, point, local)
    base, priors = longest(observations), prior_rows(target, local)
    noise = torque_noise(target, point, next(i for i, o in enumerate(observations) if o is base))

    def known(*added: Observation) -> Uncertainty:
        told = _told(target, values, local, noise, added)
        if told is None:
            return Uncertainty(float("inf"), None, float("inf"))
        sd = joined(told.identified, priors).sd(gradient)
        data_sd = told.sd(gradient)
        # a share of a value that is not determined would mean nothing
        share = sd / abs(value) if np.isfinite(data_sd) and value != 0.0 else None
        return Uncertainty(sd, share, data_sd)

    advices, dropped = [], []
    at_estimate = target.chain_values(point[None])[0]
    for candidate in candidates(chain, at_estimate, observations, limits):
        progress(f"simulating {candidate.form}")
        tried = try_out(chain, values, base, candidate, limits)
        if isinstance(tried, str):
            dropped.append((candidate, tried))
            continue
        made, o = tried
        shares = back_driving_shares(chain, [o], values[None])
        drives = {element: float(share[0]) for element, share in shares.items()}
        peak = fastest(o) if made.made is not None else float(np.abs(o.qd).max())
        ends = float(o.q.min()), float(o.q.max())
        advices.append(Advice(made, known(o), drives, peak, ends))
    advices.sort(key=lambda one: (one.after.sd, one.after.data_sd))
    return Ranking(name, unit, meaning, value, known(), tuple(advices), tuple(dropped), limits)


def _asked(
    target: Target, point: Array, local: LocalInformation, name: str
) -> tuple[str, str, float, Array]:
    """Give unit, meaning, value and gradient of what is asked.

    The gradient ``(d,)`` is by changes of one in the local units. Raises :class:`BadInput` for what
    is no name, is fixed, or is not defined at the estimate.
    """
    chain, where = target.likelihood.chain, f"--advise {name}"
    parameters = {p.name: p for p in chain.parameters}
    if name in target.free:
        j, p = target.free.index(name), parameters[name]
        return p.unit, p.meaning, float(point[j]), np.eye(local.units.size)[j] * local.units
    if name in parameters:
        fixed = target.chain_values(point[None])[0, chain.names.index(name)]
        what = f"is fixed at {fixed:.6g} by its prior"
        raise BadInput(where, what, f"give priors.{name} a width, or ask for another quantity")
    derived = {q.name: (q, value, x) for q, value, x in derived_gradients(target, point, local)}
    if name not in derived:
        known = nearest(name, [*parameters, *derived])
        raise BadInput(where, "no parameter or derived quantity has that name", known)
    q, value, gradient = derived[name]
    if not np.isfinite(gradient).all() or not gradient.any():
        what = "is not defined at the estimate, or made of fixed values only"
        raise BadInput(where, what, "give these priors with a width, or ask for another quantity")
    return q.unit, q.meaning, value, gradient


def _movable(target: Target, parameters: Array, local: LocalInformation) -> Array:
    """Values of the chain ``(n_parameters,)`` that can be simulated, at sampled ones ``(d,)``.

    What shapes others and is zero, as a Stribeck velocity on its bound, gives a term no one value
    at rest: so little more that no sample shows it does.
    """
    chain, moved = target.likelihood.chain, parameters.copy()
    for k, name in enumerate(target.free):
        row = chain.parameters[chain.names.index(name)].row
        if row.role == "form" and row.lower == 0.0 < row.default:
            moved[k] = max(moved[k], _OFF_ZERO * abs(float(local.units[k])))
    return np.asarray(target.chain_values(moved[None])[0])


def _told(
    target: Target,
    values: Array,
    local: LocalInformation,
    noise: TorqueNoise,
    added: Sequence[Observation],
) -> Directions | None:
    """Take what recordings tell, in the local units, with more of them; ``None`` if one cannot be.

    What theory says that no torque tells is taken out first: rounding never makes a finite sd.
    """
    rows, known = local.directions.identified, None
    if added:
        more = [scaled_jacobian(target, o, values, local, noise) for o in added]
        rows = np.concatenate([rows, *more])
        # which scalings are open depends on the masses in all recordings together
        together = [*target.likelihood.observations, *added]
        open_ = open_directions(target.likelihood.chain, fixed_in(target, values), together, values)
        known = open_ / local.units
    if not np.isfinite(rows).all():
        return None
    return directions(rows, np.ones(rows.shape[1]), local.directions.tolerance, known_null=known)
