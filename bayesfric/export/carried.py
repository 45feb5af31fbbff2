"""What of a joint a format carries, what it loses, and what is put in the place of that."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesfric.export.at_joint import NUMBERS, Array, AtJoint, Moved, places
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.parameter import Parameter
from bayesfric.mechanism.quantities import Motion, Quantity

# What is of the link and of the drive: a format of joints leaves these to the model around it.
LINK = ("link_inertia", "link_moment", "link_gravity_angle")
DRIVE = ("gain", "torque_offset")


@dataclass(frozen=True)
class Lost:
    """One thing that a format cannot carry.

    ``kind`` has a sentence in ``templates/lost.txt.j2``, which says what was put in its place;
    ``numbers`` are what it says, in the unit it names.
    """

    kind: str
    parameters: tuple[str, ...]
    numbers: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Give it as JSON holds it."""
        return {"kind": self.kind, "parameters": list(self.parameters), **self.numbers}


# Rows of the table of quantities that no simulator's joint has a number for, by the kind of loss.
_KINDS: dict[str, str] = {
    **dict.fromkeys(("coulomb_positive", "viscous_positive"), "direction"),
    **dict.fromkeys(("load", "load_drive"), "load loss"),
    **dict.fromkeys(
        ("load_difference", "load_drive_difference", "load_back_difference"), "load direction"
    ),
    "load_speed": "load speed",
    "load_square": "load square",
    **dict.fromkeys(
        ("stribeck_ratio", "stribeck_change", "stribeck_constant", "stribeck_load"), "stribeck"
    ),
    "delay": "delay",
}
# Told with the row before them, or nothing by themselves.
_PARTNERS = {
    "coulomb_positive": "coulomb_negative",
    "viscous_positive": "viscous_negative",
    "load_drive": "load_back",
}


def lost_terms(
    chain: Joint, at: AtJoint, vector: Array, carries: Collection[str]
) -> tuple[Lost, ...]:
    """List what simulators' joints do not have, at one parameter vector ``(d,)``."""
    value = dict(zip(chain.names, vector.tolist(), strict=True))
    rotary = chain.load.motion == "rotary"
    found = []
    for p in chain.parameters:
        if p.owner == "" and p.name != "offset":
            found.append(Lost("own offset", (p.name,), {"value": value[p.name], "unit": p.unit}))
        elif not places(p):
            constant, damping = (float(x[0]) for x in at.fitted[p.name])
            units = {"unit": NUMBERS["friction"].unit(chain.load.motion)}
            units["damping_unit"] = NUMBERS["damping"].unit(chain.load.motion)
            said = {"friction": constant, "damping": damping, "meaning": p.meaning, **units}
            found.append(Lost("fitted", (p.name,), said))
        elif p.quantity in _KINDS:
            found.append(_lost(_KINDS[p.quantity], p, at, value, "N m" if rotary else "N"))
    if "static_friction" in carries:
        found = [
            Lost("stribeck speed", x.parameters, x.numbers) if x.kind == "stribeck" else x
            for x in found
        ]
    return tuple(found)


def _lost(kind: str, p: Parameter, at: AtJoint, value: dict[str, float], unit: str) -> Lost:
    partner = f"{p.owner}.{_PARTNERS.get(p.quantity, '')}"
    names = (p.name, *([partner] if partner in value else []))
    numbers: dict[str, Any] = {"value": value[p.name], "unit": p.unit}
    if kind == "direction":
        numbers["half_difference"] = 0.5 * (value[names[0]] - value[names[-1]])
    if p.owner in at.reference:
        numbers["reference"] = float(at.reference[p.owner][0])
        numbers["reference_unit"] = unit
    if kind == "load loss":
        drive, back = value[names[0]], value[names[-1]]
        numbers |= {"mean": 0.5 * (drive + back), "passed": 1.0 + 0.5 * (drive - back)}
        kind = "load loss" if len(names) == 1 else "load losses"
    return Lost(kind, names, numbers)


def law_lost(chain: Joint, vector: Array) -> tuple[Lost, ...]:
    """List what a law that is written out leaves out: what hangs on the recording."""
    value = dict(zip(chain.names, vector.tolist(), strict=True))
    found = []
    for p in chain.parameters:
        said = {"value": value[p.name], "unit": p.unit, "meaning": p.meaning}
        if p.quantity == "delay":
            found.append(Lost("delay", (p.name,), said))
        elif p.owner == "" and p.name != "offset":
            found.append(Lost("own offset", (p.name,), said))
        elif left_out(p.row):
            found.append(Lost("at room", (p.name,), said))
    return tuple(found)


def left_out(row: Quantity) -> bool:
    """Whether a term is none at 20 degC as a recording begins, so that a law does without it."""
    return bool(row.signal) or row.shape == "warming_time"


@dataclass(frozen=True, eq=False)
class Carried:
    """The numbers ``(n,)`` of a format, with what it has no number for folded into others."""

    values: dict[str, Array]
    lost: tuple[Lost, ...]


def carried(
    at: AtJoint,
    carries: Collection[str],
    supplied: Collection[str],
    motions: Sequence[Moved],
    motion: Motion,
) -> Carried:
    """Fold what a format has no number for into numbers that it has, or leave it out.

    Parameters
    ----------
    at
        All numbers.
    carries
        Names of those the format has.
    supplied
        Names of those the model around it brings, such as a link's inertia: they count as right.
    motions
        What a quadratic loss and a stiffening spring are replaced over.
    motion
        Whether the joint turns or slides.
    """
    values = dict(at.values)
    lost = []
    speed = np.abs(np.concatenate([m.qd for m in motions]))
    place = np.concatenate([m.q for m in motions])
    folds: dict[str, tuple[str, Callable[[], float]]] = {
        "armature": ("link_inertia", lambda: 1.0),
        "quadratic": ("damping", lambda: _slope(speed, speed**2)),
        "stiffness_cubic": ("stiffness", lambda: _slope(place, place**3)),
    }
    for name, number in NUMBERS.items():
        here = values[name]
        if name in carries or name in supplied or not np.any(here):
            continue
        if name == "static_friction":
            values[name] = values["friction"]
            continue
        values[name] = np.zeros_like(here)
        said: dict[str, Any] = {"number": name, "value": float(here[0]), "meaning": number.meaning}
        said |= {"unit": number.unit(motion), "into": ""}
        into, share = folds.get(name, ("", lambda: 0.0))
        if into in carries:
            amount = share() * here
            values[into] = values[into] + amount
            said |= {
                "into": into,
                "amount": float(amount[0]),
                "into_unit": NUMBERS[into].unit(motion),
            }
        lost.append(Lost("not carried", at.made_from[name], said))
    return Carried(values, tuple(lost))


def _slope(x: Array, y: Array) -> float:
    """Slope of the line through zero that is nearest to ``y``."""
    size = float(x @ x)
    return float(x @ y) / size if size else 0.0
