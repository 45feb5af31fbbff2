"""A log of an arm: the rows in which all joints have values, and their motion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from bayesfric.arm.arm_columns import Joints, Layout
from bayesfric.arm.arm_options import ArmOptions, Coupling
from bayesfric.arm.inertial_prior import UrdfJoint
from bayesfric.base.errors import BadInput
from bayesfric.base.options import configuration_error
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.filters import WIDEST, derivative, interpolated
from bayesfric.recordings.measurement import Measurement, spread_ranges
from bayesfric.recordings.read import (
    Drive,
    aligned,
    chosen_rows,
    decoded,
    joint_signal,
    read_recordings,
)
from bayesfric.recordings.readers import TableOptions, read_table
from bayesfric.recordings.signals import choose_filters, filtered_motion
from bayesfric.recordings.source import CHANNELS, SI, Columns, Position, Recording, Source, Torque
from bayesfric.recordings.tables import Table

_URDF_TORQUE, _STAMPS = "urdf_torque", "stamps in s"
# Most rows in memory over those to fit, where averages are fitted.
_ROWS = 10.0


class ArmLog:
    """One log of an arm, of which at most ``max_samples`` rows are kept.

    ``sources`` holds the meaning of the columns by joint, ``loaded`` whether the payload is on,
    ``time`` ``(n,)`` s, ``motion`` ``(3, n_joints, n)`` position, speed and acceleration in the
    URDF's order, at the rate that the fastest motion needs. Each joint's is low-passed by what its
    positions resolve, as in a fit of it, which filters torques of bodies and drive alike.
    """

    def __init__(
        self,
        path: Path,
        name: str,
        options: ArmOptions,
        layout: Layout,
        joints: Joints,
        max_samples: int,
    ) -> None:
        self.path, self.name, self._processing = path, name, options.processing
        self.loaded = options.payload.logs is None or name in options.payload.logs
        self.scales: Mapping[str, float] = {}  # of efforts in the log, by joint, which are undone
        self.sources: dict[str, Columns] = {}
        for joint_name, recording in layout.items():
            self.sources[joint_name] = _source({**recording, "file": str(path), "name": name})
        keys = {key: recording[key] for key in TableOptions.model_fields if key in recording}
        every = self._open(read_table(path, TableOptions.model_validate(keys)), joints)
        held = {name: x.held for name, x in options.joints.items() if x.held is not None}
        every = (self._of_motors(every[0], joints, options.coupling, held), *every[1:])
        processing, self._needed_rate, row_limit = options.processing, math.inf, max_samples
        while True:  # until the rate is what the motion needs
            self._keep(every, row_limit)
            motions = [held[n] if n in held else self._joint_motion(x) for n, x in joints.items()]
            moving = [motion for motion in motions if isinstance(motion, Measurement)]
            if not moving:
                raise BadInput(str(path), "no joint moves in it", "record the arm while it moves")
            filters = [choose_filters(motion, processing) for motion in moving]
            rate = max(x.resolution.band for x in filters) / WIDEST
            faster = min(1.0 / moving[0].period, self._needed_rate) / rate
            if faster < 2.0 or not processing.chooses_band:
                break
            self._needed_rate, row_limit = rate, int(max_samples * min(faster, _ROWS))
        self.time = moving[0].time
        self.motion, filter_of = np.zeros((3, len(motions), self.time.size)), iter(filters)
        for k, motion in enumerate(motions):
            if isinstance(motion, Measurement):
                own = next(filter_of)
                q, qd = filtered_motion(motion, own.cutoff, processing.order, own.reach)
                qdd = derivative(qd, motion.segments, motion.period, own.reach)
                self.motion[:, k] = q, qd, qdd
            else:
                self.motion[0, k] = motion

    @property
    def fitted(self) -> int:
        """Number of rows that are kept; ``rows`` is that of the file."""
        return self._stamps.size

    @property
    def period(self) -> float:
        """Median time from row to row, s."""
        return float(np.median(np.diff(self._stamps)))

    def measured(self, joint: UrdfJoint) -> Measurement:
        """Read a joint with its effort."""
        return self._read(self.recording(joint, np.zeros((0, 1))), joint)

    def by_target(self, joint: str) -> bool:
        """Whether only a target says what torque a joint has."""
        source = self.sources[joint]
        efforts = source.torque, source.current, source.voltage
        return source.target is not None and not any(efforts)

    def recording(
        self, joint: UrdfJoint, torques: Array, further: Mapping[str, Array] | None = None
    ) -> Recording:
        """Add rigid-body torque and its deviations ``(1 + k, n)`` to a joint's columns.

        They, and ``further`` ones, are at the times of :attr:`motion`.
        """
        source, scale = self.sources[joint.name], self.scales.get(joint.name, 1.0)
        names = (_URDF_TORQUE, *signals(len(torques) - 1), *(further or {}))
        pairs = zip(names, [*torques, *(further or {}).values()], strict=False)
        computed = {name: interpolated(self.time, x, self._stamps) for name, x in pairs}
        return self._columns(source, computed, scale)

    def _open(self, table: Table, joints: Joints) -> tuple[Table, Array, tuple[int, int]]:
        """Read all joints' columns at the rows in which each has a value, and which are chosen."""
        columns = list[str | int]()
        drives = {name: Drive(1.0, x.motion, x.motion) for name, x in joints.items()}
        for name, source in self.sources.items():
            self._position(source, joints[name], table)
            with suppress(BadInput):  # a drive that is missing is refused with its joint
                self.sources[name], table = decoded(source, table, drives[name])
            for column in source.columns:
                with suppress(BadInput):
                    columns += [] if table.holes(column).all() else [column]
        name, source = next(iter(self.sources.items()))
        other_channels = dict.fromkeys(set(CHANNELS) - {"time", "position"})
        source = source.model_copy(update={**other_channels, "others": tuple(columns)})
        _, table, stamps = aligned(source, table, drives[name])
        cells = {_name(column): table.column(column) for column in columns}
        names, self.rows = list(cells), stamps.size
        table = Table(str(self.path), names, lambda i: cells[names[i]], notes=table.notes)
        return table, stamps, chosen_rows(source, stamps, table.where)

    def _of_motors(
        self, table: Table, joints: Joints, coupling: Coupling, held: Mapping[str, float]
    ) -> Table:
        """Compute the positions of the motors of coupled joints, in place of those of joints."""
        if not coupling.joints:
            return table
        cells = {name: table.column(name) for name in table.names}
        positions = np.zeros((len(coupling.joints), next(iter(cells.values())).size))
        for q, name in zip(positions, coupling.joints, strict=True):
            q[:] = held.get(name, 0.0)
            if name in self.sources:
                drive = Drive(1.0, joints[name].motion, joints[name].motion)
                q[:] = joint_signal(_of_table(self.sources[name]), "position", table, drive)[0]
        motors = np.array(coupling.matrix) @ positions
        for position, name in zip(motors, coupling.joints, strict=True):
            if name in self.sources:
                column = f"position of the motor of {name}"
                cells[column] = position
                update = {"position": Position(column=column, unit=SI), "velocity": None}
                self.sources[name] = self.sources[name].model_copy(update=update)
            elif np.ptp(position) > 0.0:
                hint = "couple joints of the log only"
                raise BadInput(f"joints.{name}.held", "its motor moves with another", hint)
        names = [*cells]
        return Table(table.where, names, lambda i: cells[names[i]], notes=table.notes)

    def _keep(self, every: tuple[Table, Array, tuple[int, int]], row_limit: int) -> None:
        """Keep the chosen rows; of more than ``row_limit`` some, as segments all over the log."""
        self.table, self._stamps, (first, last) = every
        if last - first > row_limit:
            # start and stop count from the first row
            parts = [np.arange(a, b) + first for a, b in spread_ranges(last - first, row_limit)]
            rows = np.unique(np.concatenate([np.zeros(1, dtype=np.intp), *parts]))
            self.table, self._stamps = self.table.at(rows, self.rows), self._stamps[rows]

    def _position(self, source: Columns, joint: UrdfJoint, table: Table) -> Array:
        try:
            if source.position is None:
                raise BadInput(table.where, "has no position", "name its column")
            return table.values(source.position.column)
        except BadInput as error:
            hint = f"{error.hint}; or give its constant position: joints.{joint.name}.held = 0.0"
            raise BadInput(error.where, f"joint {joint.name!r}: {error.problem}", hint) from None

    def _joint_motion(self, joint: UrdfJoint) -> Measurement | float:
        """Read the motion of a joint, or its constant position."""
        source, column = self.sources[joint.name], "in place of a torque"
        drive = Drive(1.0, joint.motion, joint.motion)
        position = joint_signal(_of_table(source), "position", self.table, drive)[0]
        if np.ptp(position) == 0.0:
            return float(position[0])
        # the motion does not depend on the drive, which may be missing
        no_drive = dict.fromkeys(("current", "voltage", "target"))
        motion_only = {**no_drive, "torque": Torque(column=column, unit=SI)}
        columns = self._columns(source.model_copy(update=motion_only), {column: self._stamps})
        motion = self._read(columns, joint)
        return replace(motion, torque=np.zeros_like(motion.torque))

    def _read(self, recording: Recording, joint: UrdfJoint) -> Measurement:
        motion = joint.motion
        return read_recordings(
            recording, ratio=1.0, motion=motion, motor_motion=motion, processing=self._processing
        )[0]

    def _columns(
        self, source: Columns, computed: Mapping[str, Array], scale: float = 1.0
    ) -> Recording:
        """Take one joint's columns into memory, efforts over ``scale``, and ``computed`` ones."""
        from_log = (name for name in map(_name, source.columns) if name not in computed)
        cells = {name: self.table.column(name) for name in from_log} | dict(computed)
        if effort := source.torque or source.current or source.voltage:
            cells[_name(effort.column)] = cells[_name(effort.column)] / scale
        document = source.model_dump(exclude_unset=True, exclude_none=True)
        keys = {k: v for k, v in document.items() if k in Columns.model_fields}
        for channel in (keys[key] for key in CHANNELS if key in keys):
            channel |= {k: _name(channel[k]) for k in ("column", "times") if k in channel}
        if "valid" in keys:
            keys["valid"] = _name(keys["valid"])
        if _URDF_TORQUE in computed:
            keys["load_torque"] = {"column": _URDF_TORQUE, "unit": SI, "sign": -1}
            deviations = (name for name in computed if name != _URDF_TORQUE)
            keys["others"] = [*map(_name, source.others), *deviations]
        cells[_STAMPS], keys["rate"] = self._stamps, None
        keys["time"] = {"column": _STAMPS, "unit": "s"}
        names, notes = list(cells), self.table.notes
        table = Table(str(self.path), names, lambda i: cells[names[i]], notes=notes)
        columns = Columns.model_validate(keys)
        return Recording(columns, table=table, needed_rate=self._needed_rate)


def signals(count: int) -> list[str]:
    """Name the columns of the rigid-body torque's deviations."""
    return [f"urdf_{k}" for k in range(1, count + 1)]


def _name(key: str | int) -> str:
    return key if isinstance(key, str) else f"column {key}"


def _of_table(source: Columns) -> Position:
    """Return the position's channel with the name that its column has in a log's table."""
    assert source.position is not None
    return source.position.model_copy(update={"column": _name(source.position.column)})


def _source(document: Mapping[str, Any]) -> Source:
    """Check the keys of one joint's columns."""
    try:
        return Source.model_validate(document)
    except ValidationError as error:
        raise configuration_error("recording.", "recording", error, document, Source) from None
