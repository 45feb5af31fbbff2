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
from bayesfric.recordings import checks, filters, measurement, units
from bayesfric.recordings.arrays import Array, Flags, pchip
from bayesfric.recordings.measurement import Grid, Inputs, Law, Measurement, Signal
from bayesfric.recordings.readers import is_recording, read_table, sha256
from bayesfric.recordings.source import (
    SI,
    Channel,
    Columns,
    Current,
    Effort,
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
# What a user can do where next to no sample is compared, by what excludes them.
_EXCLUDING = {
    "held for long": "the drive answers too slowly for accelerations: for friction alone give "
    "velocity and torque with steady = true, no time or position",
    "not valid": "check the column of 'valid'",
    "in 'exclude'": "exclude less",
    "as slow as a few steps of the speed": "record faster motions",
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
    memory without a name.
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
        in_memory = _read(source, table, drive, processing)
        in_memory = replace(in_memory, name=name, sha256=_sha256(source, table))
        return [filters.averaged_to(in_memory, recording.needed_rate)]
    assert isinstance(source, Source)
    measurements = []
    for path, name in _named_files(source, recording.folder):
        try:
            recorded = _read(source, read_table(path, source), drive, processing)
        except MemoryError as error:
            hint = "split it, or save fewer columns"
            raise BadInput(str(path), "needs more memory than there is", hint) from error
        measurements.append(replace(recorded, name=name, path=path, sha256=sha256(path)))
    return measurements


# what overflows is refused by its size
@np.errstate(all="ignore")
def _read(source: Columns, table: Table, drive: Drive, processing: Processing) -> Measurement:
    """Take a table's columns, check them, and bring them onto a uniform time base."""
    # columns
    source, table, time = aligned(source, table, drive)
    table, time = _in_parts(source, table, time, processing.max_samples)
    table, time, stale, pace, warnings = _as_measured(source, table, time)
    # of signals that are known throughout
    table = table.decoded({"": np.ones(len(time))}, ())
    steps, motions = list(table.notes), dict[str, Array]()
    for key in ("position", "velocity"):
        if (motion := source.channels.get(key)) is not None:
            assert isinstance(motion, Position)
            motions[key], step = joint_signal(motion, key, table, drive)
            steps.append(step)
    signal, moved = next(iter(motions.items()))
    position, velocity = motions.get("position"), motions.get("velocity")
    channel, kind, recorded, torque_step = _recorded_torque(source, table, drive)

    # checks
    chosen = slice(*chosen_rows(source, time, table.where))
    if source.steady:
        grid = measurement.steady_grid(len(time))
    else:
        grid = measurement.make_grid(time, (chosen.start, chosen.stop), table.where)
    raw, label = _signed(channel, table)[chosen], table.label(channel.column)
    checks.check_moves(moved[chosen], table.label(source.motion.column), signal)
    if channel.value is None and not (recorded.follows or np.ptp(recorded.command[chosen])):
        checks.check_moves(raw, label, kind)
    warnings += [*table.doubts(source.columns), *grid.warnings]
    warnings += _count_warnings(source, table, chosen)
    for key in _MEASURED if not source.steady else ():
        signed = source.channels.get(key)
        if signed and (coded := checks.sign_code(_signed(signed, table)[chosen])):
            hint = f"where its sign is a bit, write {coded[0]} = {coded[1]}"
            raise BadInput(table.label(signed.column), f"{key}: {coded[2]}", hint)
    if not recorded.closed:
        warnings += checks.clipped(raw, kind)
        if channel.sign == 1 and position is not None and source.voltage is None:
            warnings += checks.unsigned(raw, position[chosen], label)
    if (encoder_step := checks.quantisation(moved[chosen])) is not None:
        unit = ("rad" if drive.motion == "rotary" else "m") + "/s" * (position is None)
        steps.append(f"{signal}: read in steps of {encoder_step:.3g} {unit} at the joint")
    steps += grid.steps

    # arrays
    speed = None if velocity is None else grid.linear(velocity)
    if position is None:
        assert speed is not None
        joint = measurement.integral(speed, grid.segments, grid.period)
        if not source.steady:
            steps.append("position: none; the velocity integrated, from 0 in every segment")
    else:
        joint = grid.bring(position, pchip)
    law = recorded.each(grid.linear)
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
        fs = 1.0 / grid.period
        cutoff = fs / 10 if processing.lowpass is None else processing.lowpass
        smooth = filters.lowpass(joint, grid.segments, fs, cutoff, processing.order)
        reach = filters.reach_of(processing.differentiation, cutoff, fs)
        motor_speed = filters.derivative(smooth, grid.segments, grid.period, reach)
    if by_speed:
        law = replace(law, command=law.command * np.sign(drive.ratio * motor_speed))
        torque_step += ", positive where it drives"
    torque = law.drives(joint, motor_speed)
    feedback = law.kp * joint + law.kd * motor_speed if law.closed else None
    back_emf = law.back_emf * motor_speed if law.back_emf else None
    if back_emf is not None:
        torque = torque - back_emf
    steps.append(torque_step + _law_step(law, joint, motor_speed, measured=speed is not None))
    inputs = _inputs(source, table, drive, grid, steps)
    excluding = _excluding(source, table, grid, stale, speed, warnings)
    excluded, lacking = np.any([*excluding.values()], axis=0), ("", "")
    if excluded.any():
        counts = {why: int(flags.sum()) for why, flags in excluding.items() if flags.any()}
        text = ", ".join(f"{count} {why}" for why, count in counts.items())
        text = f"{int(excluded.sum())} of {len(excluded)} samples are not compared ({text})"
        steps.append(f"exclude: {text}")
        lacking = text, _EXCLUDING[max(counts, key=lambda why: counts[why])]
    if law.closed and not excluded.all():
        fault = checks.target_fault(law.command / law.kp, joint, ~excluded)
        if fault is not None:
            raise BadInput(label, *fault)
    torque_constant = None
    if source.current is not None:
        torque_constant, *_ = _motor("current", source.current, table, drive)
    if source.target is not None:
        law = _target_law(source.target, table, drive)[0].each(grid.linear)
    return Measurement(
        name="",
        path=None,
        sha256="",
        time=grid.time,
        position=joint,
        velocity=speed,
        torque=torque,
        back_emf=back_emf,
        feedback=feedback,
        segments=grid.segments,
        period=grid.period,
        excluded=excluded,
        inputs=inputs,
        steps=tuple(steps),
        warnings=tuple(warnings),
        held=bool(channel.held),
        torque_lag=channel.lag if isinstance(channel, Torque | Current) else None,
        velocity_lag=None if source.velocity is None else source.velocity.lag,
        motion=drive.motion,
        torque_constant=torque_constant,
        law=replace(law, off=excluding.get("not valid")),
        lacking=lacking,
        integrated=position is None,
        steady=source.steady,
        ratio=drive.ratio,
        pace=pace,
    )


# --- columns ------------------------------------------------------------------------------------


def aligned(source: Columns, table: Table, drive: Drive) -> tuple[Columns, Table, Array]:
    """Bring all columns, decoded, to the rows of the motion; returns their stamps from 0, too."""
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
                values, count = np.where(failed, np.nan, values), int(failed.sum())
                note = f"failed reads: column {channel.column!r} is {code:.6g} between values far"
                notes.append(f"{note} from it in {count} rows, left out")
        if isinstance(channel, Position) and not isinstance(channel, Velocity):
            motion = drive.motor_motion if channel.side == "motor" else drive.motion
            plain = channel.model_copy(update={"times": None})  # of a target it is the supply
            factor = _factor(plain, table, POSITION[motion], key)
            turn = 2.0 * np.pi / factor if motion == "rotary" else None
        if key in ("time", "position", "target") and np.isfinite(values).any():
            values, modulus, jumps = checks.unwrapped(values, turn)
            unit = factor * (-1 if channel.sign == -1 else 1)
            wraps[key] = float(np.nanmedian(values)), modulus, unit
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
        size, column = max(modulus * abs(unit), other * abs(by)), source.target.column
        if size and source.target.side == source.position.side:
            turns = np.round((middle * by - goal * unit) / size)
            decoded[column] = decoded.get(column, table.values(column)) + turns * size / unit
    return source.model_copy(update=update), table.decoded(decoded, notes)


def _in_parts(source: Columns, table: Table, time: Array, max_samples: int) -> tuple[Table, Array]:
    """Limit a recording to ``max_samples``, in up to eight parts all over what is chosen."""
    first, last = chosen_rows(source, time, table.where)
    # between parts there must be gaps
    if last - first <= max_samples + measurement.LEAST_SAMPLES:
        return table, time
    ranges = measurement.spread_ranges(last - first, max_samples)
    rows = np.concatenate([np.arange(first + a, first + b) for a, b in ranges])
    note = f"time: {rows.size} of {last - first} samples are used, in {len(ranges)} parts all over "
    note += "the recording (max_samples)"
    return table.at(rows, time.size).decoded({}, [note]), time[rows]


def _as_measured(
    source: Columns, table: Table, time: Array
) -> tuple[Table, Array, Flags, float | None, list[str]]:
    """Leave rows out that repeat motion and torque; interpolate a signal between its own rows.

    Returns also the stamps, flags of rows that last long, the pace in Hz of the slowest signal,
    and warnings.
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
            problem = "the rows that where selects are not evenly spaced"
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
        problem = f"ends {max(time, default=0.0):.6g} s after its first stamp"
        raise BadInput(where, f"{problem}, before start = {source.start:g} s", "start earlier")
    return first, last


def _count_warnings(source: Columns, table: Table, chosen: slice) -> Iterator[str]:
    """Warn of whole numbers in a unit that is not counted in, of more than a few levels."""
    measured_in = {SI, "s", "rad", "m", "rad/s", "m/s", "N m", "Nm", "N", "A", "V"}
    for key, channel in source.channels.items():
        if channel.unit not in measured_in or channel.times is not None or key == "temperature":
            continue
        values = table.column(channel.column)[chosen]
        scaled = isinstance(channel, Torque) and channel.constant
        if not scaled and np.all(values == np.round(values)) and np.unique(values).size > 20:
            counted = "thousandths" if key == "time" else "encoder counts, or thousandths"
            yield f"{key}: all numbers are whole: are they {counted}, not {channel.unit}?"


def _inputs(source: Columns, table: Table, drive: Drive, grid: Grid, steps: list[str]) -> Inputs:
    """Read what acts on the joint in addition to the motor: mass, temperature, load torque."""
    values = dict[str, Array]()
    if (channel := source.temperature) is not None:
        zero = {"degC": 0.0, "°C": 0.0, "K": 273.15, SI: 273.15}
        if channel.unit not in zero:
            where = f"{table.label(channel.column)}, unit of temperature"
            raise BadInput(where, f"'{channel.unit}' is no temperature", "write 'degC' or 'K'")
        degrees = values["temperature"] = _signed(channel, table) - zero[channel.unit]
        steps.append(f"temperature: {degrees.min():.3g} to {degrees.max():.3g} degC")
    if (channel := source.load_torque) is not None:
        kind = TORQUE[drive.motion]
        values["load_torque"] = _scaled(channel, table, kind, "load_torque")
        steps.append(f"load {kind}: as measured")
    signals = {key: Signal(grid.time, grid.linear(x)) for key, x in values.items()}
    others = {str(x): Signal(grid.time, grid.linear(table.column(x))) for x in source.others}
    load, temperature = signals.get("load_torque"), signals.get("temperature")
    mass, radius = source.added_mass, source.radius
    return Inputs(mass, radius, load_torque=load, temperature=temperature, others=others)


def _excluding(
    source: Columns,
    table: Table,
    grid: Grid,
    stale: Flags,
    speed: Array | None,
    warnings: list[str],
) -> dict[str, Flags]:
    """Flag what is not to be compared, by the keys of `_EXCLUDING`."""
    flags = {"held for long": grid.linear(stale.astype(np.float64)) > 0.0}
    if source.valid is not None:
        # between a valid and an invalid stamp the grid is not valid either
        flags["not valid"] = grid.linear((table.column(source.valid) != 0) * 1.0) < 1.0
    for start, stop in source.exclude:
        span = (grid.time >= start) & (grid.time <= stop)
        if not span.any():
            warnings.append(f"exclude: no sample lies in [{start:g}, {stop:g}] s")
        flags["in 'exclude'"] = flags.get("in 'exclude'", False) | span
    if source.steady and speed is not None:
        slowest = 3.5 * (checks.quantisation(speed) or 0.0)
        flags["as slow as a few steps of the speed"] = np.abs(speed) <= slowest
    return flags


# --- torque of the motor ------------------------------------------------------------------------


def _recorded_torque(source: Columns, table: Table, drive: Drive) -> tuple[Effort, str, Law, str]:
    """Return the torque's channel, what was measured, its law on the file's stamps, the step."""
    kind = TORQUE[drive.motor_motion]
    if (channel := source.torque) is not None:
        constant = [] if channel.constant is None else [channel.constant]
        torque = _scaled(channel, table, kind, kind, *constant)
        step = f"{kind}: {'as measured' if channel.value is None else channel.value}"
        if constant:
            step = f"{kind}: the signal in {channel.unit} times {channel.constant}"
            if constant[0].endswith("/V"):
                step += "; of the motor's own voltage the key voltage takes off the back-EMF"
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
    """Read the law of a position-controlled drive, what its controller gives, and the step."""
    where, kind = table.label(target.column), TORQUE[drive.motor_motion]
    motion = drive.motor_motion if target.side == "motor" else drive.motion
    # the column in 'times' is the supply, and multiplies the scale below
    goal, _ = joint_signal(target.model_copy(update={"times": None}), "target", table, drive)
    gives, *kps = _gain(target.kp, POSITION[motion], (kind, *_REQUIRED), f"{where}, kp")
    missing = [key for key in _REQUIRED.get(gives, ()) if getattr(target, key) is None]
    if missing:
        problem = f"is not given, and kp = {target.kp!r} needs it"
        raise BadInput(f"{where}, {missing[0]}", problem, f"add {missing[0]} = ...")
    kds, limit = [0.0, 0.0], np.inf
    if target.kd is not None:
        _, *kds = _gain(target.kd, VELOCITY[motion], (gives,), f"{where}, kd")
    ranges = {"kp": kps, "kd": kds}
    unknown = {gain: (low, high) for gain, (low, high) in ranges.items() if low < high}
    if target.limit is not None:
        limit = units.scale([target.limit], gives, f"{where}, limit")
    to_side = drive.ratio if target.side == "motor" else 1.0
    factor, back_emf, formula = _motor(gives, target, table, drive)
    scale = np.full(goal.shape, factor)
    if gives == "share" and target.times is not None:
        unit = units.scale([target.times_unit], "voltage", f"{where}, times_unit")
        scale = scale * table.column(target.times) * unit
    if unknown and np.ptp(scale):
        problem = "is not known, and the supply that it is a share of changes"
        raise BadInput(f"{where}, kp", problem, "give one number for each gain")
    if unknown:  # parameters are gains of a torque
        to_side, limit, scale = to_side * scale[0], limit * scale[0], np.ones(goal.shape)
    unknown = {gain: (low * to_side, high * to_side) for gain, (low, high) in unknown.items()}
    kp = to_side * (kps[1] if np.isfinite(kps[1]) else 1.0)
    kd = 0.0 if "kd" in unknown else to_side * kds[1]
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
    formula = f"kt V/R - kt^2 qd/R with kt = {channel.torque_constant}, R = {channel.resistance}"
    return constant / resistance, constant**2 * drive.ratio / resistance, formula


def _gain(
    text: str | list[str] | None, per: units.Kind, kinds: Sequence[units.Kind], where: str
) -> tuple[units.Kind, float, float]:
    """Read a gain per angle or speed: its kind and the ends of its range, alike if it is known."""
    if text is None:
        return kinds[0], 0.0, np.inf
    ends = list[tuple[units.Kind, float]]()
    for part in [text] if isinstance(text, str) else text:
        for kind in kinds:
            with suppress(Unfit):
                ends.append((kind, units.product([part, units.si(per)], [kind])))
                break
        else:
            wanted = ", ".join(f"'{units.si(kind) or 1}/({units.si(per)})'" for kind in kinds)
            raise BadInput(where, f"'{part}' is no gain", f"give it in one of {wanted}")
        if ends[-1][1] < 0.0:
            problem = f"'{part}' is negative, and drives the joint away"
            raise BadInput(where, problem, "turn its sign")
    rises = len(ends) == 2 and ends[0][0] == ends[1][0] and ends[0][1] < ends[1][1]
    if not isinstance(text, str) and not rises:
        raise BadInput(where, f"{list(text)} is no range", "give two gains of one unit that rise")
    return *ends[0], ends[-1][1]


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
    parts = (f"{c}\0".encode() + table.values(c).astype("<f8").tobytes() for c in source.columns)
    return hashlib.sha256(b"".join(parts)).hexdigest()


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
