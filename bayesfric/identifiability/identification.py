"""What recordings can and cannot determine, before anything is sampled.

The Jacobian of the observed quantity over its noise, in logarithms of the parameters, is taken at
the estimate. A direction is *null* where its singular value is below 1e-7 of the largest, which is
a thousand times what rounding makes of an exact zero (1e-6 for a simulated position); it is *weak*
where the data leave the logarithm of a parameter more than 0.5.

Among the combinations are the base parameters, the motor-side totals of eq. (11), which the data
may determine even where they leave single parameters open.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from bayesfric.base.atomic_write import jsonable
from bayesfric.base.templates import factor, percent
from bayesfric.estimates.assemble import bounds_met
from bayesfric.identifiability.friction_curve import back_driving, coverage_of
from bayesfric.identifiability.local import (
    WEAK,
    LocalInformation,
    derived_gradients,
    in_natural_units,
    joined,
    local_information,
    meaning_of,
    prior_rows,
    verdict,
)
from bayesfric.identifiability.next_recording import (
    LAG,
    LINES,
    designed_recording,
    in_place_of,
    known_mass,
    longest_stretch,
    prepared,
    sample_period,
    scaled_jacobian,
    square_with_sines,
    torque_noise,
)
from bayesfric.inference.priors import KNOWN
from bayesfric.inference.target import Target
from bayesfric.mechanism import experiment
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.quantities import Parameter
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.signals import Signals
from bayesfric.results.reported import KNOWN_BY, Determined, Status

if TYPE_CHECKING:
    import pandas as pd


RemedyKind = Literal["known value", "known mass", "excitation"]

# Share of moving samples below which the load hardly ever drives an element.
HARDLY = 0.01
# Entries of a weak direction smaller than this share of the largest are not named.
_NAMED = 0.2

# Kind and text of one more recording, simulated at the estimate with the recordings' noise, and the
# information (d, d) that its torque would add, in the local units.
Trial = tuple[RemedyKind, str, Array]


@dataclass(frozen=True)
class OpenDirection:
    """Parameters that can change together with little or no effect on the data."""

    kind: Literal["null", "weak"]
    # by parameter or alpha its power of a common factor; of those in_units the change in their unit
    # for a factor of e
    exponents: dict[str, float]
    in_units: dict[str, str]  # units of parameters next to zero, which have no logarithm
    log_sd: float | None  # sd of the factor's logarithm; None for a null direction
    meaning: str
    reasons: tuple[str, ...]
    # kind, text, parameters (for a known value any single one of these) and log_sd_after: sd of the
    # logarithm along the direction, None for a known value
    remedies: tuple[dict[str, Any], ...]

    @property
    def null(self) -> bool:
        """Whether no output changes along it."""
        return self.kind == "null"


@dataclass(frozen=True)
class Prospect:
    """One parameter or derived quantity and how well it would be known."""

    name: str
    unit: str
    meaning: str
    value: float  # at the estimate; arbitrary where data_sd is infinite
    data_sd: float  # from the data alone, with the noise of a fit
    expected_sd: float  # of data and prior together
    prior_sd: float = float("nan")  # NaN of derived quantities
    status: Status | None = None  # expected of a fit
    # end of its prior that the estimate is on: then only a limit can be reported
    on_bound: str | None = None


@dataclass(frozen=True, eq=False)
class Identification:
    """The identifiability of a model at an estimate."""

    method: str  # of the likelihood
    noise: str  # its model of the noise
    # whether the noise may be autocorrelated: point estimates assume white residuals instead
    memory: bool
    local: LocalInformation
    directions: tuple[OpenDirection, ...]  # null ones, then weak ones, the weakest first
    parameters: tuple[Prospect, ...]  # the free ones, in their order
    combinations: tuple[Prospect, ...]  # derived quantities, best known first
    recordings: list[dict[str, Any]]  # what each covers, see :func:`coverage_of`
    # share of the moving outputs in which the load drives each element
    back_driving: dict[str, float]
    voltage: dict[str, Any] | None  # of :func:`speed_term`

    @property
    def frame(self) -> pd.DataFrame:
        """One row a parameter: how well it would be known, and what it trades off against."""
        import pandas as pd

        table = pd.DataFrame([vars(prospect) for prospect in self.parameters]).set_index("name")
        together = {
            label: [name for d in self.directions if label in d.exponents for name in d.exponents]
            for label in self.local.labels
        }
        table["open_with"] = [
            ", ".join(dict.fromkeys(name for name in names if name != label))
            for label, names in together.items()
        ]
        return table

    def __repr__(self) -> str:
        return self.frame.to_string(float_format="{:.4g}".format)

    @property
    def determined(self) -> list[Prospect]:
        """Combinations with a ``data_sd`` below half the value; no limits."""
        return [
            p
            for p in self.combinations
            if p.data_sd < WEAK * abs(p.value) and p.status != "unidentified" and not p.on_bound
        ]

    @property
    def remarks(self) -> list[str]:
        """Sentences on back-driving and on a voltage."""
        sentences = map(self._back_driving, self.back_driving)
        return [*sentences, self.voltage["meaning"]] if self.voltage else [*sentences]

    def _back_driving(self, element: str) -> str:
        """Describe how often the load drives an element."""
        share, loss = self.back_driving[element], f"{element}.load_back"
        sentence = f"the load drives {element} in {percent(share)} % of the moving outputs"
        is_open = any(p.name == loss and p.status == "unidentified" for p in self.parameters)
        return f"{sentence}: {loss} rests on its prior" if is_open and share < HARDLY else sentence

    def as_json(self) -> dict[str, Any]:
        """Give what ``bayesfric identify --json`` prints; what is infinite is ``None``."""
        fields = {
            "method": self.method,
            "noise": self.noise,
            "directions": self.directions,
            "combinations": {p.name: _fields(p, "name", "prior_sd") for p in self.combinations},
            "parameters": {p.name: _fields(p, "name") for p in self.parameters},
            "back_driving": {
                name: {"at_estimate": share, "meaning": self._back_driving(name)}
                for name, share in self.back_driving.items()
            },
            "recordings": self.recordings,
            "voltage": self.voltage,
        }
        return dict(jsonable(fields))


def _fields(record: Any, *names: str) -> dict[str, Any]:
    return {name: value for name, value in vars(record).items() if name not in names}


def identify(
    target: Target, estimate: Array, *, speed: dict[str, Any] | None = None
) -> Identification:
    """Compute what the recordings determine at an estimate ``(d,)``, before anything is sampled.

    With J the Jacobian over the noise and P the priors' variances, the data's information is
    ``J'J`` and a quantity of gradient g has ``sd² = g' (J'J + P^-1)^-1 g``. The scalings are
    structurally unidentifiable; weak directions are practically so [1]_.

    .. [1] A. Raue et al., "Structural and practical identifiability analysis of partially observed
    dynamical models by exploiting the profile likelihood", Bioinformatics 25 (2009) 1923-1929.
    """
    chain, observations = target.likelihood.chain, target.likelihood.observations
    local = in_natural_units(target, estimate, local_information(target, estimate))
    values = target.chain_values(estimate[None])[0]
    coverage = coverage_of(chain, observations, values)
    for recording, outputs in zip(coverage, target.likelihood.outputs, strict=True):
        recording["outputs"] = outputs.measured.size
    back = back_driving(chain, observations, values)
    rare, free = any(share < HARDLY for share in back.values()), len(target.free)
    tried = trials(target, estimate, local, rare=rare) if any(open_rows(local)) else []
    both = joined(local.directions.identified, prior_rows(target, local))
    # ends of the priors that the estimate is on
    limits, sds = zip(*((p.limits, p.sd()) for p in target.priors[:free]), strict=True)
    low, high = np.array(limits).T
    met = bounds_met(estimate[:free], low, high, np.where(np.isfinite(sds), sds, 0.0))
    bounds = [{-1: "lower", 1: "upper"}.get(int(end)) for end in met]
    parameters = [p for p in chain.parameters if p.name in target.free]
    known = {
        name
        for name, prior, value in zip(target.names, target.priors, estimate, strict=True)
        if not prior.default and prior.sd() < KNOWN * abs(value)
    }
    prospects = []
    for j, (p, sd, bound) in enumerate(zip(parameters, sds, bounds, strict=True)):
        data_sd, expected = float(local.data_sd[j]), both.sd(np.eye(free)[j] * local.units)
        status = _status(verdict(expected, float(sd), data_sd), bound)
        row = p.name, p.unit, p.meaning, float(estimate[j]), data_sd, expected, float(sd)
        prospects.append(Prospect(*row, status, bound))
    combinations = []
    for q, value, gradient in derived_gradients(target, estimate, local):
        if not np.isfinite([value, *gradient]).all() or not gradient.any():
            continue  # undefined, or of fixed values
        data_sd, expected = local.data_sd_of(gradient / local.units), both.sd(gradient)
        ends = [bound for bound, x in zip(bounds, gradient, strict=True) if x]
        end = ends[0] if all(ends) else None
        # without a prior of its own
        status = _status(verdict(expected, float("inf"), data_sd), end)
        row = q.name, q.unit, q.meaning, value, data_sd, expected, float("nan")
        combinations.append(Prospect(*row, status, end))
    combinations.sort(key=lambda p: p.data_sd / max(abs(p.value), 1e-300))
    return Identification(
        target.likelihood.method,
        target.likelihood.noise.description,
        target.likelihood.noise.accounts_for_correlation,
        local,
        tuple(open_directions(local, parameters, coverage, back, tried, known)),
        tuple(prospects),
        tuple(combinations),
        coverage,
        back,
        speed,
    )


def _status(determined: Determined, bound: str | None) -> Status:
    return "limit" if bound and determined != "prior" else KNOWN_BY[determined]


# Open directions: why, and what would close them. Remedies are tried: a known value is removed from
# the information; a further recording is simulated and its information added.


def open_directions(
    local: LocalInformation,
    free: Sequence[Parameter],
    coverage: Sequence[Mapping[str, Any]],
    back: Mapping[str, float],
    simulated: Sequence[Trial],
    known: Collection[str],
) -> Iterator[OpenDirection]:
    """List null directions first, then weak ones, the weakest first."""
    for number, (row, null) in enumerate(open_rows(local)):
        # smaller entries of a null direction are rounding
        named = np.flatnonzero(np.abs(row) > (1e-5 if null else _NAMED)).tolist()
        in_units = {free[j].name: free[j].unit for j in named if local.shifted[j]}
        exponents = {
            local.labels[j]: float(row[j] * local.units[j])
            if local.shifted[j]
            else float(round(row[j], 9 if null else 3))
            for j in named
        }
        log_sd = None if null else left_along(local.information, row)
        rest = bool(np.any(np.abs(row[row != 0.0]) <= _NAMED))
        if log_sd is None:
            meaning = meaning_of(exponents, in_units)
        else:
            meaning = _weak(exponents, in_units, log_sd, rest)
        theory = number < local.from_theory
        reasons = _scaling(coverage) if theory else _reasons(free, row, null, coverage, back)
        cures = remedies(local, row, simulated, known)
        kind: Literal["null", "weak"] = "null" if null else "weak"
        yield OpenDirection(kind, exponents, in_units, log_sd, meaning, tuple(reasons), cures)


def _weak(
    exponents: Mapping[str, float], in_units: Mapping[str, str], log_sd: float, rest: bool
) -> str:
    """Describe one sd along a weak direction; with ``rest`` further parameters change a little."""
    changes = ", ".join(
        f"{name} {x * log_sd:+.2g} {in_units[name]}".strip()
        if name in in_units
        else f"{name} times {factor(x * log_sd)}"
        for name, x in exponents.items()
    )
    others = ", with smaller changes of others" if rest else ""
    all_ = "all " if len(exponents) > 1 else ""
    return f"{changes}{others}, or the other way round: {all_}within one sd of the data"


def open_rows(local: LocalInformation) -> Iterator[tuple[Array, bool]]:
    """Give null and weak directions in the local units, the largest entry of each being one."""
    for row in local.null_rows:
        yield row, True
    d = local.directions
    identified = zip(d.singular_values[~d.null], d.rows[~d.null], strict=True)
    for value, row in reversed(list(identified)):
        if np.abs(row).max() > WEAK * value:
            sparse = _sparse_row(row, local.null_rows)
            yield sparse / sparse[int(np.argmax(np.abs(sparse)))], False


def _sparse_row(row: Array, null: Array) -> Array:
    """Subtract null directions to make a direction sparse.

    The sum of absolute entries is least where an entry is zero, so those are candidates.
    """
    for other in null:
        entries = np.flatnonzero(np.abs(other) > 1e-6)
        choices = [row] + [row - row[c] / other[c] * other for c in entries]
        row = min(choices, key=lambda candidate: float(np.abs(candidate).sum()))
    return row


def _scaling(coverage: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Explain why leg and gearbox scale together (section 4.2 of the paper)."""
    mass = ", and every recording carries the same known mass, which counts as load"
    loaded = all(recording["added_mass"] for recording in coverage)
    yield (
        "the torque at the motor holds only products of these (section 4.2 of the paper): a load "
        f"twice as heavy behind a gearbox that passes on twice as much makes the same torque"
        f"{mass if loaded else ''}"
    )


def _reasons(
    free: Sequence[Parameter],
    row: Array,
    null: bool,
    coverage: Sequence[Mapping[str, Any]],
    back: Mapping[str, float],
) -> Iterator[str]:
    """Explain a direction that is open although it is not a scaling.

    The load never drives, the joint turns too little or hardly accelerates; else effects are
    collinear.
    """
    members = [p for p, x in zip(free, row, strict=True) if abs(x) > _NAMED]
    # the terms that they fill
    shaped = {kind for p in members for kind, _ in p.row.fills}
    if null and any(p.name == "drive.kp" for p in members):
        yield (
            "no torque was recorded: one factor on gains, inertia, gravity and friction changes no "
            "motion, and only what they are over kp is determined; a known mass, the inertia of a "
            "body, or a known limit that the drive reaches tells the factor, too"
        )
        return
    undriven = [element for element, share in back.items() if share < HARDLY]
    for element in undriven:
        yield (
            f"the load {'hardly ever' if back[element] else 'never'} drives {element}: in "
            f"{percent(back[element])} % of the moving outputs at the estimate"
        )
    if undriven and len(members) > 1:
        yield f"while the motor always drives, effects on both sides of {undriven[0]} are collinear"
    turn, steady = max(r["turn"] for r in coverage), min(r["steady"] for r in coverage)
    small = ("gravity" in shaped or any(p.circular for p in members)) and turn < 1.0
    slow = "inertia" in shaped and steady > 0.8
    if small:
        yield f"the load turns through {turn:.2g} rad only"
    if slow:
        yield (
            f"the joint hardly accelerates: in {100.0 * steady:.0f} % of the outputs inertia takes "
            "less than a twentieth of the torque"
        )
    if undriven or small or slow:
        return
    if len(members) > 1:
        yield "their effects on the output have nearly the same shape in these recordings"
    elif null:
        yield f"no output changes with {members[0].name} in these recordings"
    else:
        yield "its effect on the output is small compared with the noise"


def open_counts(information: Array) -> tuple[int, int]:
    """Count null, and all open, directions of a Fisher information ``(d, d)``."""
    if not information.size:
        return 0, 0
    values, vectors = np.linalg.eigh(information)
    null = values <= 1e-14 * values[-1]
    weak = np.abs(vectors).max(axis=0) > WEAK * np.sqrt(np.where(null, 0.0, values))
    return int(null.sum()), int((null | weak).sum())


def trials(
    target: Target, parameters: Array, local: LocalInformation, *, rare: bool
) -> list[Trial]:
    """Design recordings that may be remedies: motions, of which the inverse model gives torque."""
    chain, observations = target.likelihood.chain, target.likelihood.observations
    values = target.chain_values(parameters[None])[0]
    longest = max(range(len(observations)), key=lambda r: observations[r].measured.size)
    base, noise = observations[longest], torque_noise(target, parameters, longest)
    stretch, period, hertz = longest_stretch(base), sample_period(base), base.pace
    time = period * np.arange(stretch.stop - stretch.start, dtype=np.float64)
    peak = float(np.quantile(np.abs(base.torque[stretch]), 0.99))
    unit = chain.torque_unit
    experiments: list[tuple[RemedyKind, str, Callable[[], Signals]]] = []
    if len({replace(o.inputs, recording="") for o in observations}) == 1:
        mass, article = known_mass(chain, values), "another" if base.inputs.added_mass else "a"
        text = f"another recording with {article} known added mass (added_mass, radius), such as "
        text += f"{mass.added_mass:g} kg"
        text += f" at {mass.radius:g} m" if chain.load.motion == "rotary" else ""
        bolted = in_place_of(base, mass)
        motion = base.q[stretch], base.qd[stretch], base.qdd[stretch]

        def loaded() -> Signals:
            torque = inverse_torque(chain, values, *motion, inputs=bolted, time=time)
            return prepared(chain, values, base, motion, torque, bolted)

        experiments.append(("known mass", text, loaded))
    signals = {
        "of many frequencies, such as a square wave plus a multisine": square_with_sines(
            time, hertz, hertz * LINES
        )
    }
    if rare:
        wave = experiment.square(time, 1.0, hertz)
        signals = {"in which the load drives the motor, such as a square wave": wave} | signals
    for form, shape in signals.items():
        text = f"an excitation {form} of {peak:.2g} {unit} at {hertz:.2g} Hz"
        torque = experiment.current_loop(peak * shape, period, LAG)
        design = partial(designed_recording, chain, values, base, torque, base.inputs)
        experiments.append(("excitation", text, design))
    combinations = []
    for kind, text, record in experiments:
        try:
            recording = record()
        except ValueError:
            continue  # no such motion takes the torque, or it stays at standstill
        rows = scaled_jacobian(target, recording, values, local, noise)
        if np.isfinite(information := rows.T @ rows).all():
            combinations.append((kind, text, information))
    return combinations


def remedies(
    local: LocalInformation, row: Array, simulated: Sequence[Trial], known: Collection[str]
) -> tuple[dict[str, Any], ...]:
    """List the remedies for a direction ``(d,)``, known values first."""
    information = local.information
    before = left_along(information, row)
    nulls, opens = open_counts(information)
    null = not np.isfinite(before)
    useful = list[dict[str, Any]]()
    # parameters that change least, relative to the largest, are no remedy
    members = np.flatnonzero(np.abs(row) >= 0.3 * np.abs(row).max())
    names = []
    for j in members.tolist():
        counts = open_counts(np.delete(np.delete(information, j, axis=0), j, axis=1))
        if local.names[j] not in known and (counts[1] < opens or (null and counts[0] < nulls)):
            names.append(local.names[j])
    if names:
        ways = "fix {}, or give it a prior from a data sheet or CAD"
        if len(names) > 1:
            ways = "fix, or give a prior from a data sheet or CAD to, one of {}"
        text = ways.format(", ".join(names))
        known_value = {"kind": "known value", "text": text, "parameters": names}
        useful.append({**known_value, "log_sd_after": None})
    for kind, text, added in simulated:
        along = left_along(information + added, row)
        # one more recording of the same kind leaves 0.71 of the sd
        if along < WEAK and along < 0.5 * before:
            useful.append({"kind": kind, "text": text, "parameters": [], "log_sd_after": along})
    return tuple(useful)


def left_along(information: Array, row: Array) -> float:
    """Give the sd of the logarithm of the most changed parameter along a direction ``(d,)``."""
    size = float(np.abs(row).max())
    information_along = float(row @ information @ row)
    # of a null direction squaring leaves rounding
    rounding = 1e-14 * float(np.trace(information)) * float(row @ row)
    return size / float(np.sqrt(information_along)) if information_along > rounding else np.inf


# A torque computed from a voltage


def speed_term(target: Target, recordings: Sequence[Measurement]) -> dict[str, Any] | None:
    """List the viscous losses that an error of the nominal back-EMF is collinear with.

    With ``V = R I + kt w`` the torque computed from a voltage is ``kt V/R - kt² w/R`` at the
    motor's speed w; an error of the nominal ``kt²/R`` adds a term proportional to speed. So is a
    viscous loss that no load-dependent friction passes on. None where no torque comes from a
    voltage; else ``recordings`` whose does, the largest ``nominal`` kt²/R with its ``unit``, the
    free losses ``same_as_back_emf``, and a sentence, ``meaning``.
    """
    chain, names = target.likelihood.chain, {o.name for o in target.likelihood.observations}
    driven = {r.name: r.nominal_back_emf for r in recordings if r.name in names}
    driven = {name: value for name, value in driven.items() if value}
    if not driven:
        return None
    lossy = [k for k, element in enumerate(chain.elements) if element.load_loss != "none"]
    first = lossy[0] + 1 if lossy else len(chain.elements)
    before = {element.name for element in chain.elements[:first]}
    viscous = "viscous", "viscous_positive", "viscous_negative"
    losses = [
        p.name
        for p in chain.parameters
        if p.name in target.free and p.owner in before and p.quantity in viscous
    ]
    nominal, unit = max(driven.values()), "N m s" if chain.motor_motion == "rotary" else "N s/m"
    meaning = (
        f"torque comes from a voltage ({', '.join(driven)}), less the nominal "
        f"back-EMF kt²/R ({nominal:.3g} {unit}, at the motor) times speed; "
    )
    meaning += (
        "viscous loss and back-EMF are indistinguishable: it has exactly the shape of "
        f"{' and '.join(losses)}: viscous loss plus the error of the nominal kt²/R. A measured "
        "current, or kt and R measured at a standstill, would distinguish them"
        if losses
        else "no viscous loss makes up for an error in it"
    )
    numbers = {"recordings": [*driven], "nominal": nominal, "unit": unit}
    return {**numbers, "same_as_back_emf": losses, "meaning": meaning}
