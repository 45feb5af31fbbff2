"""Open directions of the parameters: which, why, and what would close them.

Remedies are evaluated: a known value is removed from the Fisher information; a further recording,
with a known mass or another excitation, is simulated and its information added.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bayesfric.base.templates import factor, percent
from bayesfric.identifiability.coverage import Coverage
from bayesfric.identifiability.local import WEAK, LocalInformation, meaning_of
from bayesfric.identifiability.simulated_recording import (
    LAG,
    LINES,
    known_mass,
    longest_stretch,
    sample_period,
    scaled_jacobian,
    simulate_recording,
    square_with_sines,
    torque_noise,
)
from bayesfric.inference.target import Target
from bayesfric.mechanism import excitation
from bayesfric.mechanism.parameter import Parameter
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import Inputs

RemedyKind = Literal["known value", "known mass", "excitation"]

# Share of moving samples below which the load hardly ever drives an element.
HARDLY = 0.01
# Factor on the sd of a useful remedy; one more recording of the same kind gives 0.71.
_USEFUL = 0.5
# Least change of a parameter in a direction, relative to the largest, to be a remedy for it.
_MEMBER = 0.3
# Entries of a null direction smaller than this are rounding.
_ROUNDING = 1e-5
# Entries of a weak direction smaller than this share of the largest are not named.
_NAMED = 0.2


@dataclass(frozen=True)
class Remedy:
    """A remedy for an open direction, and its effect."""

    kind: RemedyKind
    text: str  # what to do
    parameters: tuple[str, ...]  # for a known value: any single one of these
    log_sd_after: float | None  # sd of the logarithm along the direction; None for a known value
    open_after: int  # directions that remain open, with the best of the known values


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
    remedies: tuple[Remedy, ...]

    @property
    def null(self) -> bool:
        """Whether no output changes along it."""
        return self.kind == "null"


def open_directions(
    local: LocalInformation,
    free: Sequence[Parameter],
    coverage: Sequence[Coverage],
    back: Mapping[str, float],
    simulated: Sequence[Trial],
    known: Collection[str],
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
        log_sd = None if null else left_along(local.information, row)
        rest = bool(np.any(np.abs(row[row != 0.0]) <= _NAMED))
        theory = number < local.from_theory
        yield OpenDirection(
            "null" if null else "weak",
            exponents,
            in_units,
            log_sd,
            meaning_of(exponents, in_units)
            if log_sd is None
            else _weak(exponents, in_units, log_sd, rest),
            tuple(_scaling(coverage) if theory else _reasons(free, row, null, coverage, back)),
            remedies(local, row, simulated, known),
        )


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


def _scaling(coverage: Sequence[Coverage]) -> Iterator[str]:
    """Explain why leg and gearbox scale together (section 4.2 of the paper)."""
    mass = ", and every recording carries the same known mass, which counts as load"
    yield (
        "the torque at the motor holds only products of these (section 4.2 of the paper): a load "
        "twice as heavy behind a gearbox that passes on twice as much makes the same torque"
        + mass
        * all(recording.added_mass for recording in coverage)
    )


def _reasons(
    free: Sequence[Parameter],
    row: Array,
    null: bool,
    coverage: Sequence[Coverage],
    back: Mapping[str, float],
) -> Iterator[str]:
    """Explain a direction that is open although it is not a scaling.

    The load never drives, the joint turns too little or hardly accelerates; else effects are
    collinear.
    """
    members = [p for p, x in zip(free, row, strict=True) if abs(x) > _NAMED]
    # the terms that they fill
    shaped = {kind for p in members for kind, _ in p.row.fills}
    undriven = [element for element, share in back.items() if share < HARDLY]
    for element in undriven:
        yield (
            f"the load {'hardly ever' if back[element] else 'never'} drives {element}: in "
            f"{percent(back[element])} % of the moving outputs at the estimate"
        )
    if undriven and len(members) > 1:
        yield f"while the motor always drives, effects on both sides of {undriven[0]} are collinear"
    turn, steady = (
        max(r.turn for r in coverage),
        min(r.steady for r in coverage),
    )
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


@dataclass(frozen=True, eq=False)
class Trial:
    """One more recording, simulated at the estimate with the recordings' noise."""

    kind: RemedyKind
    text: str
    information: Array  # (d, d) that its torque would add, in the local units


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
    """Simulate recordings that may be remedies."""
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

    experiments: list[tuple[RemedyKind, str, Array, Inputs]] = []

    def excite(form: str, shape: Array) -> None:
        torque = excitation.current_loop(peak * shape, period, LAG)
        text = f"an excitation {form} of {peak:.2g} {unit} at {hertz:.2g} Hz"
        experiments.append(("excitation", text, torque, base.inputs))

    if len({replace(o.inputs, recording="") for o in observations}) == 1:
        mass, article = known_mass(chain, values), "another" if base.inputs.added_mass else "a"
        text = f"another recording with {article} known added mass (added_mass, radius), such as "
        text += f"{mass.added_mass:g} kg" + (f" at {mass.radius:g} m" if rotary else "")
        experiments.append(("known mass", text, measured, mass))
    if rare:
        wave = excitation.square(time, 1.0, hertz)
        excite("in which the load drives the motor, such as a square wave", wave)
    shape = square_with_sines(time, hertz, hertz * LINES)
    excite("of many frequencies, such as a square wave plus a multisine", shape)
    simulated = []
    for kind, text, torque, bolted in experiments:
        try:
            recording = simulate_recording(chain, values, base, torque, bolted)
        except ValueError:
            continue  # it cannot be simulated, or stays at standstill
        rows = scaled_jacobian(target, recording, values, local, noise)
        information = rows.T @ rows
        if np.isfinite(information).all():
            simulated.append(Trial(kind, text, information))
    return simulated


def remedies(
    local: LocalInformation, row: Array, simulated: Sequence[Trial], known: Collection[str]
) -> tuple[Remedy, ...]:
    """List the remedies for a direction ``(d,)``, known values first."""
    information = local.information
    before = left_along(information, row)
    nulls, opens = open_counts(information)
    null = not np.isfinite(before)
    useful = []
    members = np.flatnonzero(np.abs(row) >= _MEMBER * np.abs(row).max())
    helping = {}
    for j in members:
        others = np.delete(np.delete(information, j, axis=0), j, axis=1)
        counts = open_counts(others)
        if local.names[j] not in known and (counts[1] < opens or (null and counts[0] < nulls)):
            helping[int(j)] = counts[1]
    if helping:
        names = tuple(local.names[j] for j in helping)
        ways = "fix {}, or give it a prior from a data sheet or CAD"
        if len(names) > 1:
            ways = "fix, or give a prior from a data sheet or CAD to, one of {}"
        text = ways.format(", ".join(names))
        useful.append(Remedy("known value", text, names, None, min(helping.values())))
    for trial in simulated:
        along = left_along(information + trial.information, row)
        if along < WEAK and along < _USEFUL * before:
            count = open_counts(information + trial.information)[1]
            useful.append(Remedy(trial.kind, trial.text, (), along, count))
    return tuple(useful)


def left_along(information: Array, row: Array) -> float:
    """Give the sd of the logarithm of the most changed parameter along a direction ``(d,)``."""
    size = float(np.abs(row).max())
    information_along = float(row @ information @ row)
    # of a null direction squaring leaves rounding
    rounding = 1e-14 * float(np.trace(information)) * float(row @ row)
    return (
        size / float(np.sqrt(information_along)) if information_along > rounding else float("inf")
    )
