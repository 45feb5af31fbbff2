"""A log of an arm: which column is what of which joint, and the motion of them all."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError

from bayesfric.arm.arm_options import ArmOptions, JointOptions
from bayesfric.arm.inertial_prior import UrdfJoint
from bayesfric.base.errors import BadInput
from bayesfric.base.options import configuration_error
from bayesfric.recordings import channels
from bayesfric.recordings.acting import filtered_motion
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.filters import derivative, reach_of
from bayesfric.recordings.measurement import Measurement, stretches
from bayesfric.recordings.read import chosen_rows, read_recordings, recorded_time
from bayesfric.recordings.recognition import named, recognise
from bayesfric.recordings.recording import Recording
from bayesfric.recordings.resolution import lowpass_above
from bayesfric.recordings.source import CHANNELS, SI, Columns, Source, Torque
from bayesfric.recordings.tables import Table, read_table
from bayesfric.recordings.tables.reader import TableOptions
from bayesfric.recordings.units import OPEN

URDF_TORQUE = "urdf_torque"
_NO_TORQUE, _STAMPS = "in place of a torque", "time"
Joints = Mapping[str, UrdfJoint]


class Layout(NamedTuple):
    """Columns of a log with ``{joint}`` for a joint's label, and the label of each joint."""

    recording: Mapping[str, Any]
    labels: Mapping[str, str]


def layout_of(path: Path, joints: Joints, table: str | None, *, in_order: bool = False) -> Layout:
    """Recognise the columns of a log's joints by the names that these have in the URDF.

    With ``in_order`` as many joints of other names are taken in the URDF's order.

    Raises
    ------
    BadInput
        If that does not tell which column is whose.
    """
    opened = read_table(path, TableOptions.model_validate({"table": table}))
    log = recognise(opened)
    known = {_plain(label): label for label in log.joints or [log.joint]}
    labels = {name: known[_plain(name)] for name in joints if _plain(name) in known}
    if not labels and in_order and len(known) == len(joints):
        labels = dict(zip(joints, known.values(), strict=True))
    if not labels:
        there = ", ".join(filter(None, known.values())) or "none"
        what = f"joints of the log ({there}) are not those of the URDF ({', '.join(joints)})"
        mend = "say which is which in arm.toml ('bayesfric init arm --from LOG --urdf URDF')"
        raise BadInput(str(path), what, mend)
    patterns, tokens = list[dict[str, dict[str, str]]](), dict[str, str]()
    for name, label in labels.items():
        chosen = recognise(opened, label).chosen
        chosen.pop("temperature", None)
        own = [one.column for key, one in chosen.items() if key != "time"]
        tries = (name, label, "_".join(label.split()))
        token = tokens[name] = next((t for t in tries if t and all(t in one for one in own)), "")
        pattern = {k: {"column": c.column, "unit": c.unit or OPEN} for k, c in chosen.items()}
        for key in pattern.keys() - {"time"} if token else ():
            pattern[key]["column"] = pattern[key]["column"].replace(token, "{joint}")
        if "current" in pattern:
            pattern["current"]["torque_constant"] = "{torque_constant}"
        patterns.append(pattern)
        if not token or pattern != patterns[0]:
            what = f"columns of joint {name!r} ({', '.join(own)}) are not called as another's"
            raise BadInput(str(path), what, "write [recording] in arm.toml, with {joint}")
    more = {"table": table, "where": log.where or None}
    return Layout({**patterns[0], **{k: v for k, v in more.items() if v}}, tokens)


def _plain(name: str) -> str:
    """Give what tells a joint from others, as a column's name is read."""
    return named(f"{name} position").joint or name


class ArmLog:
    """One log of an arm.

    Attributes
    ----------
    name
        What it is called.
    table
        The log, read.
    rows
        How many it has; of them the table keeps those that are fitted.
    sources
        What the columns mean, by joint, of those that are in the log.
    loaded
        Whether the payload is on.
    time
        ``(n,)`` s.
    motion
        ``(3, n_joints, n)`` position, speed and acceleration of all joints in the URDF's order,
        low-passed as wide as any joint's fit may be: what that lets pass each fit takes off the
        torque of the bodies as off the measured one.

    Raises
    ------
    BadInput
        If the log cannot be read, or a joint's position is neither in it nor in ``arm.toml``.
    """

    def __init__(
        self,
        path: Path,
        called: str,
        options: ArmOptions,
        layout: Layout,
        joints: Joints,
        most: int,
    ) -> None:
        given = options.processing
        self.path, self.name, self._given = path, called, given
        on = options.payload.logs
        self.loaded = on is None or called in on
        self.sources: dict[str, Source] = {}
        motions: list[Measurement | float] = []
        for number, (name, joint) in enumerate(joints.items(), start=1):
            own = options.joints.get(name, JointOptions())
            if own.held is not None:
                motions.append(own.held)
                continue
            told = {
                "joint": own.label or layout.labels.get(name, name),
                "number": str(number),
                "index": str(number - 1),
                "torque_constant": own.torque_constant,
            }
            document = {**layout.recording, "file": str(path), "name": called}
            source = _source(document, name, told)
            first, self.sources[name] = not self.sources, source
            if first:
                self.table = read_table(path, source)
                self._keep(most, source, self._position(joint).size)
            motions.append(self._moved(joint))
        moving = [one for one in motions if isinstance(one, Measurement)]
        if not moving:
            raise BadInput(str(path), "no joint moves in it", "record the arm while it moves")
        self.time, fs = moving[0].time, 1.0 / moving[0].period
        cutoff = lowpass_above(fs, fs) if given.lowpass is None else given.lowpass
        reach = reach_of(given.differentiation, cutoff, fs)
        self.motion = np.zeros((3, len(motions), self.time.size))
        for k, one in enumerate(motions):
            if isinstance(one, Measurement):
                q, qd = filtered_motion(one, cutoff, given.order, reach)
                self.motion[:, k] = q, qd, derivative(qd, one.segments, one.period, reach)
            else:
                self.motion[0, k] = one

    @property
    def fitted(self) -> int:
        """How many rows are fitted."""
        return self._stamps.size

    def measured(self, joint: UrdfJoint) -> Measurement:
        """Read a joint with its effort.

        Raises
        ------
        BadInput
            If it does not move, or the effort is missing or never changes.
        """
        return self._read(self._columns(self.sources[joint.name], {}), joint)

    def effort(self, joint: UrdfJoint) -> Array:
        """Give what :meth:`measured` reads at the times of :attr:`motion`, ``(n,)`` N m or N."""
        one = self.measured(joint)
        return np.interp(self.time, one.time, one.torque)

    def recording(self, joint: UrdfJoint, torques: Array) -> Recording:
        """Put beside a joint's columns the torque of the URDF's bodies and what that may be off by.

        ``torques`` are ``(1 + k, n)`` at the times of :attr:`motion`.
        """
        source = self.sources[joint.name]
        time = self._stamps
        if source.time is not None:  # a joint may have stamps of its own
            time = recorded_time(source, self.table, time.size)
        names = [URDF_TORQUE, *signals(len(torques) - 1)]
        pairs = zip(names, torques, strict=True)
        return self._columns(source, {n: np.interp(time, self.time, x) for n, x in pairs})

    def _keep(self, most: int, source: Source, count: int) -> None:
        """Keep so many of ``count`` rows at most, in stretches all over what is asked for."""
        self.rows, self._stamps = count, recorded_time(source, self.table, count)
        first, last = chosen_rows(source, self._stamps, self.table.where)
        # a channel of stamps of its own has rows of its own
        own = (getattr(getattr(source, key), "times", None) is not None for key in CHANNELS)
        if last - first > most and not any(own):
            # the first row is the one from which start and stop count
            parts = [np.arange(a, b) + first for a, b in stretches(last - first, most)]
            rows = np.unique(np.concatenate([np.zeros(1, dtype=np.intp), *parts]))
            self.table, self._stamps = self.table.at(rows, count), self._stamps[rows]

    def _position(self, joint: UrdfJoint) -> Array:
        source, drive = self.sources[joint.name], channels.Drive(1.0, joint.motion, joint.motion)
        try:
            return channels.joint_signal(source.position, "position", self.table, drive)[0]
        except BadInput as error:
            mend = f"{error.mend}; or say where it is held: joints.{joint.name}.held = 0.0"
            raise BadInput(error.where, f"joint {joint.name!r}: {error.what}", mend) from None

    def _moved(self, joint: UrdfJoint) -> Measurement | float:
        """Read the motion of a joint, or where it stands."""
        source, position = self.sources[joint.name], self._position(joint)
        if np.ptp(position) == 0.0:
            return float(position[0])
        # what drives it may be missing, and says nothing of the motion
        no_drive = dict.fromkeys(("current", "voltage", "target"))
        alone = {**no_drive, "torque": Torque(column=_NO_TORQUE, unit=SI)}
        moved = self._columns(source.model_copy(update=alone), {_NO_TORQUE: position})
        return self._read(moved, joint)

    def _read(self, recording: Recording, joint: UrdfJoint) -> Measurement:
        motion = joint.motion
        return read_recordings(
            recording, ratio=1.0, motion=motion, motor_motion=motion, processing=self._given
        )[0]

    def _columns(self, source: Source, more: Mapping[str, Array]) -> Recording:
        """Take the columns of one joint into memory, with ``more`` beside them."""
        read = (key for key in source.columns if key not in more)
        cells = {_name(key): self.table.column(key) for key in read} | dict(more)
        given = source.model_dump(exclude_unset=True, exclude_none=True)
        keys = {k: v for k, v in given.items() if k in Columns.model_fields}
        for channel in (keys[key] for key in CHANNELS if key in keys):
            channel |= {k: _name(channel[k]) for k in ("column", "times") if k in channel}
        if "valid" in keys:
            keys["valid"] = _name(keys["valid"])
        if URDF_TORQUE in more:
            keys["load_torque"] = {"column": URDF_TORQUE, "unit": SI, "sign": -1}
            keys["others"] = [*map(_name, source.others), *(n for n in more if n != URDF_TORQUE)]
        if source.time is None:
            cells[_STAMPS], keys["rate"] = self._stamps, None
            keys["time"] = {"column": _STAMPS, "unit": "s"}
        names = list(cells)
        table = Table(str(self.path), names, lambda i: cells[names[i]])
        return Recording(Columns.model_validate(keys), table=table)


def signals(count: int) -> list[str]:
    """Name the columns of what the URDF's torque may be off by."""
    return [f"urdf_{k}" for k in range(1, count + 1)]


def _name(key: str | int) -> str:
    return key if isinstance(key, str) else f"column {key}"


def _source(recording: Mapping[str, Any], joint: str, told: Mapping[str, str | None]) -> Source:
    """Say what the columns of one joint mean: ``recording`` with what is ``told`` in its texts."""
    text = json.dumps(recording, default=str)
    for key, value in told.items():
        if value is None and f"{{{key}}}" in text:
            mend = "write its drive gain, such as '13.6 N m/A'"
            raise BadInput(f"joints.{joint}.{key}", "is missing", mend)
        text = text.replace(f"{{{key}}}", json.dumps(value)[1:-1])
    document = json.loads(text)
    try:
        return Source.model_validate(document)
    except ValidationError as error:
        raise configuration_error("recording.", "recording", error, document, Source) from None
