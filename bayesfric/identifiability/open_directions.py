"""Directions in which the data leave parameters open: which, why, and what would lift them.

Remedies are tried, not guessed: a value that is known is taken out of the Fisher information, and
a further recording, with a known mass or another excitation, is simulated and its information
added.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bayesfric.base.templates import factor, percent
from bayesfric.identifiability.coverage import Coverage
from bayesfric.identifiability.local import WEAK, LocalInformation, meaning_of
from bayesfric.identifiability.virtual_recording import (
    LAG,
    LINES,
    known_mass,
    longest_stretch,
    played,
    sample_period,
    scaled_jacobian,
    square_with_sines,
    torque_noise,
)
from bayesfric.inference.target import Target
from bayesfric.mechanism import excitation
from bayesfric.mechanism.parameter import Parameter
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.inputs import Inputs

RemedyKind = Literal["known value", "known mass", "excitation"]

# The load drives an element in fewer of the moving samples than this: hardly ever.
HARDLY = 0.01
# A remedy has to do more than one more recording of the same kind, which gives 0.71.
_WORTH = 0.5
# Of the parameters in a direction, those that change at least this share of the most changed.
_MEMBER = 0.3
# Entries of a null direction smaller than this are rounding.
_ROUNDING = 1e-5
# Entries of a weak direction smaller than this share of the largest are not named.
_NAMED = 0.2


@dataclass(frozen=True)
class Remedy:
    """Something to do about an open direction, and what it was found to do."""

    kind: RemedyKind  # A known value, a known mass or another excitation, and what to do
    text: str
    parameters: tuple[str, ...]  # For a known value: any one of these
    # Standard deviation of the logarithm along the direction once it is done; None for a known
    # value
    log_sd_after: float | None
    # Directions, null or weak, that are then still open; of known values the one that leaves fewest
    open_after: int


@dataclass(frozen=True)
class OpenDirection:
    """Parameters that can change together, and the data say little or nothing."""

    kind: Literal["null", "weak"]  # null where nothing changes at all, else weak
    # By parameter or alpha its power of one factor; of those in_units the change in their unit that
    # goes with the factor e
    exponents: dict[str, float]
    in_units: dict[str, str]  # Units of parameters next to zero, of which no logarithm is taken
    # Standard deviation that the data leave of the factor's logarithm; infinite for a null
    # direction
    log_sd: float
    meaning: str  # What can change, why it does not show, and what lifts it
    reasons: tuple[str, ...]
    remedies: tuple[Remedy, ...]

    @property
    def null(self) -> bool:
        """Whether it changes no output at all."""
        return self.kind == "null"


def open_directions(
    local: LocalInformation,
    free: Sequence[Parameter],
    coverage: Sequence[Coverage],
    back: Mapping[str, float],
    tried: Sequence[Trial],
    told: Collection[str],
) -> Iterator[OpenDirection]:
    """List null directions first, then weak ones, the weakest first."""
    for number, (row, null) in enumerate(open_rows(local)):
        named = np.flatnonzero(np.abs(row) > (_ROUNDING if null else _NAMED)).tolist()
        in_units = {free[j].name: free[j].unit for j in named if local.shifted[j]}
        exponents = {
            local.labels[j]: float(row[j] * local.units[j])
            if local.shifted[j]
            else float(round(row[j], 9 if null else 3))
            for j in named
        }
        log_sd = np.inf if null else left_along(local.information, row)
        more = bool(np.any(np.abs(row[row != 0.0]) <= _NAMED))
        theory = number < local.from_theory
        yield OpenDirection(
            "null" if null else "weak",
            exponents,
            in_units,
            log_sd,
            meaning_of(exponents, in_units) if null else _weak(exponents, in_units, log_sd, more),
            tuple(_scaling(coverage) if theory else _reasons(free, row, null, coverage, back)),
            remedies(local, row, tried, told),
        )


def _weak(
    exponents: Mapping[str, float], in_units: Mapping[str, str], log_sd: float, more: bool
) -> str:
    """Say what one sd along a weak direction is; ``more`` than what is named changes a little."""
    changes = ", ".join(
        f"{name} {x * log_sd:+.2g} {in_units[name]}".strip()
        if name in in_units
        else f"{name} times {factor(x * log_sd)}"
        for name, x in exponents.items()
    )
    beside = ", with smaller changes of others" if more else ""
    both = "all " if len(exponents) > 1 else ""
    return f"{changes}{beside}, or the other way round: {both}within one sd of the data"


def open_rows(local: LocalInformation) -> Iterator[tuple[Array, bool]]:
    """Give null and weak directions in the local units, the largest entry of each one."""
    for row in local.null_rows:
        yield row, True
    d = local.directions
    told = zip(d.singular_values[~d.null], d.rows[~d.null], strict=True)
    for value, row in reversed(list(told)):
        if np.abs(row).max() > WEAK * value:
            sparse = _without(row, local.null_rows)
            yield sparse / sparse[int(np.argmax(np.abs(sparse)))], False


def _without(row: Array, null: Array) -> Array:
    """Take null directions off a direction, which changes no output, to make it short.

    The sum of absolute entries is least where one of them is zero, so those are tried.
    """
    for other in null:
        hits = np.flatnonzero(np.abs(other) > 1e-6)
        choices = [row] + [row - row[c] / other[c] * other for c in hits]
        row = min(choices, key=lambda one: float(np.abs(one).sum()))
    return row


def _scaling(coverage: Sequence[Coverage]) -> Iterator[str]:
    """Say why leg and gearbox scale together (section 4.2 of the paper)."""
    mass = ", and every recording carries the same known mass, which counts as load"
    yield (
        "the torque at the motor holds only products of these (section 4.2 of the paper): a load "
        "twice as heavy behind a gearbox that passes on twice as much feels the same"
        + mass
        * all(one.added_mass for one in coverage)
    )


def _reasons(
    free: Sequence[Parameter],
    row: Array,
    null: bool,
    coverage: Sequence[Coverage],
    back: Mapping[str, float],
) -> Iterator[str]:
    """Say why a direction is open where theory does not.

    The load never drives, the joint turns too little or hardly accelerates; else effects look
    alike.
    """
    members = [p for p, x in zip(free, row, strict=True) if abs(x) > _NAMED]
    # what they shape: the terms that they fill, or turn
    shaped = {kind for p in members for kind, _ in p.row.fills}
    rare = [element for element, share in back.items() if share < HARDLY]
    for element in rare:
        yield (
            f"the load {'hardly ever' if back[element] else 'never'} drives {element}: in "
            f"{percent(back[element])} % of the moving outputs at the estimate"
        )
    if rare and len(members) > 1:
        yield f"while the motor always drives, what lies on either side of {rare[0]} acts alike"
    turn, steady = max(one.turn for one in coverage), min(one.steady for one in coverage)
    small = ("gravity" in shaped or any(p.circular for p in members)) and turn < 1.0
    slow = "inertia" in shaped and steady > 0.8
    if small:
        yield f"the load turns through {turn:.2g} rad only"
    if slow:
        yield (
            f"the joint hardly accelerates: in {100.0 * steady:.0f} % of the outputs inertia takes "
            "less than a twentieth of the torque"
        )
    if rare or small or slow:
        return
    if len(members) > 1:
        yield "their effects on the output have nearly the same shape in these recordings"
    elif null:
        yield f"no output changes with {members[0].name} in these recordings"
    else:
        yield "its effect on the output is small beside the noise"


@dataclass(frozen=True, eq=False)
class Trial:
    """One more recording, simulated at the estimate with the recordings' noise."""

    kind: RemedyKind  # As of the :class:`Remedy` that it may become
    text: str
    information: Array  # (d, d) that its torque would add, in the local units


def open_counts(information: Array) -> tuple[int, int]:
    """Count the open directions of a Fisher information. Shapes: information (d, d)."""
    if not information.size:
        return 0, 0
    values, vectors = np.linalg.eigh(information)
    null = values <= 1e-14 * values[-1]
    weak = np.abs(vectors).max(axis=0) > WEAK * np.sqrt(np.where(null, 0.0, values))
    return int(null.sum()), int((null | weak).sum())


def trials(
    target: Target,
    parameters: Array,
    local: LocalInformation,
    *,
    rare: bool,
) -> list[Trial]:
    """Simulate the recordings that could help here."""
    chain, observations = target.likelihood.chain, target.likelihood.observations
    values = target.chain_values(parameters[None])[0]
    longest = max(range(len(observations)), key=lambda r: observations[r].measured.size)
    base = observations[longest]
    noise = torque_noise(target, parameters, longest)
    rotary = chain.load.motion == "rotary"
    measured, period, hertz = base.torque[longest_stretch(base)], sample_period(base), base.pace
    time = period * np.arange(measured.size, dtype=np.float64)
    peak = float(np.quantile(np.abs(measured), 0.99))
    unit = "N m" if chain.motor_motion == "rotary" else "N"

    wanted: list[tuple[RemedyKind, str, Array, Inputs]] = []

    def excite(form: str, shape: Array) -> None:
        torque = excitation.current_loop(peak * shape, period, LAG)
        text = f"an excitation {form} of {peak:.2g} {unit} at {hertz:.2g} Hz"
        wanted.append(("excitation", text, torque, base.inputs))

    if len({replace(o.inputs, recording="") for o in observations}) == 1:
        mass, another = known_mass(chain, values), "another" if base.inputs.added_mass else "a"
        text = f"another recording with {another} known added mass (added_mass, radius), such as "
        text += f"{mass.added_mass:g} kg" + (f" at {mass.radius:g} m" if rotary else "")
        wanted.append(("known mass", text, measured, mass))
    if rare:
        wave = excitation.square(time, 1.0, hertz)
        excite("in which the load drives the motor, such as a square wave", wave)
    shape = square_with_sines(time, hertz, hertz * LINES)
    excite("of many frequencies, such as a square wave plus a multisine", shape)
    found = []
    for kind, text, torque, bolted in wanted:
        try:
            recording = played(chain, values, base, torque, bolted)
        except ValueError:
            continue  # the joint cannot be simulated, or would stand still: nothing to propose
        rows = scaled_jacobian(target, recording, values, local, noise)
        gained = rows.T @ rows
        if np.isfinite(gained).all():
            found.append(Trial(kind, text, gained))
    return found


def remedies(
    local: LocalInformation, row: Array, tried: Sequence[Trial], told: Collection[str]
) -> tuple[Remedy, ...]:
    """Find what lifts one direction, known values first. Shapes: row (d,)."""
    information = local.information
    before = left_along(information, row)
    nulls, opens = open_counts(information)
    null = not np.isfinite(before)
    found = []
    members = np.flatnonzero(np.abs(row) >= _MEMBER * np.abs(row).max())
    helping = {}
    for j in members:
        rest = np.delete(np.delete(information, j, axis=0), j, axis=1)
        left = open_counts(rest)
        if local.names[j] not in told and (left[1] < opens or (null and left[0] < nulls)):
            helping[int(j)] = left[1]
    if helping:
        names = tuple(local.names[j] for j in helping)
        ways = "fix {}, or give it a prior from a data sheet or CAD"
        if len(names) > 1:
            ways = "fix, or give a prior from a data sheet or CAD to, one of {}"
        text = ways.format(", ".join(names))
        found.append(Remedy("known value", text, names, None, min(helping.values())))
    for trial in tried:
        along = left_along(information + trial.information, row)
        if along < WEAK and along < _WORTH * before:
            count = open_counts(information + trial.information)[1]
            found.append(Remedy(trial.kind, trial.text, (), along, count))
    return tuple(found)


def left_along(information: Array, row: Array) -> float:
    """Sd of the logarithm of the most changed parameter, moving along one direction alone.

    Shapes: information (d, d); row (d,).
    """
    size = float(np.abs(row).max())
    told = float(row @ information @ row)
    # what squaring leaves of a null direction is rounding
    rounding = 1e-14 * float(np.trace(information)) * float(row @ row)
    return size / float(np.sqrt(told)) if told > rounding else float("inf")
