"""Channels: raw columns to joint and motor quantities in SI units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.recordings import checks, units
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.source import SI, Channel, Columns, Position, Torque, Velocity
from bayesfric.recordings.tables.table import Table

Motion = Literal["rotary", "linear"]

POSITION: dict[Motion, units.Kind] = {"rotary": "angle", "linear": "length"}
VELOCITY: dict[Motion, units.Kind] = {"rotary": "angular_speed", "linear": "speed"}
TORQUE: dict[Motion, units.Kind] = {"rotary": "torque", "linear": "force"}
CONSTANT: dict[Motion, units.Kind] = {"rotary": "torque_constant", "linear": "force_constant"}
# Units in which no measured signal of a joint is a row of whole numbers.
_NOT_COUNTED = {SI, "s", "rad", "m", "rad/s", "m/s", "N m", "Nm", "N", "A", "V"}
# Zero degrees Celsius in each unit.
_ZERO = {"degC": 0.0, "°C": 0.0, "K": 273.15, SI: 273.15}


@dataclass(frozen=True)
class Drive:
    """Motor motion per joint motion, and whether the joint and the motor turn or slide."""

    ratio: float
    motion: Motion
    motor_motion: Motion


def check_columns(source: Columns, table: Table) -> None:
    """Refuse a column that cannot be used, one taken for two signals, and different lengths."""
    first = source.position.column
    count = len(table.column(first))
    seen: dict[tuple[int, int | None], str] = {}
    for key, channel in source.channels.items():
        before = seen.setdefault(table.place(channel.column), key)
        if before != key:
            what = f"is taken both for {before} and for {key}"
            raise BadInput(table.label(channel.column), what, f"name another column for {key}")
    for column in source.columns:
        if len(table.column(column)) != count:
            what = f"has {len(table.column(column))} values, column '{first}' has {count}"
            raise BadInput(table.label(column), what, "give columns of one length")


def signed(channel: Channel, table: Table) -> Array:
    """Return a channel's raw numbers with their sign, before any factor, shape (n,)."""
    values = table.column(channel.column)
    if channel.twos_complement is not None:
        full = 2.0**channel.twos_complement
        wrong = (values < 0) | (values >= full) | (values != np.floor(values))
        if wrong.any():
            index = int(np.argmax(wrong))
            raise BadInput(
                f"{table.label(channel.column)}, {table.row(index)}",
                f"{values[index]:g} is no unsigned number of {channel.twos_complement} bits",
                "correct or leave out twos_complement",
            )
        values = np.where(values >= full / 2, values - full, values)
    return values * channel.sign


def scaled(channel: Channel, table: Table, kind: units.Kind, key: str, *more: str) -> Array:
    """Return a channel of a kind in SI units, shape (n,), times further constants with units."""
    texts = [channel.unit, *more]
    if channel.times is not None:
        texts.insert(1, channel.times_unit)
    both = " and times_unit" if channel.times is not None else ""
    where = f"{table.label(channel.column)}, unit{both} of {key}"
    factor = 1.0 if texts == [SI] else units.scale(texts, kind, where)
    values = signed(channel, table)
    if channel.times is not None:
        values = values * table.column(channel.times)
    return values * factor


def joint_signal(channel: Position, key: str, table: Table, drive: Drive) -> tuple[Array, str]:
    """Return the joint's position or velocity in SI units, shape (n,), and how it came about."""
    if channel.side is None and (drive.ratio != 1 or drive.motion != drive.motor_motion):
        raise BadInput(
            table.label(channel.column),
            f"the {key}'s side is not given, and the gear ratio is {drive.ratio:g}"
            + ("" if drive.motion == drive.motor_motion else " from turning to sliding"),
            'set side = "motor" or side = "joint"',
        )
    motor = channel.side == "motor"
    motion = drive.motor_motion if motor else drive.motion
    kinds = VELOCITY if isinstance(channel, Velocity) else POSITION
    values = scaled(channel, table, kinds[motion], key)
    step = f"{key}: of the motor, divided by {drive.ratio:g}" if motor else f"{key}: of the joint"
    if kinds is POSITION and motion == "rotary":
        values, jumps = checks.unwrapped(values)
        if jumps:
            step += f"; jumps by a turn at {jumps} places, unwrapped"
    return values / drive.ratio if motor else values, step


def counts(source: Columns, table: Table, part: slice) -> list[str]:
    """Warn of whole numbers in a unit that is not counted in."""
    found = []
    for key, channel in source.channels.items():
        if channel.unit not in _NOT_COUNTED or channel.times is not None or key == "temperature":
            continue
        constant = channel.constant if isinstance(channel, Torque) else None
        if constant is None and checks.whole_numbers(table.column(channel.column)[part]):
            what = "thousandths" if key == "time" else "encoder counts, or thousandths"
            found.append(
                f"{key}: all numbers are whole, and its unit is {channel.unit}: are they {what}? "
                "Its unit is what a raw 1 is worth"
            )
    return found


def temperature(channel: Channel, table: Table) -> Array:
    """Return the joint's temperature in degrees Celsius, shape (n,)."""
    if channel.unit not in _ZERO:
        raise BadInput(
            f"{table.label(channel.column)}, unit of temperature",
            f"'{channel.unit}' is no temperature",
            "write 'degC' or 'K'",
        )
    degrees = signed(channel, table) - _ZERO[channel.unit]
    checks.check_size(degrees, table.label(channel.column), "temperature")
    return degrees


def load_torque(channel: Channel, table: Table, drive: Drive) -> Array:
    """Return a torque or force from outside that acts on the load, N m or N, shape (n,)."""
    values = scaled(channel, table, TORQUE[drive.motion], "load_torque")
    checks.check_size(values, table.label(channel.column), "load torque")
    return values
