"""The motor's torque, from whatever was recorded of it."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from bayesfric.base.errors import BadInput, Unfit
from bayesfric.recordings import channels, units
from bayesfric.recordings.channels import CONSTANT, POSITION, TORQUE, VELOCITY, Drive
from bayesfric.recordings.drive_law import Law
from bayesfric.recordings.source import Columns, Current, Effort, Target, Voltage
from bayesfric.recordings.tables.table import Table

# What makes a torque of what a controller gives.
_NEEDED: dict[units.Kind, tuple[str, ...]] = {
    "current": ("torque_constant",),
    "voltage": ("torque_constant", "resistance"),
    # of a supply
    "share": ("torque_constant", "resistance", "times"),
}


class Told(NamedTuple):
    """What a recording tells of its torque; the law is on the file's stamps."""

    channel: Effort
    kind: str  # what was measured: torque, force, current or voltage
    law: Law
    step: str  # how the torque comes about
    torque_constant: float | None = None  # torque per current, of a measured current


def measured_law(source: Columns, table: Table, drive: Drive) -> Told:
    """Take the torque from what was measured of it, or from the position aimed at."""
    kind = TORQUE[drive.motor_motion]
    if (one := source.torque) is not None:
        constant = [] if one.constant is None else [one.constant]
        torque = channels.scaled(one, table, kind, kind, *constant)
        step = f"{kind}: the signal in {one.unit} times {one.constant}"
        if constant and constant[0].endswith("/V"):
            step += "; if that is the motor's own voltage, its back-EMF counts as viscous "
            step += "loss, and the key voltage takes it off"
        step = step if constant else f"{kind}: as measured"
        return Told(one, kind, Law(torque, np.ones(torque.shape), held=bool(one.held)), step)
    measured: tuple[tuple[units.Kind, Current | Voltage | None], ...]
    measured = ("current", source.current), ("voltage", source.voltage)
    for gives, channel in measured:
        if channel is not None:
            command = channels.scaled(channel, table, gives, gives)
            scale, back_emf, how = _motor(gives, channel, table, drive)
            if gives == "current":
                law = Law(command * scale, np.ones(command.shape), held=bool(channel.held))
                return Told(channel, gives, law, f"{kind}: {how}", scale)
            factor = np.full(command.shape, scale)
            law = Law(command, factor, back_emf=back_emf, held=bool(channel.held))
            return Told(channel, gives, law, f"{kind}: {how}")
    assert source.target is not None
    return position_law(source.target, table, drive)


def position_law(target: Target, table: Table, drive: Drive) -> Told:
    """Read the law of a drive that goes for a position.

    What the gains are per angle of says what the law gives: the motor's torque, current, voltage,
    or the duty of a supply.
    """
    where, kind = table.label(target.column), TORQUE[drive.motor_motion]
    motion = drive.motor_motion if target.side == "motor" else drive.motion
    # what it is multiplied by is the supply, and comes later
    alone = target.model_copy(update={"times": None})
    aimed, _ = channels.joint_signal(alone, "target", table, drive)
    gives, kp = _gain(target.kp, POSITION[motion], (kind, *_NEEDED), f"{where}, kp")
    missing = [key for key in _NEEDED.get(gives, ()) if getattr(target, key) is None]
    if missing:
        what = f"is not given, and kp = '{target.kp}' needs it"
        raise BadInput(f"{where}, {missing[0]}", what, f"add {missing[0]} = ...")
    kd, limit = 0.0, np.inf
    if target.kd is not None:
        _, kd = _gain(target.kd, VELOCITY[motion], (gives,), f"{where}, kd")
    if target.limit is not None:
        limit = units.scale([target.limit], gives, f"{where}, limit")
    to_side = drive.ratio if target.side == "motor" else 1.0
    factor, back_emf, how = _motor(gives, target, table, drive)
    scale = np.full(aimed.shape, factor)
    if gives == "share" and target.times is not None:
        unit = units.scale([target.times_unit], "voltage", f"{where}, times_unit")
        scale = scale * table.column(target.times) * unit
    kp, kd = kp * to_side, kd * to_side
    # a mean over the sample is held by nobody
    held = bool(target.held) and target.sampled == "instant"
    law = Law(kp * aimed, scale, kp, kd, limit, back_emf, held=held)
    step = f"{kind}: kp = {target.kp} towards column '{target.column}'"
    step += f"; {how}" if how else ""
    return Told(target, "voltage" if gives == "share" else gives, law, step)


def _motor(
    gives: units.Kind, channel: Current | Voltage | Target, table: Table, drive: Drive
) -> tuple[float, float, str]:
    """Give the motor's torque for one of what drives it, and for a speed; and how, in words."""
    if gives not in _NEEDED:
        return 1.0, 0.0, ""
    assert channel.torque_constant is not None
    where, kind = table.label(channel.column), CONSTANT[drive.motor_motion]
    constant = units.scale([channel.torque_constant], kind, f"{where}, torque_constant")
    if gives == "current" or isinstance(channel, Current):
        return constant, 0.0, f"current times {channel.torque_constant}"
    assert channel.resistance is not None
    resistance = units.scale([channel.resistance], "resistance", f"{where}, resistance")
    how = f"kt V/R - kt^2 (motor speed)/R with kt = {channel.torque_constant}, "
    how += f"R = {channel.resistance}"
    return constant / resistance, constant**2 * drive.ratio / resistance, how


def _gain(
    text: str, per: units.Kind, kinds: Sequence[units.Kind], where: str
) -> tuple[units.Kind, float]:
    """Read a gain per angle or speed, and of which kind it is."""
    for kind in kinds:
        with suppress(Unfit):
            return kind, units.product([text, units.si(per)], [kind])
    wanted = ", ".join(f"'{units.si(kind) or 1}/({units.si(per)})'" for kind in kinds)
    raise BadInput(where, f"'{text}' is no gain", f"give it in one of {wanted}")
