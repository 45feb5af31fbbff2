"""A log of an arm: which column belongs to which joint, and the motion of all joints."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from bayesfric.arm.arm_options import ArmOptions, JointOptions
from bayesfric.arm.inertial_prior import UrdfJoint
from bayesfric.base.errors import BadInput
from bayesfric.base.options import configuration_error
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.filters import derivative, lowpass_above, reach_of
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
from bayesfric.recordings.recognition import named, recognise
from bayesfric.recordings.signals import filtered_motion
from bayesfric.recordings.source import CHANNELS, SI, Columns, Recording, Source, Torque
from bayesfric.recordings.tables import Table
from bayesfric.recordings.units import OPEN

_URDF_TORQUE, _STAMPS = "urdf_torque", "stamps in s"
Joints = Mapping[str, UrdfJoint]
# Columns of a log with {joint} for a joint's label, and the label of each joint.
Layout = tuple[Mapping[str, Any], Mapping[str, str]]


def layout_of(
    path: Path, joints: Joints, layout: Mapping[str, Any], *, in_order: bool = False
) -> Layout:
    """Recognise the columns of a log's joints by the names of the URDF's joints.

    With ``in_order`` as many joints of other names are matched in the URDF's order.
    """

    def joint_in(name: str) -> str:
        """Return the part of a column's name that identifies its joint."""
        return named(f"{name} position").joint or name

    opened = read_table(path, TableOptions.model_validate(layout))
    log = recognise(opened)
    label_of = {joint_in(label): label for label in log.joints or [log.joint]}
    labels = {name: label_of[joint_in(name)] for name in joints if joint_in(name) in label_of}
    if not labels and in_order and len(label_of) == len(joints):
        labels = dict(zip(joints, label_of.values(), strict=True))
    if not labels:
        in_log = ", ".join(filter(None, label_of.values())) or "none"
        problem = f"joints of the log ({in_log}) are not those of the URDF ({', '.join(joints)})"
        hint = "match them in arm.toml ('bayesfric init arm --from LOG --urdf URDF')"
        raise BadInput(str(path), problem, hint)
    first, tokens = dict[str, dict[str, str]](), dict[str, str]()
    for name, label in labels.items():
        joint = recognise(opened, label)
        chosen = {key: (str(column), unit) for key, (column, unit) in joint.chosen.items()}
        chosen.pop("temperature", None)
        columns = [c for key, (c, _) in chosen.items() if key != "time" and c != OPEN]
        if not in_order and OPEN in [column for column, _ in chosen.values()]:
            hint = "write [recording] in arm.toml ('bayesfric init arm --from LOG --urdf URDF')"
            raise BadInput(str(path), "; ".join(joint.problems), hint)
        candidates = (name, label, "_".join(label.split()))
        token = next((t for t in candidates if t and all(t in column for column in columns)), "")
        tokens[name] = token
        pattern = {
            k: {"column": column, "unit": unit or OPEN} for k, (column, unit) in chosen.items()
        }
        for key in pattern.keys() - {"time"} if token else ():
            pattern[key]["column"] = pattern[key]["column"].replace(token, "{joint}")
        if "current" in pattern:
            pattern["current"]["torque_constant"] = "{torque_constant}"
        first = first or pattern
        if not token or pattern != first:
            problem = f"columns of joint {name!r} ({', '.join(columns)}) do not match other joints'"
            raise BadInput(str(path), problem, "write [recording] in arm.toml, with {joint}")
    return {**first, **layout, **({"where": log.where} if log.where else {})}, tokens


class ArmLog:
    """One log of an arm, of which at most ``max_samples`` rows are kept.

    ``sources`` holds the meaning of the columns by joint, ``loaded`` whether the payload is on,
    ``time`` ``(n,)`` s, ``motion`` ``(3, n_joints, n)`` position, speed and acceleration in the
    URDF's order. The motion is low-passed as widely as any joint's fit may be: each fit filters the
    rigid-body torque as it filters the measured one.
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
        recording, labels = layout
        self.sources: dict[str, Columns] = {}
        for number, joint_name in enumerate(joints, start=1):
            joint_options = options.joints.get(joint_name, JointOptions())
            if joint_options.held is not None:
                continue
            placeholders = {
                "joint": joint_options.label or labels.get(joint_name, joint_name),
                "number": str(number),
                "index": str(number - 1),
                "torque_constant": joint_options.torque_constant,
            }
            document = {**recording, "file": str(path), "name": name}
            self.sources[joint_name] = _source(document, joint_name, placeholders)
        if not self.sources:
            raise BadInput(str(path), "all joints are held", "leave out the held of one that moves")
        keys = {key: recording[key] for key in TableOptions.model_fields if key in recording}
        self._open(read_table(path, TableOptions.model_validate(keys)), joints, max_samples)
        held = {name: x.held for name, x in options.joints.items() if x.held is not None}
        motions = [held[n] if n in held else self._joint_motion(x) for n, x in joints.items()]
        moving = [motion for motion in motions if isinstance(motion, Measurement)]
        if not moving:
            raise BadInput(str(path), "no joint moves in it", "record the arm while it moves")
        self.time, fs = moving[0].time, 1.0 / moving[0].period
        lowpass, order = options.processing.lowpass, options.processing.order
        cutoff = lowpass_above(fs, fs) if lowpass is None else lowpass
        reach = reach_of(options.processing.differentiation, cutoff, fs)
        self.motion = np.zeros((3, len(motions), self.time.size))
        for k, motion in enumerate(motions):
            if isinstance(motion, Measurement):
                q, qd = filtered_motion(motion, cutoff, order, reach)
                qdd = derivative(qd, motion.segments, motion.period, reach)
                self.motion[:, k] = q, qd, qdd
            else:
                self.motion[0, k] = motion

    @property
    def fitted(self) -> int:
        """Number of rows that are kept; ``rows`` is that of the file."""
        return self._stamps.size

    def measured(self, joint: UrdfJoint) -> Measurement:
        """Read a joint with its effort."""
        return self._read(self._columns(self.sources[joint.name], {}), joint)

    def recording(self, joint: UrdfJoint, torques: Array) -> Recording:
        """Add rigid-body torque and its deviations ``(1 + k, n)`` to a joint's columns.

        They are at the times of :attr:`motion`.
        """
        names = [_URDF_TORQUE, *signals(len(torques) - 1)]
        pairs = zip(names, torques, strict=True)
        computed = {name: np.interp(self._stamps, self.time, x) for name, x in pairs}
        return self._columns(self.sources[joint.name], computed)

    def _open(self, table: Table, joints: Joints, max_samples: int) -> None:
        """Read all joints' columns, at the rows in which each has a value.

        Of more than ``max_samples`` rows some are kept, as segments all over the log.
        """
        columns = list[str | int]()
        for name, source in self.sources.items():
            drive = Drive(1.0, joints[name].motion, joints[name].motion)
            self._position(source, joints[name], table)
            with suppress(BadInput):  # a drive that is missing is refused with its joint
                self.sources[name], table = decoded(source, table, drive)
            for column in source.columns:
                with suppress(BadInput):
                    columns += [] if table.holes(column).all() else [column]
        source, *_ = self.sources.values()
        other_channels = dict.fromkeys(set(CHANNELS) - {"time", "position"})
        source = source.model_copy(update={**other_channels, "others": tuple(columns)})
        _, table, self._stamps = aligned(source, table, drive)
        cells = {_name(column): table.column(column) for column in columns}
        names, self.rows = list(cells), self._stamps.size
        self.table = Table(str(self.path), names, lambda i: cells[names[i]], notes=table.notes)
        first, last = chosen_rows(source, self._stamps, self.table.where)
        if last - first > max_samples:
            # start and stop count from the first row
            parts = [np.arange(a, b) + first for a, b in spread_ranges(last - first, max_samples)]
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
        assert source.position is not None
        channel = source.position.model_copy(update={"column": _name(source.position.column)})
        drive = Drive(1.0, joint.motion, joint.motion)
        position = joint_signal(channel, "position", self.table, drive)[0]
        if np.ptp(position) == 0.0:
            return float(position[0])
        # the motion does not depend on the drive, which may be missing
        no_drive = dict.fromkeys(("current", "voltage", "target"))
        motion_only = {**no_drive, "torque": Torque(column=column, unit=SI)}
        columns = self._columns(source.model_copy(update=motion_only), {column: position})
        return self._read(columns, joint)

    def _read(self, recording: Recording, joint: UrdfJoint) -> Measurement:
        motion = joint.motion
        return read_recordings(
            recording, ratio=1.0, motion=motion, motor_motion=motion, processing=self._processing
        )[0]

    def _columns(self, source: Columns, computed: Mapping[str, Array]) -> Recording:
        """Take the columns of one joint into memory, in addition to ``computed`` ones."""
        from_log = map(_name, (key for key in source.columns if key not in computed))
        cells = {name: self.table.column(name) for name in from_log} | dict(computed)
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
        return Recording(Columns.model_validate(keys), table=table)


def signals(count: int) -> list[str]:
    """Name the columns of the rigid-body torque's deviations."""
    return [f"urdf_{k}" for k in range(1, count + 1)]


def _name(key: str | int) -> str:
    return key if isinstance(key, str) else f"column {key}"


def _source(
    recording: Mapping[str, Any], joint: str, placeholders: Mapping[str, str | None]
) -> Source:
    """Fill the placeholders in the texts of ``recording`` for one joint."""
    text = json.dumps(recording, default=str)
    for key, value in placeholders.items():
        if value is None and f"{{{key}}}" in text:
            hint = "write its drive gain, such as '13.6 N m/A'"
            raise BadInput(f"joints.{joint}.{key}", "is missing", hint)
        text = text.replace(f"{{{key}}}", json.dumps(value)[1:-1])
    document = json.loads(text)
    try:
        return Source.model_validate(document)
    except ValidationError as error:
        raise configuration_error("recording.", "recording", error, document, Source) from None
