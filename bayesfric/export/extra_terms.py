"""What of a joint a format carries, what it loses, and what is put in the place of that."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np

from bayesfric.export.joint_model import NUMBERS, RISES, AtJoint, Moved, as_losses, moving, places
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.parameter import Parameter
from bayesfric.mechanism.quantities import Quantity
from bayesfric.recordings.arrays import Array

# What is of the link and of the drive: a format of joints leaves these to the model around it.
AROUND = ("link_inertia", "link_moment", "link_gravity_angle", "gain", "torque_offset")


# One thing that a format cannot carry: its `kind`, by which ``templates/lost.txt.j2`` says what was
# put in its place, its `parameters`, and the numbers that are said of it, in the units named.
Lost = dict[str, Any]

# Told with the row before them, and what both are.
_PARTNERS = {
    "coulomb_positive": ("coulomb_negative", "constant loss by direction"),
    "viscous_positive": ("viscous_negative", "viscous loss by direction"),
    "load_drive": ("load_back", "loss per transmitted torque, driving and back-driven"),
}


def lost_terms(
    chain: Joint, at: AtJoint, vector: Array, carries: Collection[str], keeps: Collection[str] = ()
) -> list[Lost]:
    """List what simulators' joints do not have, at one parameter vector ``(d,)``.

    ``carries`` are the numbers that a format has, ``keeps`` the quantities.
    """
    value = dict(zip(chain.names, vector.tolist(), strict=True))
    found = []
    for p in chain.parameters:
        kind = _kind(p)
        if not kind or p.quantity in keeps:
            continue
        said = _said(p, value[p.name])
        names = [p.name]
        if kind == "fitted":
            said["static"] = p.quantity in RISES and "static_friction" in carries
            for number, x in zip(("friction", "damping"), at.fitted[p.name], strict=True):
                said |= {number: float(x[0]), f"{number}_unit": NUMBERS[number].unit(chain)}
        partner, both = _PARTNERS.get(p.quantity, ("", ""))
        if f"{p.owner}.{partner}" in value:
            names.append(f"{p.owner}.{partner}")
            said["meaning"] = both
        if kind == "direction":
            said["half_difference"] = 0.5 * (value[names[0]] - value[names[-1]])
        if kind == "load":
            said["into"] = "damping" if p.quantity == "load_speed" else "a constant loss"
            said["reference"] = float(at.reference[p.owner][0])
            said["reference_unit"] = NUMBERS["friction"].unit(chain)
        found.append({"kind": kind, "parameters": names, **said})
    return found


def _kind(p: Parameter) -> str:
    """Give the kind of loss of a term that no simulator's joint has a number for, or none."""
    if _of_recording(p) or p.quantity == "delay":
        return "left out"
    if not places(p) or p.quantity in RISES:
        return "fitted"
    if p.quantity in ("coulomb_positive", "viscous_positive"):
        return "direction"
    if p.quantity in ("load", "load_drive", "load_speed", "load_square"):
        return "load"
    return "left out" if p.row.role == "form" and p.row.option.startswith("load_") else ""


def law_lost(chain: Joint, vector: Array) -> list[Lost]:
    """List what a law that is written out leaves out: what hangs on the recording."""
    return [
        {"kind": "left out", "parameters": [p.name], **_said(p, x)}
        for p, x in zip(chain.parameters, vector.tolist(), strict=True)
        if left_out(p.row) or _of_recording(p)
    ]


def _said(p: Parameter, value: float) -> Lost:
    return {"value": value, "unit": p.unit, "meaning": p.meaning}


def left_out(row: Quantity) -> bool:
    """Whether a term is none at 20 degC as a recording begins, so that a law does without it."""
    return bool(row.signal) or row.shape == "warming_time"


def _of_recording(p: Parameter) -> bool:
    """Whether it is one recording's own offset."""
    return p.owner == "" and p.name != "offset"


def carried(
    at: AtJoint,
    carries: Collection[str],
    motions: Sequence[Moved],
    chain: Joint,
    keeps: Collection[str] = (),
) -> tuple[dict[str, Array], list[Lost]]:
    """Fold what a format has no number for into numbers that it has ``(n,)``, or leave it out.

    Parameters
    ----------
    at
        All numbers.
    carries
        Names of those the format has; those of link and drive, which the model around it brings,
        count as right.
    motions
        What rises at low speed, a quadratic loss and a stiffening spring are replaced over.
    chain
        The joint, which turns or slides.
    keeps
        Quantities that the format has in its own way.
    """
    values = dict(at.values)
    lost = []
    place, speed, _ = moving(motions)
    rises = [p.name for p in chain.parameters if p.quantity in RISES - {*keeps}]
    for name in rises:
        constant, damping = at.fitted[name]
        values["friction"] = values["friction"] + constant
        values["damping"] = values["damping"] + damping
    if rises:
        values |= as_losses(values, motions)
        values["static_friction"] = np.maximum(values["static_friction"], values["friction"])
    folds: dict[str, tuple[str, Callable[[], float]]] = {
        "armature": ("link_inertia", lambda: 1.0),
        "quadratic": ("damping", lambda: _slope(speed, speed * abs(speed))),
        "friction": ("damping", lambda: _slope(speed, np.sign(speed))),
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
        said: Lost = {"number": name, "value": float(here[0]), "meaning": number.meaning}
        said |= {"unit": number.unit(chain), "into": ""}
        into, share = folds.get(name, ("", lambda: 0.0))
        if into in carries:
            amount = share() * here
            values[into] = values[into] + amount
            into_unit = NUMBERS[into].unit(chain)
            said |= {"into": into, "amount": float(amount[0]), "into_unit": into_unit}
        lost.append({"kind": "number", "parameters": list(at.made_from[name]), **said})
    return values, lost


def _slope(x: Array, y: Array) -> float:
    """Slope of the line through zero that is nearest to ``y``."""
    size = float(x @ x)
    return float(x @ y) / size if size else 0.0
