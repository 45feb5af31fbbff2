"""Recognition of the columns of a log by their names and units."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from bayesfric.base.errors import BadInput, nearest
from bayesfric.recordings import units
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.tables import Table, as_dates

_DRIVES = ("torque", "current", "voltage")
# Words for each channel, the most specific first.
_WORDS = {
    "time": "time timestamp timestamps t ts stamp clock elapsed seconds millis micros received",
    "position": "position positions pos q qpos angle theta phi encoder enc qm state",
    "velocity": "velocity velocities vel qd dq qvel qdot speed omega v",
    "torque": "torque torques tau effort efforts trq moment force load",
    "current": "current currents iq curr cur amps ampere i",
    "voltage": "voltage volts volt pwm duty u",
    # not what was measured, or not of the joint
    "wanted": "target desired goal command commanded cmd ref reference setpoint des sp action "
    "error limit max min raw bus input supply",
    # no name of a joint
    "": "joint joints motor observation observations obs header in the output axis data value "
    "values signal log electrical control actual measured meas estimate est feedback",
}
# Letters that count only as the whole name.
_LETTERS = {"t", "v", "i", "u"}
_KINDS: dict[str, tuple[units.Kind, ...]] = {
    "time": ("time",),
    "position": ("angle", "length"),
    "velocity": ("angular_speed", "speed"),
    "torque": ("torque", "force"),
    "current": ("current",),
    "voltage": ("voltage",),
}
# Outside brackets a word is a unit of these kinds only: a link, a hand or a foot is no length.
_NAMED_KINDS = ("time", "angle", "angular_speed", "torque", "current", "voltage")
# Units in names that pint would read otherwise.
_SPELT = {
    **dict.fromkeys(("rads", "radps", "rad s"), "rad/s"),
    **dict.fromkeys(("degs", "degps", "deg s", "dps"), "deg/s"),
    **{"m s": "m/s", "mm s": "mm/s", "mm": "mm"},
    **{"nm": "N m", "n m": "N m", "mnm": "mN m", "a": "A", "ma": "mA", "v": "V"},
    **{"unm": "uN m", "knm": "kN m", "cnm": "cN m", "ua": "uA", "millis": "ms", "micros": "us"},
}
_CHANNEL = {
    word: (channel, rank) for channel in _KINDS for rank, word in enumerate(_WORDS[channel].split())
}
_BRACKETS = re.compile(r"[\[(]([^\[\]()]*)[\])]\s*$")
_FACTOR = re.compile(r"\d\.?\d*[A-Za-zµμ°]+$")  # a number before the unit at a name's end
_PREFIXES = {"nano", "micro", "milli", "centi", "kilo", "mega"}
_PARTS = re.compile(r"(?:[mukcµμ]?[AV]|[mukcµμ]?Nm)(?![A-Za-z])|[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+|°")


@dataclass(frozen=True)
class Log:
    """Recognised columns of a log."""

    chosen: dict[str, tuple[str, str]]  # column and its unit, empty if unknown, by channel
    columns: tuple[str | int, ...]  # all columns
    joint: str = ""  # chosen of several
    joints: tuple[str, ...] = ()
    where: dict[str, float] = field(default_factory=dict)  # rows of the first recording of several


class Named(NamedTuple):
    """Meaning of a column's name."""

    channel: str  # key of a channel, empty if nothing is recognised
    rank: int  # lower is surer
    wanted: bool  # whether it is a command, not measured
    joint: str  # empty if unknown
    unit: str  # empty if unknown


def recognise(table: Table, joint: str | None = None) -> Log:
    """Choose the columns of one joint, which may be named, by their names."""
    table, where = _one_episode(table)
    signals = sorted((s for s in _signals(table) if not s[2].wanted), key=lambda s: s[2].rank)
    ranges = dict[str, float]()
    for _, values, name in signals:
        if name.channel == "position":
            ranges.setdefault(name.joint, float(np.nanmax(values) - np.nanmin(values)))
    if joint is None:  # a constant column is no torque; a joint that is named may stand still
        signals = [
            s for s in signals if s[2].channel not in _DRIVES or np.nanmax(s[1]) > np.nanmin(s[1])
        ]
    joints, least = tuple(ranges), 0.01 * max(ranges.values(), default=0.0)
    # a joint that stands still says nothing; noise of its encoder is no motion
    moving = (j for j in joints if ranges[j] > least) if joint is None else joints
    # joint_2 is joint 2
    wanted = () if joint is None else (joint.lower(), named(f"{joint} position").joint)
    label = next((j for j in moving if joint is None or j.lower() in wanted), None)
    if label is None and joint is not None:
        where_not = f"{table.where}, --joint {joint}"
        raise BadInput(where_not, "there is no such joint", nearest(joint, joints))
    chosen: dict[str, tuple[str, str]] = {}
    for channel in ("time", "position", "velocity", *_DRIVES):
        if channel in _DRIVES and not chosen.keys().isdisjoint(_DRIVES):
            continue
        of = [
            (column, name)
            for column, values, name in signals
            if name.channel == channel
            and (channel != "time" or np.all(np.diff(values[np.isfinite(values)]) > 0.0))
        ]
        if of:
            # the joint's, or else one without a joint
            column, name = min(of, key=lambda s: (s[1].joint != label, s[1].joint != ""))
            chosen[channel] = column, name.unit
    columns = tuple(name or number for number, name in enumerate(table.names, start=1))
    # a column that names no joint is none to choose
    return Log(chosen, columns, label or "", tuple(filter(None, joints)) * (len(joints) > 1), where)


def _one_episode(table: Table) -> tuple[Table, dict[str, float]]:
    """Select the first of several recordings in a log, where a column numbers them."""
    for name in ("episode_index", "episode", "episode_id", "run", "trial"):
        with suppress(BadInput):  # there is none, or it holds text
            numbers = table.column(name)
            if numbers.size and np.ptp(numbers) > 0.0:
                where = {name: float(numbers[0])}
                return table.only(where), where
    return table, {}


def _signals(table: Table) -> Iterator[tuple[str, Array, Named]]:
    """Read the columns of recognised names: vectors, and parts of wider columns."""
    for name, written in zip(table.names, table.units or [""] * len(table.names), strict=True):
        if not named(name).channel:
            continue
        with suppress(BadInput):
            if named(name).channel == "time" and as_dates(table.cells(name)) is not None:
                written = "s"
            yield name, _numbers(table, name), named(name, written)
            continue
        # a message that names its joints may have them in any order
        if any(other.startswith((f"{name}[", f"{name}.")) for other in table.names):
            continue
        with suppress(BadInput):  # the fourth signal of three, which ends a column of several
            for key in (f"{name}[{k}]" for k in range(64)):
                yield key, _numbers(table, key), named(key, written)


def _numbers(table: Table, key: str) -> Array:
    """Return a column ``(n,)``, NaN where it has holes; other cells must be numbers."""
    rows = np.flatnonzero(~table.holes(key))
    if rows.size < 2:
        raise BadInput(table.label(key), "is empty", "check the export")
    table.at(rows, table.cells(key).shape[0]).column(key)
    return table.values(key)


def named(name: str, written: str = "") -> Named:
    """Parse a column's name, and the unit ``written`` in the file; the last known word counts."""
    text, inside = name.strip(), ""
    if brackets := _BRACKETS.search(text):
        text, inside = text[: brackets.start()], brackets[1].strip()
    text = text.rpartition("/")[2].replace("i_q", "iq").replace("I_q", "Iq")
    words = [part.lower() for part in _PARTS.findall(text)]
    alone = sum(not word.isdecimal() for word in words) == 1
    known_words = [
        w
        for w in words
        if w in _CHANNEL
        and (alone or w not in _LETTERS or _unit_of(_CHANNEL[w][0], " ".join(words[1:])))
    ]
    if not known_words:
        return Named("", 0, False, inside, "")
    channel, rank = _CHANNEL[known_words[-1]]
    left = [w for w in words if w not in _WORDS[channel].split()]
    # texts that may be the unit, and how many of the remaining words they take
    texts = [(written, 0, False), (inside, 0, False)]
    if _PREFIXES.isdisjoint(left):
        texts += [(" ".join(left[-2:]), 2, True), (" ".join(left[-1:]), 1, True)]
        texts += [(known_words[-1], 0, True)]
    units_in = ((_unit_of(channel, t, in_name=named), n) for t, n, named in texts)
    unit, used = next(((unit, n) for unit, n in units_in if unit), ("", 0))
    if not (written or inside) and _FACTOR.search(text):
        unit = ""  # of 0.1 deg or 10 mA: the user writes it
    known = " ".join(_WORDS.values()).split()
    label = [w for w in left[: max(len(left) - used, 0)] if w not in known]
    label += [inside] if inside and not _unit_of(channel, inside) else []
    wanted = any(w in _WORDS["wanted"].split() for w in left)
    return Named(channel, rank, wanted, " ".join(label), unit)


def _unit_of(channel: str, text: str, *, in_name: bool = False) -> str:
    """Return a unit as in a configuration; empty where it is not of the channel's kind."""
    text = text.strip().strip("[]()").strip()
    if in_name and any(map(str.isdecimal, text.split())):
        return ""  # the joint's number is no factor
    spelt = _SPELT.get(text.lower(), text)
    is_unit = any(map(str.isalpha, spelt))
    by_name = not in_name or text.lower() in _SPELT
    kinds = [kind for kind in _KINDS[channel] if by_name or kind in _NAMED_KINDS]
    return spelt if is_unit and any(units.is_of(spelt, kind) for kind in kinds) else ""
