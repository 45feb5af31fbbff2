"""From files and tables in memory to measurements in SI units on the joint side."""

from __future__ import annotations

import glob
import hashlib
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayesfric.base.errors import BadInput
from bayesfric.recordings import channels, checks, filters, units
from bayesfric.recordings.arrays import Array, Flags
from bayesfric.recordings.channels import VELOCITY, Drive, Motion
from bayesfric.recordings.drive_law import Law
from bayesfric.recordings.effort import Told, measured_law, position_law
from bayesfric.recordings.inputs import Inputs, Signal
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.processing import Processing
from bayesfric.recordings.recording import Recording
from bayesfric.recordings.source import Columns, Source
from bayesfric.recordings.tables import Table, is_recording, read_table, sha256
from bayesfric.recordings.timebase import Grid, check_order, make_grid

# What the stamp of a mean is of its sample.
_SAMPLED = {"average": "the middle", "start": "the start", "end": "the end"}


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
    memory that has no name, among others. The low-pass of ``processing`` is that of the motor's
    speed where a voltage was measured.
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
    for path, name in _found(source, recording.folder):
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
    channels.check_columns(source, table)
    where = table.label(source.position.column)
    position, step = channels.joint_signal(source.position, "position", table, drive)
    steps = [*table.notes, step]
    time = recorded_time(source, table, len(position))
    chosen = slice(*chosen_rows(source, time, table.where))
    checks.check_size(position, where, "position")
    velocity = None
    if source.velocity is not None:
        velocity, step = channels.joint_signal(source.velocity, "velocity", table, drive)
        checks.check_size(velocity, table.label(source.velocity.column), "velocity")
        steps.append(step)
    told = measured_law(source, table, drive)
    channel, kind = told.channel, told.kind
    checks.check_size(told.law.command, table.label(channel.column), kind)

    grid = make_grid(time, (chosen.start, chosen.stop), table.where)
    checks.check_moves(position[chosen], where, "position")
    checks.check_moves(told.law.command[chosen], table.label(channel.column), kind)
    warnings = [*grid.warnings]
    if not told.law.closed:
        warnings += checks.clipped(channels.signed(channel, table)[chosen], kind)
    if (read_in := checks.quantisation(position[chosen])) is not None:
        unit = "rad" if drive.motion == "rotary" else "m"
        steps.append(f"position: read in steps of {read_in:.3g} {unit} at the joint")
    warnings += channels.counts(source, table, chosen)
    steps.extend(grid.steps)

    joint = grid.smooth(position)
    speed = None if velocity is None else grid.linear(velocity)
    law = told.law.on(grid)
    if channel.sampled != "instant":
        length = float(np.median(np.diff(time))) / grid.period
        law = replace(law, command=_centred(law.command, channel.sampled, grid, length))
        # what the torque has passed the motion passes too
        joint = filters.averaged(joint, grid.segments, length)
        speed = None if speed is None else filters.averaged(speed, grid.segments, length)
        whose = _SAMPLED[channel.sampled]
        steps.append(f"{kind}: means over samples, stamped at {whose}; position averaged alike")
    torque, back_emf, feedback, step = _torque(told, law, joint, speed, grid, processing)
    steps.append(step)
    checks.check_size(joint, where, "position", checks.TINY)
    checks.check_size(torque, table.label(channel.column), "torque", checks.TINY)
    inputs = _inputs(source, table, drive, grid, steps)
    if source.target is not None:
        law = position_law(source.target, table, drive).law.on(grid)
    off, excluded = _excluded(source, table, grid, warnings)
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
        back_emf=back_emf,
        feedback=feedback,
        segments=grid.segments,
        period=grid.period,
        excluded=excluded,
        inputs=inputs,
        steps=tuple(steps),
        warnings=tuple(warnings),
        # a mean over the sample has no bend to miss
        held=channel.held if channel.held or channel.sampled == "instant" else None,
        torque_lag=channel.lag,
        velocity_lag=source.velocity.lag if source.velocity else None,
        motion=drive.motion,
        torque_constant=told.torque_constant,
        law=replace(law, off=off),
        ratio=drive.ratio,
    )


def _inputs(source: Columns, table: Table, drive: Drive, grid: Grid, steps: list[str]) -> Inputs:
    warmth = pushed = None
    if source.temperature is not None:
        degrees = grid.linear(channels.temperature(source.temperature, table))
        warmth = Signal(grid.time, degrees)
        steps.append(f"temperature: {degrees.min():.3g} to {degrees.max():.3g} degC")
    if source.load_torque is not None:
        outside = channels.load_torque(source.load_torque, table, drive)
        pushed = Signal(grid.time, grid.linear(outside))
        steps.append(f"load {channels.TORQUE[drive.motion]}: as measured")
    return Inputs(
        source.added_mass,
        source.radius,
        temperature=warmth,
        load_torque=pushed,
        others={str(x): Signal(grid.time, grid.linear(table.column(x))) for x in source.others},
    )


def _centred(signal: Array, sampled: str, grid: Grid, length: float) -> Array:
    """Bring means over ``length`` samples from where they begin or end to their middles."""
    late = {"start": 0.5, "end": -0.5}.get(sampled, 0.0) * length
    out = signal.copy()
    for a, b in grid.segments:
        out[a:b] = filters.later(signal[a:b], late)
    return out


def recorded_time(source: Columns, table: Table, count: int) -> Array:
    """Give the stamps ``(count,)`` in s since the first."""
    if source.time is None:
        assert source.rate is not None
        return np.arange(count) / source.rate
    time = channels.scaled(source.time, table, "time", "time")
    where = table.label(source.time.column)
    check_order(time, where, table.row)
    checks.check_size(time, where, "time")
    since = np.asarray(time - time[0]) if count else time
    # steps far smaller than the stamps themselves are lost
    check_order(since, where, table.row)
    return since


def chosen_rows(source: Columns, time: Array, where: str) -> tuple[int, int]:
    """Give the first row from ``start`` on and the one after ``stop``."""
    first = 0 if source.start is None else int(np.searchsorted(time, source.start, "left"))
    last = len(time) if source.stop is None else int(np.searchsorted(time, source.stop, "right"))
    if source.start is not None and first >= len(time):
        end = time[-1] if len(time) else 0.0
        what = f"ends {end:.6g} s after its first stamp, before start = {source.start:g} s"
        raise BadInput(where, what, "choose an earlier start")
    return first, last


def _torque(
    told: Told,
    law: Law,
    position: Array,
    velocity: Array | None,
    grid: Grid,
    processing: Processing,
) -> tuple[Array, Array | None, Array | None, str]:
    """Return the motor torque on the grid, what speed has taken off it, and how it came about.

    In third place what position and speed take off the command of a target.
    """
    step = told.step
    if velocity is None:
        velocity = np.zeros(position.shape)
        if law.back_emf or law.kd:
            fs = 1 / grid.period
            cutoff = fs / 10 if processing.lowpass is None else processing.lowpass
            smooth = filters.lowpass(position, grid.segments, fs, cutoff, processing.order)
            reach = filters.reach_of(processing.differentiation, cutoff, fs)
            velocity = filters.derivative(smooth, grid.segments, grid.period, reach)
            step += ", differentiated speed"
    elif law.back_emf or law.kd:
        step += ", measured speed"
    if np.isfinite(law.limit):
        share = float(np.mean(law.limited(position, velocity)))
        step += f"; at its limit in {100 * share:.2g} % of the samples"
    torque = law.drives(position, velocity)
    feedback = law.kp * position + law.kd * velocity if law.closed else None
    if not law.back_emf:
        return torque, None, feedback, step
    back_emf = law.back_emf * velocity
    step += "; what that back-EMF is off by counts as viscous loss"
    return torque - back_emf, back_emf, feedback, step


def _excluded(
    source: Columns, table: Table, grid: Grid, warnings: list[str]
) -> tuple[Flags | None, Flags]:
    """Flag where the drive is off, if that is told, and what is not to be compared."""
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


def _found(source: Source, folder: Path) -> list[tuple[Path, str]]:
    """Find every file once, in the order of the source and sorted inside a pattern; and a name."""
    paths = recorded_files(source, folder)
    if source.name is None:
        return list(zip(paths, _names(paths), strict=True))
    if len(paths) > 1:
        raise BadInput(
            f"name = '{source.name}'",
            f"one name for {len(paths)} files",
            "leave name out, or give every file its own entry",
        )
    return [(paths[0], source.name)]


def recorded_files(source: Source, folder: Path) -> list[Path]:
    """Find the files of a recording; one named without wildcards may not be there."""
    paths: list[Path] = []
    for pattern in source.files:
        if (folder / pattern).exists() or not glob.has_magic(pattern):
            paths.append(folder / pattern)
            continue
        # Path.glob finds hidden files, and takes no absolute pattern
        names = glob.glob(pattern, root_dir=folder, recursive=True)  # noqa: PTH207
        matches = sorted(path for name in names if is_recording(path := folder / name))
        if not matches:
            what = f"no file in {folder} matches it"
            raise BadInput(f"file = '{pattern}'", what, "check the pattern and the folder")
        paths.extend(matches)
    # a file named twice, say by two patterns, would count its measurements twice
    return list(dict.fromkeys(paths))


def _names(paths: Sequence[Path]) -> list[str]:
    """Name files by their stem, or else by what of their path tells them apart."""
    whole = [Path(os.path.abspath(path)) for path in paths]  # noqa: PTH100  (links stay)
    folder = os.path.commonpath([path.parent for path in whole])
    below = [path.relative_to(folder) for path in whole]
    choices = (
        [path.stem for path in below],
        ["-".join((*path.parent.parts, path.stem)) for path in below],
        ["-".join(path.parts) for path in below],
    )
    counts = [Counter(names) for names in choices]
    each = zip(*choices, strict=True)
    return [
        next((name for name, of in zip(one, counts, strict=True) if of[name] == 1), one[-1])
        for one in each
    ]
