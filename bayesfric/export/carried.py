"""What of a joint a format carries, what it loses, and what is put in the place of that."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesfric.export.at_joint import NUMBERS, AtJoint, Moved, places
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.parameter import Parameter
from bayesfric.mechanism.quantities import Quantity
from bayesfric.recordings.arrays import Array

# What is of the link and of the drive: a format of joints leaves these to the model around it.
AROUND = ("link_inertia", "link_moment", "link_gravity_angle", "gain", "torque_offset")


@dataclass(frozen=True)
class Lost:
    """One thing that a format cannot carry.

    ``templates/lost.txt.j2`` says by its ``kind`` what was put in its place; ``numbers`` are what
    it says, in the unit it names.
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
    **dict.fromkeys(("load", "load_drive", "load_speed", "load_square"), "load"),
    **dict.fromkeys(
        (
            "load_difference", "load_drive_difference", "load_back_difference", "stribeck_ratio",
            "stribeck_change", "stribeck_constant", "stribeck_load", "delay",
        ),
        "left out",
    ),
}  # fmt: skip
# Told with the row before them, and what both are.
_PARTNERS = {
    "coulomb_positive": ("coulomb_negative", "constant loss by direction"),
    "viscous_positive": ("viscous_negative", "viscous loss by direction"),
    "load_drive": ("load_back", "loss per transmitted torque, driving and back-driven"),
}


def lost_terms(
    chain: Joint, at: AtJoint, vector: Array, carries: Collection[str], keeps: Collection[str] = ()
) -> tuple[Lost, ...]:
    """List what simulators' joints do not have, at one parameter vector ``(d,)``.

    ``carries`` are the numbers that a format has, ``keeps`` the quantities.
    """
    value = dict(zip(chain.names, vector.tolist(), strict=True))
    found = []
    for p in chain.parameters:
        kind = "left out" if _of_recording(p) else _KINDS.get(p.quantity, "")
        said: dict[str, Any] = {"value": value[p.name], "unit": p.unit, "meaning": p.meaning}
        names: tuple[str, ...] = (p.name,)
        if not places(p) and not _of_recording(p):
            kind = "fitted"
            for number, x in zip(("friction", "damping"), at.fitted[p.name], strict=True):
                said |= {number: float(x[0]), f"{number}_unit": NUMBERS[number].unit(chain)}
        if not kind or p.quantity in keeps:
            continue
        partner, both = _PARTNERS.get(p.quantity, ("", ""))
        if f"{p.owner}.{partner}" in value:
            names = (p.name, f"{p.owner}.{partner}")
            said["meaning"] = both
        if kind == "direction":
            said["half_difference"] = 0.5 * (value[names[0]] - value[names[-1]])
        if kind == "load":
            said["into"] = "damping" if p.quantity == "load_speed" else "a constant loss"
            said["reference"] = float(at.reference[p.owner][0])
            said["reference_unit"] = NUMBERS["friction"].unit(chain)
        if p.quantity.startswith("stribeck") and "static_friction" in carries:
            kind = "static"
        found.append(Lost(kind, names, said))
    return tuple(found)


def law_lost(chain: Joint, vector: Array) -> tuple[Lost, ...]:
    """List what a law that is written out leaves out: what hangs on the recording."""
    return tuple(
        Lost("left out", (p.name,), {"value": value, "unit": p.unit, "meaning": p.meaning})
        for p, value in zip(chain.parameters, vector.tolist(), strict=True)
        if left_out(p.row) or _of_recording(p)
    )


def left_out(row: Quantity) -> bool:
    """Whether a term is none at 20 degC as a recording begins, so that a law does without it."""
    return bool(row.signal) or row.shape == "warming_time"


def _of_recording(p: Parameter) -> bool:
    """Whether it is one recording's own offset."""
    return p.owner == "" and p.name != "offset"


@dataclass(frozen=True, eq=False)
class Carried:
    """The numbers ``(n,)`` of a format, with what it has no number for folded into others."""

    values: dict[str, Array]
    lost: tuple[Lost, ...]


def carried(
    at: AtJoint, carries: Collection[str], motions: Sequence[Moved], chain: Joint
) -> Carried:
    """Fold what a format has no number for into numbers that it has, or leave it out.

    Parameters
    ----------
    at
        All numbers.
    carries
        Names of those the format has; those of link and drive, which the model around it brings,
        count as right.
    motions
        What a quadratic loss and a stiffening spring are replaced over.
    chain
        The joint, which turns or slides.
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
        if name in carries or name in AROUND or not np.any(here):
            continue
        if name == "static_friction":
            values[name] = values["friction"]
            continue
        values[name] = np.zeros_like(here)
        said: dict[str, Any] = {"number": name, "value": float(here[0]), "meaning": number.meaning}
        said |= {"unit": number.unit(chain), "into": ""}
        into, share = folds.get(name, ("", lambda: 0.0))
        if into in carries:
            amount = share() * here
            values[into] = values[into] + amount
            into_unit = NUMBERS[into].unit(chain)
            said |= {"into": into, "amount": float(amount[0]), "into_unit": into_unit}
        lost.append(Lost("number", at.made_from[name], said))
    return Carried(values, tuple(lost))


def _slope(x: Array, y: Array) -> float:
    """Slope of the line through zero that is nearest to ``y``."""
    size = float(x @ x)
    return float(x @ y) / size if size else 0.0
