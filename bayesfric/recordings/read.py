"""From files and tables in memory to measurements in SI units on the joint side."""

from __future__ import annotations

import glob
import hashlib
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from bayesfric.base.errors import BadInput, Unfit
from bayesfric.recordings import checks, filters, units
from bayesfric.recordings.arrays import Array, Flags, pchip
from bayesfric.recordings.measurement import (
    Grid,
    Inputs,
    Lag,
    Law,
    Measurement,
    Signal,
    integral,
    make_grid,
    steady_grid,
)
from bayesfric.recordings.readers import is_recording, read_table, sha256
from bayesfric.recordings.source import (
    SI,
    Channel,
    Columns,
    Current,
    Effort,
    Filtered,
    Position,
    Processing,
    Recording,
    Source,
    Target,
    Torque,
    Velocity,
    Voltage,
)
from bayesfric.recordings.tables import Table

Motion = Literal["rotary", "linear"]

POSITION: dict[Motion, units.Kind] = {"rotary": "angle", "linear": "length"}
VELOCITY: dict[Motion, units.Kind] = {"rotary": "angular_speed", "linear": "speed"}
TORQUE: dict[Motion, units.Kind] = {"rotary": "torque", "linear": "force"}
CONSTANT: dict[Motion, units.Kind] = {"rotary": "torque_constant", "linear": "force_constant"}
# Keys that turn what a controller gives into a torque.
_REQUIRED: dict[units.Kind, tuple[str, ...]] = {
    "current": ("torque_constant",),
    "voltage": ("torque_constant", "resistance"),
    "share": ("torque_constant", "resistance", "times"),  # of a supply voltage
}
# Channels of a bus, which may fail to be read, or whose sign may be a bit.
_MEASURED = ("position", "velocity", "torque", "current", "voltage")


@dataclass(frozen=True)
class Drive:
    """Motor motion per joint motion, and whether the joint and the motor turn or slide."""

    ratio: float
    motion: Motion
    motor_motion: Motion


def read_recordings(
    recording: Recording,
    *,
    ratio: float,
    motion: Motion,
    motor_motion: Motion = "rotary",
    processing: Processing,
    number: int = 1,
) -> list[Measurement]:
    """Read all files of a recording, sorted inside a pattern, or its table in memory.

    ``ratio`` is motor motion per joint motion (rad/rad, rad/m, ...); ``number`` names a table in
    memory without a name. The low-pass of ``processing`` is that of the motor's speed where a
    voltage was measured.
    """
    if not np.isfinite(ratio) or ratio == 0:
        raise BadInput("ratio", f"{ratio} is no gear ratio", "give a finite number other than 0")
    drive = Drive(ratio, motion, motor_motion)
    if isinstance(processing.dead_zone, str):
        units.scale([processing.dead_zone], VELOCITY[motion], "processing, dead_zone")
    source = recording.source
    if recording.table is not None:
        name = source.name or f"recording-{number}"
        table = replace(recording.table, where=f"recording {name!r}")
        measurement = filters.averaged_to(
            _read(source, table, drive, processing), recording.needed_rate
        )
        return [replace(measurement, name=name, sha256=_sha256(source, table))]
    assert isinstance(source, Source)
    measurements = []
    for path, name in _named_files(source, recording.folder):
        try:
            measurement = _read(source, read_table(path, source), drive, processing)
        except MemoryError as error:
            hint = "split it, or save fewer columns"
            raise BadInput(str(path), "needs more memory than there is", hint) from error
        measurements.append(replace(measurement, name=name, path=path, sha256=sha256(path)))
    return measurements


# what overflows is refused by its size
@np.errstate(all="ignore")
def _read(source: Columns, table: Table, drive: Drive, processing: Processing) -> Measurement:
    """Take a table's columns, check them, and bring them onto a uniform time base."""
    # columns
    source, table, time = aligned(source, table, drive)
    table, time, stale, pace, warnings = _as_measured(source, table, time)
    table = table.with_ones(len(time))
    steps, position, velocity = list(table.notes), None, None
    if source.position is not None:
        position, step = joint_signal(source.position, "position", table, drive)
        steps.append(step)
    if source.velocity is not None:
        velocity, step = joint_signal(source.velocity, "velocity", table, drive)
        steps.append(step)
    moved, signal = (velocity, "velocity") if position is None else (position, "position")
    assert moved is not None
    channel, kind, recorded, torque_step = _recorded_torque(source, table, drive)

    # checks
    chosen = slice(*chosen_rows(source, time, table.where))
    where = table.where
    grid = (
        steady_grid(len(time))
        if source.steady
        else make_grid(time, (chosen.start, chosen.stop), where)
    )
    checks.check_moves(moved[chosen], table.label(source.motion.column), signal)
    if channel.value is None and not (recorded.follows or np.ptp(recorded.command[chosen])):
        checks.check_moves(_signed(channel, table)[chosen], table.label(channel.column), kind)
    warnings += [
        *table.doubts(source.columns),
        *grid.warnings,
        *_count_warnings(source, table, chosen),
    ]
    for key, signed in source.channels.items():
        coded = None
        if key in _MEASURED and not source.steady:
            coded = checks.sign_code(_signed(signed, table)[chosen])
        if coded is not None:
            hint = f"where its sign is a bit, write {coded[0]} = {coded[1]}"
            raise BadInput(table.label(signed.column), f"{key}: {coded[2]}", hint)
    if not recorded.closed:
        warnings += checks.clipped(_signed(channel, table)[chosen], kind)
        if channel.sign == 1 and position is not None and source.voltage is None:
            label = table.label(channel.column)
            warnings += checks.unsigned(
                table.column(channel.column)[chosen], position[chosen], label
            )
    if (encoder_step := checks.quantisation(moved[chosen])) is not None:
        unit = ("rad" if drive.motion == "rotary" else "m") + "/s" * (position is None)
        steps.append(f"{signal}: read in steps of {encoder_step:.3g} {unit} at the joint")
    steps += grid.steps

    # arrays
    speed = None if velocity is None else grid.linear(velocity)
    if position is None:
        assert speed is not None
        joint = integral(speed, grid.segments, grid.period)
        steps += (
            []
            if source.steady
            else ["position: none; the velocity integrated, from 0 in every segment"]
        )
    else:
        joint = grid.smooth(position)
    law = recorded.on(grid)
    if channel.sampled != "instant":
        # position and speed pass the same averaging as the torque
        length = float(np.median(np.diff(time))) / grid.period
        shift = {"start": 0.5, "end": -0.5}.get(channel.sampled, 0.0) * length
        command = filters.delayed_command(law.command, grid.segments, shift, held=False)
        law = replace(law, command=command)
        joint = filters.averaged(joint, grid.segments, length)
        speed = None if speed is None else filters.averaged(speed, grid.segments, length)
        stamped = {"average": "the middle"}.get(channel.sampled, f"the {channel.sampled}")
        steps.append(f"{kind}: means over samples, stamped at {stamped}; position averaged alike")
    motor_speed = np.zeros(joint.shape) if speed is None else speed
    by_speed = channel.sign == "by-speed"
    if speed is None and (law.back_emf or law.kd or by_speed):
        motor_speed = _differentiated(joint, grid, processing)
    if by_speed:
        law = replace(law, command=law.command * np.sign(drive.ratio * motor_speed))
        torque_step += ", positive where it drives"
    torque = law.drives(joint, motor_speed)
    back_emf = law.back_emf * motor_speed if law.back_emf else None
    if back_emf is not None:
        torque = torque - back_emf
    steps.append(torque_step + _law_step(law, joint, motor_speed, measured=speed is not None))
    inputs = _inputs(source, table, drive, grid, steps)
    off, excluded = _excluded(source, table, grid, warnings)
    excluded |= grid.linear(stale.astype(np.float64)) > 0.0
    if source.steady and speed is not None:
        # a speed of a few of its steps is none
        excluded |= np.abs(speed) <= 3.5 * (checks.quantisation(speed) or 0.0)
    if law.closed and (~excluded).any():
        fault = checks.target_fault(law.command / law.kp, joint, ~excluded)
        if fault is not None:
            raise BadInput(table.label(channel.column), *fault)
    if excluded.any():
        steps.append(f"exclude: {int(excluded.sum())} of {len(excluded)} samples not compared")
    torque_constant = None
    if source.current is not None:
        torque_constant, *_ = _motor("current", source.current, table, drive)
    played = law if source.target is None else _target_law(source.target, table, drive)[0].on(grid)
    return Measurement(
        name="",
        path=None,
        sha256="",
        time=grid.time,
        position=joint,
        velocity=speed,
        torque=torque,
        back_emf=back_emf,
        feedback=law.kp * joint + law.kd * motor_speed if law.closed else None,
        segments=grid.segments,
        period=grid.period,
        excluded=excluded,
        inputs=inputs,
        steps=tuple(steps),
        warnings=tuple(warnings),
        held=bool(channel.held),
        torque_lag=_lag(channel),
        velocity_lag=_lag(source.velocity),
        motion=drive.motion,
        torque_constant=torque_constant,
        law=replace(played, off=off),
        integrated=position is None,
        steady=source.steady,
        ratio=drive.ratio,
        pace=pace,
    )


# --- columns ------------------------------------------------------------------------------------


def aligned(source: Columns, table: Table, drive: Drive) -> tuple[Columns, Table, Array]:
    """Bring all columns, decoded, to the rows and time stamps of the motion.

    Returns these stamps, too, in s since the recording's first.
    """
    first = source.motion.column
    channel_at: dict[tuple[int, int | None], str] = {}
    for key, channel in source.channels.items():
        other = channel_at.setdefault(table.place(channel.column), key)
        if other != key:
            problem = f"is taken both for {other} and for {key}"
            raise BadInput(table.label(channel.column), problem, f"name another column for {key}")
    clock = None
    if source.time is None:
        clocks = dict.fromkeys(c for column in source.columns if (c := table.clock(column)))
        if len(clocks) > 1:
            problem = f"its columns have time stamps of their own ({', '.join(clocks)})"
            raise BadInput(table.where, problem, "give time in place of rate")
    else:
        clock = source.time.column
        if clock in table.clocks.values():
            clock = table.clock(first) or clock
            timing = source.time.model_copy(update={"column": clock})
            source = source.model_copy(update={"time": timing})
        table = table.without_repeats(source.columns, clock)
    source, table = decoded(source, table, drive)
    time = recorded_time(source, table, table.values(first if clock is None else clock).size)
    stamps = time if clock is None else table.stamps(clock)
    table, rows = table.aligned(source.columns, first, clock, stamps, source.valid)
    return source, table, time[rows]


def decoded(source: Columns, table: Table, drive: Drive) -> tuple[Columns, Table]:
    """Decode signs and counters that wrap, and leave out failed reads, before any interpolation."""
    decoded, notes, update = dict[str | int, Array](), list[str](), dict[str, Channel]()
    wraps = dict[str, tuple[float, float, float]]()  # median, turn and SI unit of a raw 1
    for key, channel in source.channels.items():
        values, turn, factor = table.values(channel.column), None, 1.0
        if channel.twos_complement is not None:
            full = 2.0**channel.twos_complement
            values = np.where(values >= full / 2, values - full, values)
        if channel.sign_bit is not None:
            sign = 2.0**channel.sign_bit
            values = np.where(values >= sign, sign - values, values)
        if key in _MEASURED and not source.steady:
            # a motion does not jump; a drive may be off for longer
            longest = None if key in ("position", "velocity") else 5
            failed, code = checks.failed_reads(values, longest)
            if failed.any():
                values = np.where(failed, np.nan, values)
                where = f"failed reads: column {channel.column!r} is {code:.6g} between values "
                notes.append(f"{where}far from it in {int(failed.sum())} rows, left out")
        if isinstance(channel, Position) and not isinstance(channel, Velocity):
            motion = drive.motor_motion if channel.side == "motor" else drive.motion
            plain = channel.model_copy(update={"times": None})  # of a target it is the supply
            factor = _factor(plain, table, POSITION[motion], key)
            turn = 2.0 * np.pi / factor if motion == "rotary" else None
        if key in ("time", "position", "target") and np.isfinite(values).any():
            values, modulus, jumps = checks.unwrapped(values, turn)
            wraps[key] = (
                float(np.nanmedian(values)),
                modulus,
                factor * (-1 if channel.sign == -1 else 1),
            )
            if modulus:
                jump = "a turn" if modulus == turn else f"{modulus:.6g} counts"
                notes.append(f"{key}: jumps by {jump} at {jumps} places, unwrapped")
            elif jumps and key == "position":
                notes.append(f"position: jumps by half its range or more in {jumps} rows")
        if values is not table.values(channel.column):
            decoded[channel.column] = values
            update[key] = channel.model_copy(update={"twos_complement": None, "sign_bit": None})
    if wraps.keys() >= {"position", "target"} and source.position and source.target:
        # by whole turns near the position, which it was compared with before it was unwrapped
        (goal, modulus, unit), (middle, other, by) = wraps["target"], wraps["position"]
        size = max(modulus * abs(unit), other * abs(by))
        if size and source.target.side == source.position.side:
            turns = np.round((middle * by - goal * unit) / size)
            column = source.target.column
            decoded[column] = decoded.get(column, table.values(column)) + turns * size / unit
    return source.model_copy(update=update), table.decoded(decoded, notes)


def _as_measured(
    source: Columns, table: Table, time: Array
) -> tuple[Table, Array, Flags, float | None, list[str]]:
    """Leave rows out that repeat motion and torque; interpolate a signal between its own rows.

    Returns also the stamps, flags of rows that last longer than usual, the pace in Hz of the
    slowest signal, and warnings.
    """
    columns = {k: x.column for k, x in source.channels.items() if k in _MEASURED}
    signals = {key: table.values(column) for key, column in columns.items()}
    never, fresh = np.zeros(time.size, dtype=np.bool_), None
    if len({*signals} - {"position", "velocity"}) and np.ptp([*signals.values()][-1]):
        fresh = checks.fresh_rows([*signals.values()])
    if fresh is not None:
        rows, stale, hold = fresh
        if source.steady:
            rows, stale = rows[~stale], stale[~stale]
        text = f"time: values are held over {hold} rows; those that repeat are left out "
        text += f"({rows.size} of {time.size} remain), and not compared where they last longer"
        return table.at(rows, time.size), time[rows], stale, None, [text]
    between, notes, paces = dict[str | int, Array](), list[str](), list[float]()
    for key, values in signals.items() if not source.steady else ():
        if (measured_rows := checks.own_rows(values, time)) is not None:
            rows, how = measured_rows
            between[columns[key]] = pchip(time, time[rows], values[rows])
            notes.append(f"{key}: each value is {how}; interpolated between")
            paces.append(1.0 / float(np.median(np.diff(time[rows]))))
    return table.decoded(between, notes), time, never, min(paces, default=None), []


def _signed(channel: Channel, table: Table) -> Array:
    """Return a channel's decoded numbers with their sign, before any factor, shape (n,)."""
    return table.column(channel.column) * (1 if channel.sign == "by-speed" else channel.sign)


def _factor(channel: Channel, table: Table, kind: units.Kind, key: str, *constants: str) -> float:
    """Return the SI value of a channel's raw 1, or of its known value, times constants."""
    value = channel.value if isinstance(channel, Effort) else None
    if value == 0.0:  # in any unit
        return 0.0
    texts = [channel.unit if value is None else str(value), *constants]
    if channel.times is not None:
        texts.insert(1, channel.times_unit)
    both = " and times_unit" if channel.times is not None else ""
    where = f"{table.label(channel.column)}, unit{both} of {key}"
    if texts == [SI]:
        return 1.0
    return units.scale(texts, kind, where, positive=value is None)


def _scaled(channel: Channel, table: Table, kind: units.Kind, key: str, *constants: str) -> Array:
    """Return a channel in SI units, shape (n,), times constants with units."""
    factor, values = _factor(channel, table, kind, key, *constants), _signed(channel, table)
    if channel.times is not None:
        values = values * table.column(channel.times)
    return values * factor


def joint_signal(channel: Position, key: str, table: Table, drive: Drive) -> tuple[Array, str]:
    """Return the joint's position or velocity in SI units, shape (n,), and the step in words."""
    if channel.side is None and (drive.ratio != 1 or drive.motion != drive.motor_motion):
        slides = "" if drive.motion == drive.motor_motion else " from turning to sliding"
        problem = f"the {key}'s side is not given, and the gear ratio is {drive.ratio:g}{slides}"
        raise BadInput(table.label(channel.column), problem, 'set side = "motor" or side = "joint"')
    motor = channel.side == "motor"
    motion = drive.motor_motion if motor else drive.motion
    kinds = VELOCITY if isinstance(channel, Velocity) else POSITION
    values = _scaled(channel, table, kinds[motion], key)
    step = f"{key}: of the motor, divided by {drive.ratio:g}" if motor else f"{key}: of the joint"
    return values / drive.ratio if motor else values, step


def recorded_time(source: Columns, table: Table, count: int) -> Array:
    """Return the stamps ``(count,)`` in s since the first, NaN in holes."""
    if source.time is None:
        rows = np.arange(count) if table.rows is None else table.rows - table.rows[0]
        # rows of several signals may take turns
        stride = float(np.median(np.diff(rows))) if count > 1 else 1.0
        if np.any(rows % stride):
            problem = "the rows that where selects are not evenly spaced, and rate says no more"
            raise BadInput(table.where, problem, "give time in place of rate")
        return np.asarray(rows / stride / (source.rate or 1.0))
    column = source.time.column
    if table.is_dated(column) and source.time.unit not in ("s", SI):
        problem = f"holds dates, which are read in s, and its unit is {source.time.unit!r}"
        raise BadInput(table.label(column), problem, 'write unit = "s"')
    time = table.stamps(column) * _factor(source.time, table, "time", "time")
    return np.asarray(time - time[np.isfinite(time)][:1]) if np.isfinite(time).any() else time


def chosen_rows(source: Columns, time: Array, where: str) -> tuple[int, int]:
    """Return the first row from ``start`` on and the one after ``stop``."""
    first = 0 if source.start is None else int(np.searchsorted(time, source.start, "left"))
    last = len(time) if source.stop is None else int(np.searchsorted(time, source.stop, "right"))
    if source.start is not None and first >= len(time):
        end = time[-1] if len(time) else 0.0
        problem = f"ends {end:.6g} s after its first stamp, before start = {source.start:g} s"
        raise BadInput(where, problem, "choose an earlier start")
    return first, last


def _count_warnings(
    source: Columns, table: Table, chosen: slice, *, levels: int = 20
) -> Iterator[str]:
    """Warn of whole numbers in a unit that is not counted in, of more than a few ``levels``."""
    measured_in = {SI, "s", "rad", "m", "rad/s", "m/s", "N m", "Nm", "N", "A", "V"}
    for key, channel in source.channels.items():
        if channel.unit not in measured_in or channel.times is not None or key == "temperature":
            continue
        values = table.column(channel.column)[chosen]
        scaled = isinstance(channel, Torque) and channel.constant
        if not scaled and np.all(values == np.round(values)) and np.unique(values).size > levels:
            counted = "thousandths" if key == "time" else "encoder counts, or thousandths"
            yield (
                f"{key}: all numbers are whole, and its unit is {channel.unit}: are they "
                f"{counted}? Its unit is what a raw 1 is worth"
            )


def _inputs(source: Columns, table: Table, drive: Drive, grid: Grid, steps: list[str]) -> Inputs:
    """Read what acts on the joint in addition to the motor: mass, temperature, load torque."""
    temperature = load_torque = None
    if (channel := source.temperature) is not None:
        zero = {"degC": 0.0, "°C": 0.0, "K": 273.15, SI: 273.15}
        if channel.unit not in zero:
            where = f"{table.label(channel.column)}, unit of temperature"
            raise BadInput(where, f"'{channel.unit}' is no temperature", "write 'degC' or 'K'")
        degrees = _signed(channel, table) - zero[channel.unit]
        temperature = Signal(grid.time, grid.linear(degrees))
        low, high = temperature.values.min(), temperature.values.max()
        steps.append(f"temperature: {low:.3g} to {high:.3g} degC")
    if (channel := source.load_torque) is not None:
        values = _scaled(channel, table, TORQUE[drive.motion], "load_torque")
        load_torque = Signal(grid.time, grid.linear(values))
        steps.append(f"load {TORQUE[drive.motion]}: as measured")
    return Inputs(
        source.added_mass,
        source.radius,
        temperature=temperature,
        load_torque=load_torque,
        others={str(x): Signal(grid.time, grid.linear(table.column(x))) for x in source.others},
    )


def _lag(channel: Channel | None) -> Lag | None:
    """Return the low-pass that a channel passed before it was recorded, where one is known."""
    if not isinstance(channel, Filtered) or channel.lowpass is None:
        return None
    return channel.lowpass, channel.lowpass_order


def _excluded(
    source: Columns, table: Table, grid: Grid, warnings: list[str]
) -> tuple[Flags | None, Flags]:
    """Flag where the drive is off, if a column gives it, and what is not to be compared."""
    off = None
    excluded = np.zeros(len(grid.time), dtype=np.bool_)
    if source.valid is not None:
        valid = table.column(source.valid) != 0
        # between a valid and an invalid stamp the grid is not valid either
        off = grid.linear(valid.astype(np.float64)) < 1.0
        excluded |= off
    for start, stop in source.exclude:
        span = (grid.time >= start) & (grid.time <= stop)
        if not span.any():
            warnings.append(f"exclude: no sample lies in [{start:g}, {stop:g}] s")
        excluded |= span
    return off, excluded


# --- torque of the motor ------------------------------------------------------------------------


def _recorded_torque(source: Columns, table: Table, drive: Drive) -> tuple[Effort, str, Law, str]:
    """Take the torque from its channel, from current or voltage, or from a position target.

    Returns the channel, what was measured, the law on the file's stamps, and the step in words.
    """
    kind = TORQUE[drive.motor_motion]
    if (channel := source.torque) is not None:
        constant = [] if channel.constant is None else [channel.constant]
        torque = _scaled(channel, table, kind, kind, *constant)
        step = f"{kind}: {'as measured' if channel.value is None else channel.value}"
        if constant:
            step = f"{kind}: the signal in {channel.unit} times {channel.constant}"
            if constant[0].endswith("/V"):
                step += "; if that is the motor's own voltage, its back-EMF counts as viscous "
                step += "loss, and the key voltage takes it off"
        return channel, kind, Law(torque, np.ones(torque.shape), held=bool(channel.held)), step
    if (motor := source.current or source.voltage) is not None:
        gives: units.Kind = "current" if isinstance(motor, Current) else "voltage"
        command = _scaled(motor, table, gives, gives)
        factor, back_emf, formula = _motor(gives, motor, table, drive)
        scale = np.full(command.shape, factor)
        law = Law(command, scale, back_emf=back_emf, held=bool(motor.held))
        return motor, gives, law, f"{kind}: {formula}"
    assert source.target is not None
    target_law, gives, step = _target_law(source.target, table, drive)
    return source.target, "voltage" if gives == "share" else gives, target_law, step


def _target_law(target: Target, table: Table, drive: Drive) -> tuple[Law, units.Kind, str]:
    """Read the law of a position-controlled drive, what its controller gives, and the step.

    The unit of the gains says what that is: the motor's torque, current, voltage, or the duty of a
    supply.
    """
    where, kind = table.label(target.column), TORQUE[drive.motor_motion]
    motion = drive.motor_motion if target.side == "motor" else drive.motion
    # the column in 'times' is the supply, and multiplies the scale below
    goal, _ = joint_signal(target.model_copy(update={"times": None}), "target", table, drive)
    (gives, kp), kps = _gains(target.kp, POSITION[motion], (kind, *_REQUIRED), f"{where}, kp")
    missing = [key for key in _REQUIRED.get(gives, ()) if getattr(target, key) is None]
    if missing:
        problem = f"is not given, and kp = {target.kp!r} needs it"
        raise BadInput(f"{where}, {missing[0]}", problem, f"add {missing[0]} = ...")
    kd, kds, limit = 0.0, None, np.inf
    if target.kd is not None:
        (_, kd), kds = _gains(target.kd, VELOCITY[motion], (gives,), f"{where}, kd")
    if target.limit is not None:
        limit = units.scale([target.limit], gives, f"{where}, limit")
    to_side = drive.ratio if target.side == "motor" else 1.0
    factor, back_emf, formula = _motor(gives, target, table, drive)
    scale = np.full(goal.shape, factor)
    if gives == "share" and target.times is not None:
        unit = units.scale([target.times_unit], "voltage", f"{where}, times_unit")
        scale = scale * table.column(target.times) * unit
    if (kps or kds) and np.ptp(scale):
        problem = "is not known, and the supply that it is a share of changes"
        raise BadInput(f"{where}, kp", problem, "give one number for each gain")
    if kps or kds:  # parameters are gains of a torque
        to_side, limit, scale = to_side * scale[0], limit * scale[0], np.ones(goal.shape)
    kp, kd = kp * to_side, kd * to_side
    ranges = {"kp": kps, "kd": kds}
    unknown = {
        n: (low * to_side, high * to_side) for n, r in ranges.items() if r for low, high in [r]
    }
    kd = 0.0 if kds else kd
    # no drive holds a mean over the sample
    held = target.held if target.sampled == "instant" else False
    towards = target.value or f"column '{target.column}'"
    step = f"{kind}: kp = {target.kp} towards {towards}"
    step += f"; {formula}" if formula else ""
    lags = target.loop, target.velocity_filter
    law = Law(kp * goal, scale, kp, kd, limit, back_emf, None, held, unknown, *lags)
    return law, gives, step


def _motor(
    gives: units.Kind, channel: Current | Voltage | Target, table: Table, drive: Drive
) -> tuple[float, float, str]:
    """Return the motor's torque per unit of its input, and per speed; and the formula in words."""
    if gives not in _REQUIRED:
        return 1.0, 0.0, ""
    assert channel.torque_constant is not None
    where, kind = table.label(channel.column), CONSTANT[drive.motor_motion]
    constant = units.scale([channel.torque_constant], kind, f"{where}, torque_constant")
    if gives == "current" or isinstance(channel, Current):
        return constant, 0.0, f"current times {channel.torque_constant}"
    assert channel.resistance is not None
    resistance = units.scale([channel.resistance], "resistance", f"{where}, resistance")
    formula = f"kt V/R - kt^2 (motor speed)/R with kt = {channel.torque_constant}, "
    formula += f"R = {channel.resistance}"
    return constant / resistance, constant**2 * drive.ratio / resistance, formula


def _gains(
    text: str | list[str] | None, per: units.Kind, kinds: Sequence[units.Kind], where: str
) -> tuple[tuple[units.Kind, float], tuple[float, float] | None]:
    """Read a gain that is positive, and its range if it is not known; then it is the upper end."""
    if text is None:
        return (kinds[0], 1.0), (0.0, np.inf)
    parts = [text] if isinstance(text, str) else text
    read = [_gain(part, per, kinds, where) for part in parts]
    for (_, value), part in zip(read, parts, strict=True):
        if value < 0.0:
            raise BadInput(
                where, f"'{part}' is negative, and drives the joint away", "turn its sign"
            )
    if isinstance(text, str):
        return read[0], None
    (kind, low), (other, high) = read if len(read) == 2 else ((kinds[0], 0.0), (kinds[0], 0.0))
    if kind != other or not low < high:
        raise BadInput(where, f"{list(text)} is no range", "give two gains of one unit that rise")
    return (kind, high), (low, high)


def _gain(
    text: str, per: units.Kind, kinds: Sequence[units.Kind], where: str
) -> tuple[units.Kind, float]:
    """Read a gain per angle or speed, and of which kind it is."""
    for kind in kinds:
        with suppress(Unfit):
            return kind, units.product([text, units.si(per)], [kind])
    wanted = ", ".join(f"'{units.si(kind) or 1}/({units.si(per)})'" for kind in kinds)
    raise BadInput(where, f"'{text}' is no gain", f"give it in one of {wanted}")


def _differentiated(position: Array, grid: Grid, processing: Processing) -> Array:
    """Differentiate the low-passed position ``(n,)`` of the joint."""
    fs = 1 / grid.period
    cutoff = fs / 10 if processing.lowpass is None else processing.lowpass
    smooth = filters.lowpass(position, grid.segments, fs, cutoff, processing.order)
    reach = filters.reach_of(processing.differentiation, cutoff, fs)
    return filters.derivative(smooth, grid.segments, grid.period, reach)


def _law_step(law: Law, position: Array, speed: Array, *, measured: bool) -> str:
    """Say which speed the drive's law took, how often it is at its limit, and the back-EMF."""
    step = ""
    if law.back_emf or law.kd:
        step += ", measured speed" if measured else ", differentiated speed"
    if np.isfinite(law.limit):
        share = float(np.mean(law.limited(position, speed)))
        step += f"; at its limit in {100 * share:.2g} % of the samples"
    if law.closed and None in (law.loop, law.velocity_filter):
        step += "; loop or velocity_filter is not given: some 0.5 ms, in viscous loss and inertia"
    return step + "; what that back-EMF is off by counts as viscous loss" * bool(law.back_emf)


# --- files --------------------------------------------------------------------------------------


def _sha256(source: Columns, table: Table) -> str:
    """SHA-256 of the columns used."""
    digest = hashlib.sha256()
    for column in source.columns:
        digest.update(f"{column}\0".encode())
        digest.update(table.values(column).astype("<f8").tobytes())
    return digest.hexdigest()


def _named_files(source: Source, folder: Path) -> list[tuple[Path, str]]:
    """Name the files of a source: by its ``name``, by stem, or by the parts that differ."""
    paths = recorded_files(source, folder)
    if source.name is not None:
        if len(paths) > 1:
            where, problem = f"name = '{source.name}'", f"one name for {len(paths)} files"
            raise BadInput(where, problem, "leave name out, or give every file its own entry")
        return [(paths[0], source.name)]
    absolute = [Path(os.path.abspath(path)) for path in paths]  # noqa: PTH100  (links stay)
    common = os.path.commonpath([path.parent for path in absolute])
    below = [path.relative_to(common) for path in absolute]
    choices = (
        [path.stem for path in below],
        ["-".join((*path.parent.parts, path.stem)) for path in below],
        ["-".join(path.parts) for path in below],
    )
    counts = [Counter(names) for names in choices]
    names = [
        next((name for name, of in zip(file, counts, strict=True) if of[name] == 1), file[-1])
        for file in zip(*choices, strict=True)
    ]
    return list(zip(paths, names, strict=True))


def recorded_files(source: Source, folder: Path) -> list[Path]:
    """Find the files of a source once each, sorted inside a pattern; plain names may not exist."""
    paths: list[Path] = []
    for pattern in source.files:
        if (folder / pattern).exists() or not glob.has_magic(pattern):
            paths.append(folder / pattern)
            continue
        # Path.glob finds hidden files, and takes no absolute pattern
        names = glob.glob(pattern, root_dir=folder, recursive=True)  # noqa: PTH207
        matches = sorted(path for name in names if is_recording(path := folder / name))
        if not matches:
            problem = f"no file in {folder} matches it"
            raise BadInput(f"file = '{pattern}'", problem, "check the pattern and the folder")
        paths.extend(matches)
    # two patterns that match one file would count its measurements twice
    return list(dict.fromkeys(paths))
