"""From files to recordings in SI units on the joint side."""

from __future__ import annotations

import glob
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

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
    lengths,
    same_length,
    scaled,
    signed,
)
from bayesfric.recordings.options import Processing, Source
from bayesfric.recordings.recording import Recording
from bayesfric.recordings.tables import Table, read_table, sha256
from bayesfric.recordings.timebase import Grid, check_order, make_grid


def read_recordings(
    source: Source,
    folder: Path,
    *,
    ratio: float,
    motion: Motion,
    motor_motion: Motion = "rotary",
    processing: Processing,
) -> list[Recording]:
    """Read all recordings of a source.

    Parameters
    ----------
    source
        Files, channels and spans.
    folder
        Folder that the files' names are relative to.
    ratio
        Motor motion per joint motion (rad/rad, rad/m, ...).
    motion
        Whether the joint turns or slides.
    motor_motion
        Whether the motor turns or slides.
    processing
        Its gap, jitter, resample and min_samples are used, and lowpass and order for the motor
        speed of a voltage channel.

    Returns
    -------
    list of Recording
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
        units.parse(processing.dead_zone, VELOCITY[motion], "processing, dead_zone")
    paths = _expand(source, folder)
    if source.name is not None:
        if len(paths) > 1:
            raise BadInput(
                f"name = '{source.name}'",
                f"one name for {len(paths)} files",
                "leave name out, or give every file its own entry",
            )
        names = [source.name]
    else:
        names = _names(paths)
    recordings = []
    for path, name in zip(paths, names, strict=True):
        try:
            recordings.append(_read(source, path, name, drive, processing))
        except MemoryError as error:
            raise BadInput(
                str(path), "needs more memory than there is", "split it, or save fewer columns"
            ) from error
    return recordings


# what overflows is refused by its size
@np.errstate(all="ignore")
def _read(source: Source, path: Path, name: str, drive: Drive, processing: Processing) -> Recording:
    table = read_table(path, source)
    steps = list(table.notes)
    position, step = joint_signal(source.position, table, drive)
    steps.append(step)
    time = _time(source, table, len(position))
    chosen = _chosen(source, time, str(path))
    part = slice(*chosen)
    checks.check_not_huge(position, table.label(source.position.column), "position")
    velocity = None
    if source.velocity is not None:
        velocity, step = joint_signal(source.velocity, table, drive)
        checks.check_not_huge(velocity, table.label(source.velocity.column), "velocity")
        same_length(source.velocity, velocity, source.position, position, table)
        steps.append(step)
    channel, signal, kind = drive_signal(source, table, drive)
    check_columns(source, table)
    same_length(channel, signal, source.position, position, table)
    checks.check_not_huge(signal, table.label(channel.column), kind)

    grid = make_grid(time, chosen, processing, str(path))
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
        flag = table.column(source.valid)
        if len(flag) != len(position):
            raise lengths(table, source.valid, len(flag), source.position.column, len(position))
        # between a valid and an invalid stamp the grid is not valid either
        excluded |= grid.linear((flag != 0).astype(np.float64)) < 1.0
    if excluded.any():
        steps.append(f"exclude: {int(excluded.sum())} of {len(excluded)} samples not compared")
    return Recording(
        name=name,
        path=path,
        sha256=sha256(path),
        time=grid.time,
        position=joint,
        velocity=speed,
        torque=torque,
        segments=grid.segments,
        period=grid.period,
        excluded=excluded,
        added_mass=source.added_mass,
        radius=source.radius,
        steps=tuple(steps),
        warnings=tuple(warnings),
        torque_origin="voltage" if source.voltage else "current" if source.current else "measured",
    )


def _expand(source: Source, folder: Path) -> list[Path]:
    patterns = [source.file] if isinstance(source.file, str) else source.file
    paths: list[Path] = []
    for pattern in patterns:
        if (folder / pattern).exists() or not glob.has_magic(pattern):
            paths.append(folder / pattern)
            continue
        matches = sorted(path for path in _matching(pattern, folder) if path.is_file())
        if not matches:
            raise BadInput(
                f"file = '{pattern}'",
                f"no file in {folder} matches it",
                "check the pattern and the folder",
            )
        paths.extend(matches)
    for path in paths:
        if not _is_text(str(path)):
            raise BadInput(str(path), "its name is not UTF-8", "rename the file")
    # a file named twice, say by two patterns, would count its measurements twice
    return list(dict.fromkeys(paths))


def _matching(pattern: str, folder: Path) -> Iterator[Path]:
    """Find files as the shell does; ** enters no linked folder, which may hold itself."""
    anchor = Path(pattern).anchor
    root = Path(anchor) if anchor else folder
    relative = pattern[len(anchor) :]
    # a last ** means folders only in some versions of Python
    parts = Path(relative).parts
    if parts and parts[-1] == "**":
        relative += "/*"
    hidden = any(part.startswith(".") for part in parts)
    try:
        for path in root.glob(relative):
            if hidden or not any(p.startswith(".") for p in path.relative_to(root).parts):
                yield path
    except (ValueError, NotImplementedError) as error:
        raise BadInput(
            f"file = '{pattern}'", f"is no pattern ({error})", "write ** between slashes"
        ) from None


def _is_text(name: str) -> bool:
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def _names(paths: Sequence[Path]) -> list[str]:
    names = [path.stem for path in paths]
    depth = max((len(path.parts) for path in paths), default=0)
    for level in range(1, depth):
        doubled = {name for name, count in Counter(names).items() if count > 1}
        if not doubled:
            break
        names = [
            "/".join((*path.parts[-1 - level : -1], path.stem)) if name in doubled else name
            for path, name in zip(paths, names, strict=True)
        ]
    doubled = {name for name, count in Counter(names).items() if count > 1}
    # left over are files that differ in their suffix only
    return [
        "/".join(path.parts[-2:]) if name in doubled else name
        for path, name in zip(paths, names, strict=True)
    ]


def _time(source: Source, table: Table, count: int) -> NDArray[np.float64]:
    if source.time is None:
        if source.rate is None:
            raise BadInput(str(table.path), "has neither time nor rate", "give one of them")
        return np.arange(count) / source.rate
    time = scaled(source.time, table, "time", "time")
    if len(time) != count:
        raise lengths(table, source.time.column, len(time), source.position.column, count)
    where = table.label(source.time.column)
    check_order(time, where, table.row)
    checks.check_not_huge(time, where, "time")
    since = np.asarray(time - time[0]) if count else time
    # steps far smaller than the stamps themselves are lost
    check_order(since, where, table.row)
    return since


def _chosen(source: Source, time: NDArray[np.float64], where: str) -> tuple[int, int]:
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
    source: Source,
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
    constant = units.parse(source.voltage.torque_constant, CONSTANT[drive.motor_motion])
    resistance = units.parse(source.voltage.resistance, "resistance")
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


def _excluded(source: Source, time: NDArray[np.float64], warnings: list[str]) -> NDArray[np.bool_]:
    excluded = np.zeros(len(time), dtype=np.bool_)
    for start, stop in source.exclude:
        span = (time >= start) & (time <= stop)
        if not span.any():
            warnings.append(f"exclude: no sample lies in [{start:g}, {stop:g}] s")
        excluded |= span
    return excluded
