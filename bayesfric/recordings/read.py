"""From files and tables in memory to measurements in SI units on the joint side."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bayesfric.errors import BadInput
from bayesfric.recordings import checks, filters, units
from bayesfric.recordings.channels import (
    CONSTANT,
    TORQUE,
    VELOCITY,
    Drive,
    Motion,
    check_columns,
    drive_signal,
    joint_signal,
    scaled,
    signed,
)
from bayesfric.recordings.find_files import find_files
from bayesfric.recordings.inputs import Inputs
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.processing import Processing
from bayesfric.recordings.recording import Recording
from bayesfric.recordings.source import Columns, Source
from bayesfric.recordings.tables import Table, read_table, sha256
from bayesfric.recordings.timebase import Grid, check_order, make_grid


def read_recordings(
    recording: Recording,
    *,
    ratio: float,
    motion: Motion,
    motor_motion: Motion = "rotary",
    processing: Processing,
    number: int = 1,
) -> list[Measurement]:
    """Read all files of a recording, or its table in memory.

    Parameters
    ----------
    recording
        Files or a table, channels and spans.
    ratio
        Motor motion per joint motion (rad/rad, rad/m, ...).
    motion
        Whether the joint turns or slides.
    motor_motion
        Whether the motor turns or slides.
    processing
        Its gap, jitter, resample and min_samples are used, and lowpass and order for the motor
        speed of a voltage channel.
    number
        Names a table in memory that has no name, among others.

    Returns
    -------
    list of Measurement
        One a file, in the order of the source, sorted inside a pattern.

    Raises
    ------
    BadInput
        For anything in the files or in the source that cannot be used.
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
        found = _read(source, table, drive, processing)
        return [replace(found, name=name, sha256=_sha256(source, table))]
    assert isinstance(source, Source)
    measurements = []
    for path, name in find_files(source, recording.folder):
        try:
            found = _read(source, read_table(path, source), drive, processing)
        except MemoryError as error:
            raise BadInput(
                str(path), "needs more memory than there is", "split it, or save fewer columns"
            ) from error
        measurements.append(replace(found, name=name, path=path, sha256=sha256(path)))
    return measurements


def _sha256(source: Columns, table: Table) -> str:
    """SHA-256 of the columns used."""
    digest = hashlib.sha256()
    for column in source.columns:
        digest.update(f"{column}\0".encode())
        digest.update(table.column(column).astype("<f8").tobytes())
    return digest.hexdigest()


# what overflows is refused by its size
@np.errstate(all="ignore")
def _read(source: Columns, table: Table, drive: Drive, processing: Processing) -> Measurement:
    steps = list(table.notes)
    check_columns(source, table)
    position, step = joint_signal(source.position, "position", table, drive)
    steps.append(step)
    time = _time(source, table, len(position))
    chosen = _chosen(source, time, table.where)
    part = slice(*chosen)
    checks.check_not_huge(position, table.label(source.position.column), "position")
    velocity = None
    if source.velocity is not None:
        velocity, step = joint_signal(source.velocity, "velocity", table, drive)
        checks.check_not_huge(velocity, table.label(source.velocity.column), "velocity")
        steps.append(step)
    channel, signal, kind = drive_signal(source, table, drive)
    checks.check_not_huge(signal, table.label(channel.column), kind)

    grid = make_grid(time, chosen, processing, table.where)
    checks.check_moves(position[part], table.label(source.position.column), "position")
    checks.check_moves(signal[part], table.label(channel.column), kind)
    warnings = [*grid.warnings, *checks.clipped(signed(channel, table)[part], kind)]
    coarse = checks.quantisation(position[part])
    if coarse is not None:
        unit = "rad" if drive.motion == "rotary" else "m"
        warnings.append(f"position: quantised with a step of {coarse:.3g} {unit} at the joint")
    steps.extend(grid.steps)

    joint = grid.smooth(position)
    speed = None if velocity is None else grid.linear(velocity)
    torque, step = _torque(source, grid.linear(signal), joint, speed, grid, drive, processing)
    steps.append(step)
    checks.check_size(joint, table.label(source.position.column), "position")
    checks.check_size(torque, table.label(channel.column), "torque")
    excluded = _excluded(source, grid.time, warnings)
    if source.valid is not None:
        valid = table.column(source.valid) != 0
        # between a valid and an invalid stamp the grid is not valid either
        excluded |= grid.linear(valid.astype(np.float64)) < 1.0
    if excluded.any():
        steps.append(f"exclude: {int(excluded.sum())} of {len(excluded)} samples not compared")
    return Measurement(
        name="",
        path=None,
        sha256="",
        time=grid.time,
        position=joint,
        velocity=speed,
        torque=torque,
        segments=grid.segments,
        period=grid.period,
        excluded=excluded,
        inputs=Inputs(source.added_mass, source.radius),
        steps=tuple(steps),
        warnings=tuple(warnings),
        drive=kind,
    )


def _time(source: Columns, table: Table, count: int) -> NDArray[np.float64]:
    if source.time is None:
        assert source.rate is not None
        return np.arange(count) / source.rate
    time = scaled(source.time, table, "time", "time")
    where = table.label(source.time.column)
    check_order(time, where, table.row)
    checks.check_not_huge(time, where, "time")
    since = np.asarray(time - time[0]) if count else time
    # steps far smaller than the stamps themselves are lost
    check_order(since, where, table.row)
    return since


def _chosen(source: Columns, time: NDArray[np.float64], where: str) -> tuple[int, int]:
    first = 0 if source.start is None else int(np.searchsorted(time, source.start, "left"))
    last = len(time) if source.stop is None else int(np.searchsorted(time, source.stop, "right"))
    if source.start is not None and first >= len(time):
        end = time[-1] if len(time) else 0.0
        raise BadInput(
            where,
            f"ends {end:.6g} s after its first stamp, before start = {source.start:g} s",
            "choose an earlier start",
        )
    return first, last


def _torque(
    source: Columns,
    signal: NDArray[np.float64],
    position: NDArray[np.float64],
    velocity: NDArray[np.float64] | None,
    grid: Grid,
    drive: Drive,
    processing: Processing,
) -> tuple[NDArray[np.float64], str]:
    """Return the motor torque on the grid, and how it came about."""
    what = TORQUE[drive.motor_motion]
    if source.current is not None:
        return signal, f"{what}: current times {source.current.torque_constant}"
    if source.voltage is None:
        return signal, f"{what}: as measured"
    constant = units.scale([source.voltage.torque_constant], CONSTANT[drive.motor_motion])
    resistance = units.scale([source.voltage.resistance], "resistance")
    origin = "measured"
    if velocity is None:
        origin = "differentiated"
        fs = 1 / grid.period
        cutoff = fs / 10 if processing.lowpass is None else processing.lowpass
        smooth = filters.lowpass(position, grid.segments, fs, cutoff, processing.order)
        reach = filters.reach_of(processing.differentiation, cutoff, fs)
        velocity = filters.derivative(smooth, grid.segments, grid.period, reach)
    torque = constant / resistance * (signal - constant * drive.ratio * velocity)
    return torque, (
        f"{what}: kt V/R - kt^2 (motor speed)/R with kt = {source.voltage.torque_constant}, "
        f"R = {source.voltage.resistance}, {origin} speed"
    )


def _excluded(source: Columns, time: NDArray[np.float64], warnings: list[str]) -> NDArray[np.bool_]:
    excluded = np.zeros(len(time), dtype=np.bool_)
    for start, stop in source.exclude:
        span = (time >= start) & (time <= stop)
        if not span.any():
            warnings.append(f"exclude: no sample lies in [{start:g}, {stop:g}] s")
        excluded |= span
    return excluded
