"""Terms of a joint that a format has no number for: lost, or replaced by other numbers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np

from bayesfric.export.joint_model import (
    NUMBERS,
    STRIBECK,
    JointModel,
    Trajectory,
    has_number,
    nonnegative_losses,
    stacked,
)
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import Parameter, Quantity
from bayesfric.recordings.arrays import Array

# Numbers of link and drive, which a format of joints leaves to the surrounding model.
LINK_AND_DRIVE = ("link_inertia", "link_moment", "link_gravity_angle", "gain", "torque_offset")

# A term that a format loses: its `kind`, by which ``templates/lost.txt.j2`` names the replacement,
# its `parameters`, and numbers with their units.
Lost = dict[str, Any]

# Parameters that are listed together with another, and the meaning of both.
_PARTNERS = {
    "coulomb_positive": ("coulomb_negative", "constant loss by direction"),
    "viscous_positive": ("viscous_negative", "viscous loss by direction"),
    "load_drive": ("load_back", "loss per transmitted torque, driving and back-driven"),
}


def lost_terms(
    chain: Joint,
    model: JointModel,
    vector: Array,
    carries: Collection[str],
    keeps: Collection[str] = (),
) -> list[Lost]:
    """List the terms of a vector ``(d,)`` that simulators' joints do not have.

    ``carries`` are the numbers that a format has, ``keeps`` quantities that it has in addition.
    """
    value = dict(zip(chain.names, vector.tolist(), strict=True))
    lost = []
    for p in chain.parameters:
        kind = _kind(p)
        if not kind or p.quantity in keeps:
            continue
        names, details = [p.name], _details(p, value[p.name])
        if kind == "fitted":
            details["static"] = p.quantity in STRIBECK and "static_friction" in carries
            for number, x in zip(("friction", "damping"), model.fitted[p.name], strict=True):
                details |= {number: float(x[0]), f"{number}_unit": NUMBERS[number].unit(chain)}
        partner, meaning = _PARTNERS.get(p.quantity, ("", ""))
        if f"{p.owner}.{partner}" in value:
            names.append(f"{p.owner}.{partner}")
            details["meaning"] = meaning
        if kind == "direction":
            details["half_difference"] = 0.5 * (value[names[0]] - value[names[-1]])
        if kind == "load":
            details["into"] = "damping" if p.quantity == "load_speed" else "a constant loss"
            details["reference"] = float(model.reference[p.owner][0])
            details["reference_unit"] = NUMBERS["friction"].unit(chain)
        lost.append({"kind": kind, "parameters": names, **details})
    return lost


def _kind(p: Parameter) -> str:
    """Classify the loss of a term; empty if simulators' joints have a number for it."""
    if _of_recording(p) or p.quantity == "delay":
        return "left out"
    if not has_number(p) or p.quantity in STRIBECK:
        return "fitted"
    if p.quantity in ("coulomb_positive", "viscous_positive"):
        return "direction"
    if p.quantity in ("load", "load_drive", "load_speed", "load_square"):
        return "load"
    return "left out" if p.row.role == "form" and p.row.option.startswith("load_") else ""


def lost_by_law(chain: Joint, vector: Array) -> list[Lost]:
    """List the terms that the written law omits: those that depend on the recording."""
    return [
        {"kind": "left out", "parameters": [p.name], **_details(p, x)}
        for p, x in zip(chain.parameters, vector.tolist(), strict=True)
        if omitted(p.row) or _of_recording(p)
    ]


def _details(p: Parameter, value: float) -> Lost:
    return {"value": value, "unit": p.unit, "meaning": p.meaning}


def omitted(row: Quantity) -> bool:
    """Whether a term is zero at 20 degC at the start of a recording, so that a law omits it."""
    return bool(row.signal) or row.shape == "warming_time"


def _of_recording(p: Parameter) -> bool:
    """Whether it is the separate offset of a recording."""
    return p.owner == "" and p.name != "offset"


def fold_extra_terms(
    model: JointModel,
    carries: Collection[str],
    motions: Sequence[Trajectory],
    chain: Joint,
    keeps: Collection[str] = (),
) -> tuple[dict[str, Array], list[Lost]]:
    """Fold numbers that a format lacks into those that it ``carries``, or drop them.

    Stribeck terms, quadratic friction and a stiffening spring are fitted over ``motions``;
    ``keeps`` are quantities that the format has in its own way. Returns numbers ``(n,)``, and what
    is lost.
    """
    values = dict(model.values)
    lost = []
    position, speed, _ = stacked(motions)
    stribeck = [p.name for p in chain.parameters if p.quantity in STRIBECK - {*keeps}]
    for name in stribeck:
        constant, damping = model.fitted[name]
        values["friction"] = values["friction"] + constant
        values["damping"] = values["damping"] + damping
    if stribeck:
        values |= nonnegative_losses(values, motions)
        values["static_friction"] = np.maximum(values["static_friction"], values["friction"])
    folds: dict[str, tuple[str, Callable[[], float]]] = {
        "armature": ("link_inertia", lambda: 1.0),
        "quadratic": ("damping", lambda: _slope(speed, speed * abs(speed))),
        "friction": ("damping", lambda: _slope(speed, np.sign(speed))),
        "stiffness_cubic": ("stiffness", lambda: _slope(position, position**3)),
    }
    for name, number in NUMBERS.items():
        value = values[name]
        if name in carries or name in LINK_AND_DRIVE or not np.any(value):
            continue
        if name == "static_friction":
            values[name] = values["friction"]
            continue
        values[name] = np.zeros_like(value)
        details: Lost = {"number": name, "value": float(value[0]), "meaning": number.meaning}
        details |= {"unit": number.unit(chain), "into": ""}
        into, share = folds.get(name, ("", lambda: 0.0))
        if into in carries:
            amount = share() * value
            values[into] = values[into] + amount
            into_unit = NUMBERS[into].unit(chain)
            details |= {"into": into, "amount": float(amount[0]), "into_unit": into_unit}
        lost.append({"kind": "number", "parameters": list(model.made_from[name]), **details})
    return values, lost


def _slope(x: Array, y: Array) -> float:
    """Fit the line through zero that is nearest to ``y``."""
    size = float(x @ x)
    return float(x @ y) / size if size else 0.0
