"""What would lift an open direction: tried out on the local picture before it is proposed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.identifiability.local import LocalInformation
from bayesfric.identifiability.recording_facts import RecordingFacts
from bayesfric.identifiability.virtual_recording import (
    known_mass,
    pace,
    scaled_jacobian,
    torque_noise,
    with_mass,
    with_torque,
)
from bayesfric.inference.target import Target
from bayesfric.recordings.observation import Observation

Array = NDArray[np.float64]
RemedyKind = Literal["known value", "known mass", "excitation"]

# A direction along which the data leave more than this in a logarithm is weak: a factor
# exp(0.5) = 1.6 either way.
WEAK = 0.5
# The load drives an element in fewer of the moving samples than this: hardly ever.
HARDLY = 0.01
# A remedy has to do more than one more recording of the same kind, which gives 0.71.
_WORTH = 0.5
# Of the parameters in a direction, those that change at least this share of the most changed.
_MEMBER = 0.3
# Turned through less than this, gravity is next to a straight line, rad.
_SMALL_TURN = 1.0


@dataclass(frozen=True)
class Remedy:
    """Something to do about an open direction, and what it was found to do.

    Attributes
    ----------
    kind
        ``known value``, ``known mass`` or ``excitation``.
    text
        In words.
    parameters
        For a known value: any one of these.
    left
        Sd of the logarithm along the direction once it is done; ``None`` for a known value.
    open_after
        Number of directions, null or weak, that are then still open; of known values the
        one that leaves fewest.
    """

    kind: RemedyKind
    text: str
    parameters: tuple[str, ...]
    left: float | None
    open_after: int


@dataclass(frozen=True, eq=False)
class Trial:
    """One more recording, simulated at the estimate with the recordings' noise.

    Attributes
    ----------
    kind, text
        As in :class:`Remedy`.
    information
        ``(d, d)`` that its torque would add, in the local units.
    """

    kind: RemedyKind
    text: str
    information: Array


def open_count(information: Array) -> int:
    """Count the directions, null or weak, of a Fisher information ``(d, d)``."""
    return _open_counts(information)[1]


def _open_counts(information: Array) -> tuple[int, int]:
    """Count null directions, and null or weak ones."""
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
    facts: Sequence[RecordingFacts],
    *,
    rare: bool,
) -> list[Trial]:
    """Simulate the recordings that could help here.

    Parameters
    ----------
    target
        Likelihood, priors and noise.
    parameters
        ``(d,)`` the estimate, noise scales last.
    local
        Of the target there.
    facts
        Of the recordings, which decide what is worth trying.
    rare
        Whether the load may hardly ever have driven the motor.
    """
    chain, observations = target.likelihood.chain, target.likelihood.observations
    values = target.chain_values(parameters[None])[0]
    longest = max(range(len(observations)), key=lambda r: facts[r].outputs)
    base = observations[longest]
    noise = torque_noise(target, parameters, longest)

    mass, radius = known_mass(chain, values)
    where = f" at {radius:g} m" if chain.load.motion == "rotary" else ""
    makers: list[tuple[RemedyKind, str, Callable[[], Observation]]] = []
    carried = {(f.added_mass, f.radius) for f in facts}
    if len(carried) == 1:
        more = "another" if base.inputs.added_mass else "a"
        makers.append(
            (
                "known mass",
                f"another recording with {more} known added mass (added_mass, radius), "
                f"such as {mass:g} kg{where}",
                lambda: with_mass(chain, values, base, mass, radius),
            )
        )
    unit = "N m" if chain.motor_motion == "rotary" else "N"
    peak = float(np.quantile(np.abs(base.torque), 0.99))
    level = f"of {peak:.2g} {unit} at {pace(base):.2g} Hz"
    if rare:
        makers.append(
            (
                "excitation",
                f"an excitation in which the load drives the motor, such as a square wave {level}",
                lambda: with_torque(chain, values, base, "square"),
            )
        )
    if rare or any(f.piecewise_constant for f in facts):
        makers.append(
            (
                "excitation",
                "a torque that is not piecewise constant, such as a square wave plus a "
                f"multisine {level}",
                lambda: with_torque(chain, values, base, "square-multisine"),
            )
        )
    if chain.load.motion == "rotary" and max(f.turn for f in facts) < _SMALL_TURN:
        makers.append(
            (
                "excitation",
                "a motion that turns the load further, such as half as much torque again",
                lambda: with_torque(chain, values, base, "same", 1.5),
            )
        )
    found = []
    for kind, text, make in makers:
        try:
            recording = make()
        except ValueError:
            continue  # the joint cannot be simulated, or would stand still: nothing to propose
        rows = scaled_jacobian(target, recording, values, local.units, noise)
        gained = rows.T @ rows
        if np.isfinite(gained).all():
            found.append(Trial(kind, text, gained))
    return found


def remedies(local: LocalInformation, row: Array, tried: Sequence[Trial]) -> tuple[Remedy, ...]:
    """Find what lifts one direction.

    Parameters
    ----------
    local
        Of the target at the estimate.
    row
        ``(d,)`` the direction in the local units.
    tried
        From :func:`trials`.

    Returns
    -------
    tuple of Remedy
        Known values first. A recording is only named if it leaves less than
        :data:`WEAK` along the direction and half of what was left before.
    """
    information = local.information
    before = left_along(information, row)
    nulls, opens = _open_counts(information)
    null = not np.isfinite(before)
    found = []
    members = np.flatnonzero(np.abs(row) >= _MEMBER * np.abs(row).max())
    helping = {}
    for j in members:
        rest = np.delete(np.delete(information, j, axis=0), j, axis=1)
        left = _open_counts(rest)
        if left[1] < opens or (null and left[0] < nulls):
            helping[int(j)] = left[1]
    if helping:
        names = tuple(local.names[j] for j in helping)
        text = (
            f"fix {names[0]}, or give it a prior from a data sheet or CAD"
            if len(names) == 1
            else f"fix, or give a prior from a data sheet or CAD to, one of {', '.join(names)}"
        )
        found.append(Remedy("known value", text, names, None, min(helping.values())))
    for trial in tried:
        along = left_along(information + trial.information, row)
        if along < WEAK and along < _WORTH * before:
            count = open_count(information + trial.information)
            found.append(Remedy(trial.kind, trial.text, (), along, count))
    return tuple(found)


def left_along(information: Array, row: Array) -> float:
    """Sd of the logarithm of the most changed parameter, moving along one direction alone."""
    size = float(np.abs(row).max())
    told = float(row @ information @ row)
    # what squaring leaves of a null direction is rounding
    rounding = 1e-14 * float(np.trace(information)) * float(row @ row)
    return size / float(np.sqrt(told)) if told > rounding else float("inf")
