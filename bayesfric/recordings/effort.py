"""The motor's torque, from whatever was recorded of it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from bayesfric.base.errors import BadInput, Unfit
from bayesfric.recordings import channels, units
from bayesfric.recordings.channels import CONSTANT, POSITION, TORQUE, VELOCITY, Drive
from bayesfric.recordings.drive_law import Law
from bayesfric.recordings.source import Columns, Effort, Target
from bayesfric.recordings.tables.table import Table


class _Gives(NamedTuple):
    """What a position controller's gains are per angle of, and what makes a torque of it."""

    what: str
    measured: str  # as which kind of measurement it counts
    kind: units.Kind
    constants: tuple[str, ...]


_LAWS = {
    "force": _Gives("force", "force", "force", ()),
    "torque": _Gives("torque", "torque", "torque", ()),
    "current": _Gives("current", "current", "current", ("torque_constant",)),
    "voltage": _Gives("voltage", "voltage", "voltage", ("torque_constant", "resistance")),
    "share": _Gives("duty", "voltage", "share", ("torque_constant", "resistance", "times")),
}


class Told(NamedTuple):
    """What a recording tells of its torque; the law is on the file's stamps."""

    channel: Effort
    kind: str  # what was measured: torque, force, current or voltage
    law: Law
    step: str  # how the torque comes about
    torque_constant: float | None = None  # torque per current, of a measured current
    made_of: Mapping[str, str] = MappingProxyType({})  # as a measurement has it


def measured_law(source: Columns, table: Table, drive: Drive) -> Told:
    """Take the torque from what was measured of it, or from the position aimed at."""
    kind = TORQUE[drive.motor_motion]
    constant_kind = CONSTANT[drive.motor_motion]
    if source.torque is not None:
        constant = [] if source.torque.constant is None else [source.torque.constant]
        torque = channels.scaled(source.torque, table, kind, kind, *constant)
        step, made_of = f"{kind}: as measured", dict[str, str]()
        if source.torque.constant is not None:
            made_of = {"signal_unit": source.torque.unit, "signal_constant": constant[0]}
            step = f"{kind}: the signal in {source.torque.unit} times {constant[0]}"
            if constant[0].endswith("/V"):
                step += "; if that is the motor's own voltage, its back-EMF counts as viscous "
                step += "loss, and the key voltage takes it off"
        law = Law(torque, np.ones(torque.shape))
        return Told(source.torque, kind, law, step, made_of=made_of)
    if source.current is not None:
        current = channels.scaled(source.current, table, "current", "current")
        where = f"{table.label(source.current.column)}, torque_constant"
        factor = units.scale([source.current.torque_constant], constant_kind, where)
        law = Law(current * factor, np.ones(current.shape))
        step = f"{kind}: current times {source.current.torque_constant}"
        return Told(source.current, "current", law, step, factor)
    if source.voltage is None:
        assert source.target is not None
        return position_law(source.target, table, drive)
    voltage = channels.scaled(source.voltage, table, "voltage", "voltage")
    factor = units.scale([source.voltage.torque_constant], constant_kind)
    resistance = units.scale([source.voltage.resistance], "resistance")
    law = Law(
        voltage,
        np.full(voltage.shape, factor / resistance),
        back_emf=factor**2 * drive.ratio / resistance,
    )
    step = (
        f"{kind}: kt V/R - kt^2 (motor speed)/R with kt = {source.voltage.torque_constant}, "
        f"R = {source.voltage.resistance}"
    )
    made_of = {
        "motor_constant": source.voltage.torque_constant,
        "motor_resistance": source.voltage.resistance,
    }
    return Told(source.voltage, "voltage", law, step, made_of=made_of)


def position_law(target: Target, table: Table, drive: Drive) -> Told:
    """Read the law of a drive that goes for a position.

    What the gains are per angle of says what the law gives: the motor's torque, current, voltage,
    or the duty of a supply.
    """
    where = table.label(target.column)
    side = drive.motor_motion if target.side == "motor" else drive.motion
    # what it is multiplied by is the supply, and comes later
    alone = target.model_copy(update={"times": None})
    aimed, _ = channels.joint_signal(alone, "target", table, drive)
    gives, kp = _gain(target.kp, units.si(POSITION[side]), drive, f"{where}, kp")
    missing = [key for key in gives.constants if getattr(target, key) is None]
    if missing:
        what = f"is not given, and kp = '{target.kp}' makes a {gives.what}"
        raise BadInput(f"{where}, {missing[0]}", what, f"add {missing[0]} = ...")
    kd = 0.0
    if target.kd is not None:
        other, kd = _gain(target.kd, units.si(VELOCITY[side]), drive, f"{where}, kd")
        if other is not gives:
            what = f"makes a {other.what}, and kp a {gives.what}"
            raise BadInput(f"{where}, kd", what, "give both per angle and per speed of the same")
    limit = np.inf
    if target.limit is not None:
        limit = units.scale([target.limit], gives.kind, f"{where}, limit")
    to_side = drive.ratio if target.side == "motor" else 1.0
    scale, back_emf = np.ones(aimed.shape), 0.0
    told = f"{TORQUE[drive.motor_motion]}: kp = {target.kp} towards column '{target.column}'"
    if gives.constants:
        assert target.torque_constant is not None
        kind = CONSTANT[drive.motor_motion]
        constant = units.scale([target.torque_constant], kind, f"{where}, torque_constant")
        scale = scale * constant
        if gives.what != "current":
            assert target.resistance is not None
            resistance = units.scale([target.resistance], "resistance", f"{where}, resistance")
            scale = scale / resistance
            back_emf = constant**2 * drive.ratio / resistance
            told += f", kt = {target.torque_constant}, R = {target.resistance}"
        if gives.what == "duty":
            assert target.times is not None
            unit = units.scale([target.times_unit], "voltage", f"{where}, times_unit")
            scale = scale * table.column(target.times) * unit
    kp, kd = kp * to_side, kd * to_side
    law = Law(kp * aimed, scale, kp, kd, limit, back_emf)
    return Told(target, gives.measured, law, told)


def _gain(text: str, per: str, drive: Drive, where: str) -> tuple[_Gives, float]:
    """Read a gain per angle or speed, and of what."""
    names = [TORQUE[drive.motor_motion], "current", "voltage", "share"]
    for name in names:
        try:
            return _LAWS[name], units.product([text, per], [_LAWS[name].kind])
        except Unfit:
            continue
    wanted = ", ".join(f"'{unit}/({per})'" for unit in ("N m", "A", "V", "1"))
    raise BadInput(where, f"'{text}' is no gain", f"give it in one of {wanted}")
