"""A log of an arm: which column is what of which joint, and the motion of them all."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from bayesfric.arm.arm_options import ArmOptions, JointOptions
from bayesfric.arm.bodies import Motions, UrdfJoint
from bayesfric.base.configuration_errors import configuration_error
from bayesfric.base.errors import BadInput
from bayesfric.recordings import channels
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.filters import derivative, reach_of
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.observation import filtered_motion
from bayesfric.recordings.processing import Processing
from bayesfric.recordings.read import read_recordings
from bayesfric.recordings.recognition import named, recognise
from bayesfric.recordings.recording import Recording
from bayesfric.recordings.resolution import lowpass_above
from bayesfric.recordings.source import CHANNELS, SI, Columns, Source, Torque
from bayesfric.recordings.tables import Table, read_table
from bayesfric.recordings.tables.reader import TableOptions
from bayesfric.recordings.units import OPEN

URDF_TORQUE = "urdf_torque"
_ANY = "in place of a torque"
Joints = Mapping[str, UrdfJoint]


@dataclass(frozen=True)
class Layout:
    """Columns of a log, with ``{joint}`` for a joint's label, and the label of each joint."""

    recording: dict[str, Any]
    labels: dict[str, str]


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
    found: dict[str, Any] = {"table": table} if table else {}
    found |= {"where": log.where} if log.where else {}
    tokens = {}
    for name, label in labels.items():
        chosen = {
            k: one for k, one in recognise(opened, label).chosen.items() if k != "temperature"
        }
        own = [one.column for key, one in chosen.items() if key != "time"]
        token = next((t for t in (name, label, "_".join(label.split())) if _in_all(t, own)), "")
        pattern = {
            key: {"column": _put(one.column, token, key), "unit": one.unit or OPEN}
            | ({"torque_constant": "{torque_constant}"} if key == "current" else {})
            for key, one in chosen.items()
        }
        if not token or pattern != (first := found.setdefault("channels", pattern)):
            several = (
                own if not token else [c["column"] for c in (*first.values(), *pattern.values())]
            )
            what = f"columns of joint {name!r} are not called as others' ({', '.join(several)})"
            raise BadInput(str(path), what, "name them alike, or write [recording] in arm.toml")
        tokens[name] = token
    return Layout({**found.pop("channels"), **found}, tokens)


def _plain(name: str) -> str:
    """Give what tells a joint from others, as a column's name is read."""
    return named(f"{name} position").joint or name


def _in_all(token: str, columns: list[str]) -> bool:
    return bool(token) and all(token in column for column in columns)


def _put(column: str, token: str, key: str) -> str:
    return column if key == "time" else column.replace(token, "{joint}")


def source_of(path: Path, options: ArmOptions, layout: Layout, joint: str, number: int) -> Source:
    """Say what the columns of one joint mean.

    Raises
    ------
    BadInput
        Naming the key of ``[recording]`` that cannot be used.
    """
    own = options.joints.get(joint, JointOptions())
    told = {
        "joint": own.label or layout.labels.get(joint, joint),
        "number": str(number),
        "index": str(number - 1),
        **({"torque_constant": own.torque_constant} if own.torque_constant else {}),
    }
    document = {"file": str(path), "name": path.stem, **_filled(layout.recording, told, joint)}
    try:
        return Source.model_validate(document)
    except ValidationError as error:
        raise configuration_error("recording.", "recording", error, document, Source) from None


def _filled(value: Any, told: Mapping[str, str], joint: str) -> Any:
    if isinstance(value, Mapping):
        return {key: _filled(one, told, joint) for key, one in value.items()}
    if isinstance(value, list):
        return [_filled(one, told, joint) for one in value]
    if isinstance(value, str):
        for key, text in told.items():
            value = value.replace(f"{{{key}}}", text)
        if "{torque_constant}" in value:
            mend = "write its drive gain, such as '13.6 N m/A'"
            raise BadInput(f"joints.{joint}.torque_constant", "is missing", mend)
    return value


class ArmLog:
    """One log of an arm.

    Attributes
    ----------
    sources
        What the columns mean, by joint, of those that are in the log.
    motion
        Of all joints in the URDF's order, low-passed as wide as any joint's fit may be; what that
        lets pass each fit takes off the torque of the bodies as off the measured one.
    grid
        A measurement with the time base of the motion; its torque means nothing.

    Raises
    ------
    BadInput
        If the log cannot be read, or the motion of a joint is in it no more than in ``arm.toml``.
    """

    def __init__(
        self, path: Path, options: ArmOptions, layout: Layout, joints: Joints, given: Processing
    ) -> None:
        self.path, self._given = path, given
        self.sources: dict[str, Source] = {}
        self._table: Table | None = None
        motions: dict[str, Measurement | float] = {}
        for number, (name, joint) in enumerate(joints.items(), start=1):
            held = options.joints.get(name, JointOptions()).held
            if held is not None:
                motions[name] = held
                continue
            source = source_of(path, options, layout, name, number)
            if self._table is None:
                self._table = read_table(path, source)
            self.sources[name] = source
            motions[name] = self._moved(joint)
        found = [one for one in motions.values() if isinstance(one, Measurement)]
        if not found:
            raise BadInput(str(path), "no joint moves in it", "record the arm while it moves")
        self.grid, fs = found[0], 1.0 / found[0].period
        cutoff = lowpass_above(fs, fs) if given.lowpass is None else given.lowpass
        reach = reach_of(given.differentiation, cutoff, fs)
        every = [self._filtered(one, cutoff, reach) for one in motions.values()]
        self.motion = Motions(*(np.stack(part) for part in zip(*every, strict=True)))

    @property
    def table(self) -> Table:
        """The log, read."""
        assert self._table is not None
        return self._table

    def measured(self, joint: UrdfJoint) -> Measurement:
        """Read a joint with its effort.

        Raises
        ------
        BadInput
            If it does not move, or the effort is missing or stands still.
        """
        return self._read(self._columns(self.sources[joint.name], joint.name, {}), joint)

    def recording(self, joint: UrdfJoint, torques: Array) -> Recording:
        """Put beside a joint's columns the torque of the URDF's bodies and what that may be off by.

        ``torques`` are ``(1 + k, n)`` on the grid.
        """
        names = [URDF_TORQUE, *signals(len(torques) - 1)]
        source = self.sources[joint.name]
        stamps = self._stamps(source)
        more = {
            name: np.interp(stamps, self.grid.time, values)
            for name, values in zip(names, torques, strict=True)
        }
        return self._columns(source, joint.name, more)

    def _moved(self, joint: UrdfJoint) -> Measurement | float:
        """Read the motion of a joint; where it stands if it does not move."""
        source = self.sources[joint.name]
        try:
            position, _ = channels.joint_signal(
                source.position,
                "position",
                self.table,
                channels.Drive(1.0, joint.motion, joint.motion),
            )
        except BadInput as error:
            mend = f"{error.mend}; or say where it is held: joints.{joint.name}.held = 0.0"
            raise BadInput(error.where, f"joint {joint.name!r}: {error.what}", mend) from None
        if np.ptp(position) == 0.0:
            return float(position[0])
        # what drives it may be missing, and says nothing of the motion
        no_drive = dict.fromkeys(("current", "voltage", "target"))
        alone = source.model_copy(update={**no_drive, "torque": Torque(column=_ANY, unit=SI)})
        return self._read(self._columns(alone, joint.name, {_ANY: position}), joint)

    def _read(self, recording: Recording, joint: UrdfJoint) -> Measurement:
        return read_recordings(
            recording,
            ratio=1.0,
            motion=joint.motion,
            motor_motion=joint.motion,
            processing=self._given,
        )[0]

    def _filtered(self, one: Measurement | float, cutoff: float, reach: int) -> tuple[Array, ...]:
        if not isinstance(one, Measurement):
            still = np.zeros_like(self.grid.time)
            return still + one, still, still
        q, qd = filtered_motion(one, cutoff, self._given.order, reach)
        return q, qd, derivative(qd, one.segments, one.period, reach)

    def _columns(self, source: Source, joint: str, more: Mapping[str, Array]) -> Recording:
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
        names = list(cells)
        table = Table(f"{self.path}, joint {joint}", names, lambda i: cells[names[i]])
        return Recording(Columns.model_validate(keys), table=table)

    def _stamps(self, source: Columns) -> Array:
        if source.time is None:
            assert source.rate is not None
            return np.arange(self.table.column(source.position.column).size) / source.rate
        time = channels.scaled(source.time, self.table, "time", "time")
        return np.asarray(time - time[0])


def signals(count: int) -> list[str]:
    """Name the columns of what the URDF's torque may be off by."""
    return [f"urdf_{k}" for k in range(1, count + 1)]


def _name(key: str | int) -> str:
    return key if isinstance(key, str) else f"column {key}"


def remarks(joint: UrdfJoint, one: Measurement, urdf: Array) -> Iterator[str]:
    """Say what of a joint's log looks wrong beside the URDF.

    Its effort is regressed on the bodies' torque ``urdf`` ``(n,)``, Coulomb and viscous friction:
    where bodies are most of it, their factor is about one.
    """
    low, high = joint.limits
    reach = float(np.ptp(one.position))
    if low < high and reach > 1.5 * (high - low):
        yield (
            f"its positions range over {reach:.3g}, and the URDF's limits over {high - low:.3g}: "
            "are they in the unit that is given?"
        )
    with suppress(np.linalg.LinAlgError):
        speed = np.gradient(one.position, one.time)
        columns = np.stack([urdf, np.sign(speed), speed, np.ones_like(urdf)], axis=1)
        factor = float(np.linalg.lstsq(columns, one.torque, rcond=None)[0][0])
        share = abs(factor) * float(np.std(urdf)) / max(float(np.std(one.torque)), 1e-300)
        if share > 0.5 and not 0.5 < factor < 2.0:
            what = "the opposite sign" if -2.0 < factor < -0.5 else "another unit or drive gain"
            yield f"its effort is {factor:.2g} times the URDF's torque: does it have {what}?"
