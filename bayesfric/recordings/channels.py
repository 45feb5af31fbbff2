"""Channels: raw columns to joint and motor quantities in SI units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayesfric.errors import BadInput
from bayesfric.recordings import units
from bayesfric.recordings.checks import unwrapped
from bayesfric.recordings.options import Channel, Position, Source, Velocity
from bayesfric.recordings.tables import Table

Motion = Literal["rotary", "linear"]

POSITION: dict[Motion, units.Kind] = {"rotary": "angle", "linear": "length"}
VELOCITY: dict[Motion, units.Kind] = {"rotary": "angular_speed", "linear": "speed"}
TORQUE: dict[Motion, units.Kind] = {"rotary": "torque", "linear": "force"}
CONSTANT: dict[Motion, units.Kind] = {"rotary": "torque_constant", "linear": "force_constant"}


@dataclass(frozen=True)
class Drive:
    """What turns motor quantities into joint quantities.

    Parameters
    ----------
    ratio
        Motor motion per joint motion.
    motion, motor_motion
        Whether the joint and the motor turn or slide.
    """

    ratio: float
    motion: Motion
    motor_motion: Motion


def signed(channel: Channel, table: Table) -> NDArray[np.float64]:
    """Return a channel's raw numbers with their sign, before any factor.

    Parameters
    ----------
    channel
        The channel.
    table
        The file's columns.

    Returns
    -------
    numpy.ndarray
        Shape (n,).

    Raises
    ------
    BadInput
        If the column cannot be used, or does not hold unsigned numbers of the bits given.
    """
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


def scaled(
    channel: Channel, table: Table, kind: units.Kind, key: str, *more: str
) -> NDArray[np.float64]:
    """Return a channel in SI units.

    Parameters
    ----------
    channel
        The channel.
    table
        The file's columns.
    kind
        The kind of quantity it must be.
    key
        The channel's key in the source, for messages.
    *more
        Further constants with units to multiply by.

    Returns
    -------
    numpy.ndarray
        SI values, shape (n,).

    Raises
    ------
    BadInput
        If a column or a unit cannot be used.
    """
    texts = [channel.unit, *more]
    if channel.times is not None:
        texts.insert(1, channel.times_unit)
    factor = units.scale(texts, kind, f"{table.label(channel.column)}, unit of {key}")
    values = signed(channel, table)
    if channel.times is not None:
        further = table.column(channel.times)
        if len(further) != len(values):
            raise lengths(table, channel.times, len(further), channel.column, len(values))
        values = values * further
    return values * factor


def _side(channel: Position | Velocity, table: Table, key: str, drive: Drive) -> bool:
    """Tell whether a channel is on the motor's side."""
    if channel.side is None:
        if drive.ratio != 1 or drive.motion != drive.motor_motion:
            raise BadInput(
                table.label(channel.column),
                f"the {key}'s side is not given, and the gear ratio is {drive.ratio:g}"
                + ("" if drive.motion == drive.motor_motion else " from turning to sliding"),
                'set side = "motor" or side = "joint"',
            )
        return False
    return channel.side == "motor"


def joint_signal(
    channel: Position | Velocity, table: Table, drive: Drive
) -> tuple[NDArray[np.float64], str]:
    """Return the joint's position or velocity, and how it came about.

    Parameters
    ----------
    channel
        The position or velocity channel, of motor or joint.
    table
        The file's columns.
    drive
        Ratio and motions.

    Returns
    -------
    values : numpy.ndarray
        Of the joint, rad or m, or rad/s or m/s, shape (n,).
    step : str
        One sentence.

    Raises
    ------
    BadInput
        If the side is needed but not given, or a column or unit cannot be used.
    """
    key, kinds = ("position", POSITION) if isinstance(channel, Position) else ("velocity", VELOCITY)
    motor = _side(channel, table, key, drive)
    motion = drive.motor_motion if motor else drive.motion
    values = scaled(channel, table, kinds[motion], key)
    step = f"{key}: of the motor, divided by {drive.ratio:g}" if motor else f"{key}: of the joint"
    if isinstance(channel, Position) and motion == "rotary":
        values, jumps = unwrapped(values)
        if jumps:
            step += f"; jumps by a turn at {jumps} places, unwrapped"
    return values / drive.ratio if motor else values, step


def drive_signal(
    source: Source, table: Table, drive: Drive
) -> tuple[Channel, NDArray[np.float64], str]:
    """Return the channel that drives the joint, with its signal.

    Parameters
    ----------
    source
        Exactly one of its torque, current and voltage is given.
    table
        The file's columns.
    drive
        Ratio and motions.

    Returns
    -------
    channel : Channel
        The channel.
    values : numpy.ndarray
        Motor torque in N m or N, or voltage in V, shape (n,).
    what : str
        What the channel measures: torque, force, current or voltage.

    Raises
    ------
    BadInput
        If a column, unit or constant cannot be used.
    """
    kind = TORQUE[drive.motor_motion]
    if source.torque is not None:
        constant = [] if source.torque.constant is None else [source.torque.constant]
        return source.torque, scaled(source.torque, table, kind, kind, *constant), kind
    if source.current is not None:
        current = scaled(source.current, table, "current", "current")
        return source.current, current * _constant(source.current, table, drive), "current"
    if source.voltage is not None:
        return source.voltage, scaled(source.voltage, table, "voltage", "voltage"), "voltage"
    raise BadInput(
        str(table.path), "has no drive channel", "give one of torque, current and voltage"
    )


def _constant(channel: Channel, table: Table, drive: Drive) -> float:
    text = str(getattr(channel, "torque_constant", ""))
    kind = CONSTANT[drive.motor_motion]
    return units.parse(text, kind, f"{table.label(channel.column)}, torque_constant")


def check_columns(source: Source, table: Table) -> None:
    """Refuse one column as two signals.

    Raises
    ------
    BadInput
        Naming both channels.
    """
    channels = {
        key: channel
        for key in ("time", "position", "velocity", "torque", "current", "voltage")
        if (channel := getattr(source, key)) is not None
    }
    seen: dict[int, str] = {}
    for key, channel in channels.items():
        before = seen.setdefault(table.place(channel.column), key)
        if before != key:
            raise BadInput(
                table.label(channel.column),
                f"is taken both for {before} and for {key}",
                f"name another column for {key}",
            )


def same_length(
    channel: Channel,
    values: NDArray[np.float64],
    other: Channel,
    others: NDArray[np.float64],
    table: Table,
) -> None:
    """Refuse two channels of different length.

    Parameters
    ----------
    channel, values
        One channel and its values, shape (n,).
    other, others
        The other channel and its values, shape (m,).
    table
        The file's columns.

    Raises
    ------
    BadInput
        If n is not m.
    """
    if len(values) != len(others):
        raise lengths(table, channel.column, len(values), other.column, len(others))


def lengths(table: Table, column: str | int, count: int, other: str | int, others: int) -> BadInput:
    """Return the error for two columns of different length.

    Parameters
    ----------
    table
        The file's columns.
    column, count
        One column and its length.
    other, others
        The other column and its length.

    Returns
    -------
    BadInput
        Naming both.
    """
    return BadInput(
        table.label(column),
        f"has {count} values, column '{other}' has {others}",
        "give columns of one length",
    )
