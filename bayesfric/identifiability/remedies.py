"""What would lift an open direction: tried out on the local picture before it is proposed."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bayesfric.identifiability.local import WEAK, LocalInformation
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
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.inputs import Inputs

RemedyKind = Literal["known value", "known mass", "excitation"]

# The load drives an element in fewer of the moving samples than this: hardly ever.
HARDLY = 0.01
# A remedy has to do more than one more recording of the same kind, which gives 0.71.
_WORTH = 0.5
# Of the parameters in a direction, those that change at least this share of the most changed.
_MEMBER = 0.3


@dataclass(frozen=True)
class Remedy:
    """Something to do about an open direction, and what it was found to do."""

    kind: RemedyKind
    text: str  # what to do
    parameters: tuple[str, ...]  # for a known value: any one of these
    # sd of the logarithm along the direction once it is done; None for a known value
    log_sd_after: float | None
    # directions, null or weak, that are then still open; of known values the one that leaves fewest
    open_after: int


@dataclass(frozen=True, eq=False)
class Trial:
    """One more recording, simulated at the estimate with the recordings' noise."""

    kind: RemedyKind
    text: str
    information: Array  # (d, d) that its torque would add, in the local units


def open_counts(information: Array) -> tuple[int, int]:
    """Count the null directions of a Fisher information ``(d, d)``, and null or weak ones."""
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
    """Simulate the recordings that could help here.

    At the estimate ``(d,)``, noise scales last; ``rare`` is whether the load hardly drove the
    motor.
    """
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
    """Find what lifts one direction ``(d,)`` in the local units, known values first.

    Those ``told`` have a narrow prior already, and it is no step to give them one. A recording is
    only named if it leaves less than :data:`WEAK` along the direction and half of what was left
    before.
    """
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
    """Sd of the logarithm of the most changed parameter, moving along one direction alone."""
    size = float(np.abs(row).max())
    told = float(row @ information @ row)
    # what squaring leaves of a null direction is rounding
    rounding = 1e-14 * float(np.trace(information)) * float(row @ row)
    return size / float(np.sqrt(told)) if told > rounding else float("inf")
