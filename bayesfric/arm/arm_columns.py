"""The columns of an arm's log by joint: as ``arm.toml`` has them, by their names, or their order.

A log of ROS or of a driver often names no units, and a headerless one no columns. What is assumed
then is returned in words.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import cumulative_trapezoid

from bayesfric.arm.arm_options import ArmOptions
from bayesfric.arm.inertial_prior import UrdfJoint
from bayesfric.base.errors import BadInput
from bayesfric.recordings import units
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import implausible
from bayesfric.recordings.readers import TableOptions, read_table
from bayesfric.recordings.recognition import named, recognise
from bayesfric.recordings.source import CHANNELS, SI
from bayesfric.recordings.tables import Table
from bayesfric.recordings.units import OPEN

Joints = Mapping[str, UrdfJoint]
Layout = dict[str, dict[str, Any]]  # by joint a [[recordings]] table without file
_DRIVES = {"torque", "current", "voltage", "target"}
_INIT = "write them in arm.toml ('bayesfric init arm --from LOG --urdf URDF')"


def layout_of(
    path: Path, joints: Joints, options: ArmOptions, effort_unit: str | None = None
) -> tuple[Layout, str]:
    """Take each joint's columns from the options, else recognise them in a log.

    Returns what is assumed, too.
    """
    recording, assumed, without_unit = options.recording, list[str](), set[str]()
    present = [name for name in joints if options.of(name).held is None]
    if not present:
        raise BadInput(str(path), "all joints are held", "leave out the held of one that moves")
    recognised: Layout = {name: {} for name in present}
    if "position" not in recording:
        keys = {key: recording[key] for key in TableOptions.model_fields if key in recording}
        recognised, assumed = recognised_layout(path, joints, keys)
    layout: Layout = {}
    for name in present:
        if name not in recognised:
            hint = f"give its constant position: joints.{name}.held = 0.0"
            raise BadInput(str(path), f"has no joint {name!r} ({', '.join(recognised)})", hint)
        by_options = _filled(recording, name, joints, present, options)
        known = recognised[name]
        if not by_options.keys().isdisjoint(_DRIVES):
            known = {key: channel for key, channel in known.items() if key not in _DRIVES}
        document = _filled(known, name, joints, present, options) | by_options
        if effort_unit is not None:
            if "torque" not in document:
                hint = "name their column 'effort'"
                raise BadInput("--effort-unit", f"the log has no effort of {name!r}", hint)
            document["torque"] |= {"unit": effort_unit}
        for key in known:
            channel = document[key]
            if channel.get("column") == OPEN:
                raise BadInput(str(path), f"{'; '.join(assumed)}: which is the {key}?", _INIT)
            if channel.get("kp") == OPEN:
                raise BadInput(str(path), "has targets, of which kp and kd are not known", _INIT)
            if channel.get("unit") == OPEN:
                channel["unit"] = SI
                without_unit.add(key)
        layout[name] = document
    if without_unit:
        problem = f"SI units are assumed where the log has none ({', '.join(sorted(without_unit))})"
        assumed.append(f"{problem}; else [recording] in arm.toml, or --effort-unit")
    return layout, ". ".join(assumed)


def recognised_layout(
    path: Path, joints: Joints, keys: Mapping[str, Any], *, in_order: bool = False
) -> tuple[Layout, list[str]]:
    """Recognise the columns of the joints of a log, open where a unit or column is not known.

    ``keys`` are those of a table. With ``in_order`` as many joints of other names are matched in
    the URDF's order, and no joint where numbers differ.
    """
    table = read_table(path, TableOptions.model_validate(keys))
    if not any(table.names):
        return _by_place(table, joints)
    log = recognise(table)
    in_log = log.joints or (log.joint,)
    labels, notes = _matched(in_log, joints, in_order=in_order)
    if not labels:
        in_text = ", ".join(filter(None, in_log)) or "none"
        problem = f"joints of the log ({in_text}) are not those of the URDF ({', '.join(joints)})"
        if not in_order:
            raise BadInput(str(path), problem, _INIT)
        notes = [problem]
    layout: Layout = {}
    for name, label in labels.items():
        recognised = recognise(table, label or None)
        document: dict[str, Any] = {"where": log.where} if log.where else {}
        for key, (column, unit) in recognised.chosen.items():
            if key == "time" and not unit and column != OPEN:
                unit = _time_unit(table.values(column))
                assumed = f"time: column {column!r} in {unit}"
                notes += [] if assumed in notes else [assumed]
            document[key] = {"column": column, "unit": unit or OPEN}
            document[key] |= dict([recognised.decoding[key]] if key in recognised.decoding else [])
        if "current" in document:
            document["current"]["torque_constant"] = "{torque_constant}"
        layout[name] = document
        notes += [problem for problem in recognised.problems if problem not in notes]
    if all(document.keys().isdisjoint(_DRIVES) for document in layout.values()):
        for name, label in labels.items():
            if target := _target_of(table, label):
                column, unit = target
                gains = {"kp": OPEN, "kd": OPEN}
                layout[name]["target"] = {"column": column, "unit": unit or OPEN, **gains}
    return layout, notes


def _target_of(table: Table, joint: str) -> tuple[str, str] | None:
    """Find the column of the target position of a joint as labelled in a log, and its unit."""
    for name in table.names:
        meaning = named(f"position {name}")
        if meaning.wanted and meaning.channel == "position":
            with suppress(BadInput):
                for key in table.signals(name):
                    if (meaning := named(f"position {key}")).joint == joint:
                        return key, meaning.unit
    return None


def _matched(
    labels: Sequence[str], joints: Joints, *, in_order: bool
) -> tuple[dict[str, str], list[str]]:
    """Match the joints of a log to those of the URDF: by name, or else by number.

    Returns the label of each joint, and what is assumed.
    """

    def joint_in(name: str) -> str:
        """Return the part of a column's name that identifies its joint."""
        return named(f"{name} position").joint or name

    label_of = {joint_in(label): label for label in labels}
    matched = {name: label_of[joint_in(name)] for name in joints if joint_in(name) in label_of}
    numbered = {n: label for label in labels if (n := _number(label)) is not None}
    by_number = {_number(name): name for name in reversed([*joints])}  # an arm before its gripper
    from_zero = 0 in numbered and 0 not in by_number
    if matched and not from_zero:
        return matched, []
    all_numbered, matched = len(numbered) == len(labels), {}
    shifted = {n + from_zero: label for n, label in sorted(numbered.items())}
    if all_numbered and shifted.keys() <= by_number.keys():
        matched = {by_number[n]: label for n, label in shifted.items()}
    elif (all_numbered or in_order) and len(labels) == len(joints):
        matched = dict(zip(joints, shifted.values() if all_numbered else labels, strict=True))
    pairs = ", ".join(f"{label} is {name}" for name, label in matched.items())
    return matched, [f"Joints of the log by their order: {pairs}"] if matched else []


def _number(name: str) -> int | None:
    """Return the number at a name's end."""
    digits = re.search(r"(\d{1,4})\W*$", name)
    return None if digits is None else int(digits[1])


def _by_place(table: Table, joints: Joints) -> tuple[Layout, list[str]]:
    """Recognise the columns of a log without names: a time, then a block for each signal.

    A block has a column for each joint in the URDF's order. Of three blocks or more the velocity
    is that which integrates to the position; the effort is what remains, if that is one block.
    """
    columns = [table.values(k) for k in range(1, len(table.names) + 1)]
    clock = next((k for k, x in enumerate(columns) if x.size > 1 and np.all(np.diff(x) > 0)), None)
    count = len(joints)
    others = [k for k in range(len(columns)) if k != clock]
    if clock is None or len(others) % count or len(others) < 2 * count:
        problem = f"its {len(columns)} columns have no names, and are not a time and as many for "
        raise BadInput(table.where, f"{problem}each of {count} joints", "add a line of names")
    unit = _time_unit(columns[clock])
    blocks = [others[k : k + count] for k in range(0, len(others), count)]
    time = columns[clock] * (1.0 if unit == OPEN else units.scale([unit], "time"))
    values = [np.stack([columns[k] for k in block]) for block in blocks]
    derivative = {
        a: b
        for a in range(len(blocks))
        for b in range(len(blocks))
        if a != b and _is_derivative(values[b], values[a], time)
    }
    position = next((a for a in derivative if a not in derivative.values()), 0)
    velocity = derivative.get(position)
    motion = {position, velocity, derivative.get(-1 if velocity is None else velocity)}
    rest = [k for k in range(len(blocks)) if k not in motion]
    places = {"position": position, "velocity": velocity}
    places["torque"] = rest[0] if len(rest) == 1 else None
    taken = {key: blocks[k] for key, k in places.items() if k is not None}
    layout: Layout = {}
    for place, name in enumerate(joints):
        document = {"time": {"column": clock + 1, "unit": unit}}
        document |= {key: {"column": b[place] + 1, "unit": OPEN} for key, b in taken.items()}
        layout[name] = {"torque": {"column": OPEN, "unit": OPEN}} | document
    parts = [f"{key} {block[0] + 1} to {block[-1] + 1}" for key, block in taken.items()]
    return layout, [f"Columns by their order: time {clock + 1} ({unit}), {', '.join(parts)}"]


def _is_derivative(velocity: Array, position: Array, time: Array) -> bool:
    """Whether signals ``(n_joints, n)`` are the derivatives of others, by integration."""
    for v, q in zip(velocity, position, strict=True):
        x = np.stack([cumulative_trapezoid(v, time, initial=0), time, np.ones_like(time)], axis=1)
        slopes = np.linalg.lstsq(x, q, rcond=None)[0]
        close = np.var(q - x @ slopes) <= 0.05 * np.var(q)
        if np.ptp(q) > 0.0 and not (close and abs(slopes[0] - 1.0) < 0.2):
            return False
    return bool(np.ptp(velocity) > 0.0)


def _time_unit(stamps: Array) -> str:
    """Choose the unit of time stamps in which a joint may be recorded so."""
    stamps = stamps[np.isfinite(stamps)]
    period, span = float(np.median(np.diff(stamps))), float(stamps[-1] - stamps[0])
    for unit, scale in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        if not implausible(scale * period, scale * span):
            return unit
    return OPEN


def _filled(
    recording: Mapping[str, Any],
    joint: str,
    joints: Joints,
    present: Sequence[str],
    options: ArmOptions,
) -> dict[str, Any]:
    """Fill placeholders for one joint, and take its entry of lists, one for each of ``present``."""
    document = dict[str, Any]()
    for key, channel in recording.items():
        lists = {k: v for k, v in channel.items() if isinstance(v, list)} if key in CHANNELS else {}
        for k, entries in lists.items():
            if len(entries) != len(present):
                problem = f"has {len(entries)} entries for {len(present)} joints"
                raise BadInput(f"recording.{key}.{k}", problem, f"give one of {', '.join(present)}")
        entry = {k: entries[present.index(joint)] for k, entries in lists.items()}
        document[key] = {**channel, **entry} if lists else channel
    text, index = json.dumps(document, default=str), [*joints].index(joint)
    placeholders = {
        "joint": options.of(joint).label or joint,
        "number": str(index + 1),
        "index": str(index),
        "torque_constant": options.of(joint).torque_constant,
    }
    for key, value in placeholders.items():
        if value is None and f"{{{key}}}" in text:
            hint = "write its drive gain in arm.toml, such as '13.6 N m/A'"
            raise BadInput(f"joints.{joint}.{key}", "is missing", hint)
        text = text.replace(f"{{{key}}}", json.dumps(value)[1:-1])
    return dict(json.loads(text))
