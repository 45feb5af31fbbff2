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
from bayesfric.recordings.tables import Table

_DRIVES = ("torque", "current", "voltage")
# Words for each channel, the most specific first.
_WORDS = {
    "time": "time timestamp t stamp clock seconds received",
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
# Units in names that pint would read otherwise.
_SPELT = {
    **dict.fromkeys(("rads", "radps", "rad s"), "rad/s"),
    **dict.fromkeys(("degs", "degps", "deg s", "dps"), "deg/s"),
    **{"nm": "N m", "n m": "N m", "mnm": "mN m", "n": "N", "a": "A", "ma": "mA", "v": "V"},
}
_CHANNEL = {
    word: (channel, rank) for channel in _KINDS for rank, word in enumerate(_WORDS[channel].split())
}
_BRACKETS = re.compile(r"[\[(]([^\[\]()]*)[\])]\s*$")
_PARTS = re.compile(r"(?:m[AV]|mNm|Nm)(?![A-Za-z])|[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+|°")


class Chosen(NamedTuple):
    """A column chosen for a channel; ``unit`` is empty where unknown."""

    column: str
    unit: str


@dataclass(frozen=True)
class Log:
    """Recognised columns of a log."""

    chosen: dict[str, Chosen]  # by channel
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
    joints = tuple(dict.fromkeys(name.joint for *_, name in signals if name.channel == "position"))
    label = next((j for j in joints if joint is None or j.lower() == joint.lower()), None)
    if label is None and joint is not None:
        where_not = f"{table.where}, --joint {joint}"
        raise BadInput(where_not, "there is no such joint", nearest(joint, joints))
    chosen: dict[str, Chosen] = {}
    for channel in ("time", "position", "velocity", *_DRIVES):
        if channel in _DRIVES and not chosen.keys().isdisjoint(_DRIVES):
            continue
        of = [
            (column, name)
            for column, values, name in signals
            if name.channel == channel and (channel != "time" or np.all(np.diff(values) > 0.0))
        ]
        if of:
            # the joint's, or else one without a joint
            column, name = min(of, key=lambda s: (s[1].joint != label, s[1].joint != ""))
            chosen[channel] = Chosen(column, name.unit)
    columns = tuple(name or number for number, name in enumerate(table.names, start=1))
    return Log(chosen, columns, label or "", joints if len(joints) > 1 else (), where)


def _one_episode(table: Table) -> tuple[Table, dict[str, float]]:
    """Select the first of several recordings in a log, where a column numbers them."""
    for name in ("episode_index", "episode", "episode_id", "run", "trial"):
        with suppress(BadInput):  # there is none, or it holds text
            numbers = table.column(name)
            if np.ptp(numbers) > 0.0:
                where = {name: float(numbers[0])}
                return table.only(where), where
    return table, {}


def _signals(table: Table) -> Iterator[tuple[str, Array, Named]]:
    """Read the columns of recognised names: vectors, and parts of wider columns."""
    for name, written in zip(table.names, table.units or [""] * len(table.names), strict=True):
        if not named(name).channel:
            continue
        with suppress(BadInput):
            yield name, table.column(name), named(name, written)
            continue
        # a message that names its joints may have them in any order
        if any(other.startswith(f"{name}[") for other in table.names):
            continue
        with suppress(BadInput):  # the fourth signal of three, which ends a column of several
            for key in (f"{name}[{k}]" for k in range(64)):
                yield key, table.column(key), named(key, written)


def named(name: str, written: str = "") -> Named:
    """Parse a column's name, and the unit ``written`` in the file; the last known word counts."""
    text, inside = name.strip(), ""
    if brackets := _BRACKETS.search(text):
        text, inside = text[: brackets.start()], brackets[1].strip()
    text = text.rpartition("/")[2].replace("i_q", "iq").replace("I_q", "Iq")
    words = [part.lower() for part in _PARTS.findall(text)]
    alone = sum(not word.isdecimal() for word in words) == 1
    known_words = [w for w in words if w in _CHANNEL and (alone or w not in _LETTERS)]
    if not known_words:
        return Named("", 0, False, inside, "")
    channel, rank = _CHANNEL[known_words[-1]]
    left = [w for w in words if w not in _WORDS[channel].split()]
    # texts that may be the unit, and how many of the remaining words they take
    texts = ((written, 0), (inside, 0), (" ".join(left[-2:]), 2), (" ".join(left[-1:]), 1))
    unit, used = next(((u, n) for t, n in texts if (u := _unit_of(channel, t))), ("", 0))
    known = " ".join(_WORDS.values()).split()
    label = [w for w in left[: max(len(left) - used, 0)] if w not in known]
    label += [inside] if inside and not _unit_of(channel, inside) else []
    wanted = any(w in _WORDS["wanted"].split() for w in left)
    return Named(channel, rank, wanted, " ".join(label), unit)


def _unit_of(channel: str, text: str) -> str:
    """Return a unit as in a configuration; empty where it is not of the channel's kind."""
    text = text.strip().strip("[]()").strip()
    spelt = _SPELT.get(text.lower(), text)
    is_unit = any(map(str.isalpha, spelt))
    return spelt if is_unit and any(units.is_of(spelt, kind) for kind in _KINDS[channel]) else ""
