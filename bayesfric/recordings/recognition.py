"""From a log to the columns that a recording needs, by their names and the units beside them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from bayesfric.base.errors import BadInput, nearest
from bayesfric.recordings import units
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.tables.table import Table

# Signals of one column that are looked at.
_MOST_OF_ONE = 64
# Columns that number the recordings of a log of several.
_EPISODES = ("episode_index", "episode", "episode_id", "run", "trial")
_DRIVES = ("torque", "current", "voltage")
# What has such a rank was wanted, not measured.
_WANTED = 10.0
# Words for each channel, the surest first.
_WORDS = {
    "time": "time timestamp t stamp clock seconds zeit received",
    "velocity": "velocity velocities vel qd dq qvel qdot speed omega v",
    "torque": "torque torques tau effort efforts trq moment force load",
    "current": "current currents iq curr cur amps ampere i",
    "voltage": "voltage volts volt pwm duty u",
    "temperature": "temperature temp",
    "position": "position positions pos q qpos angle theta phi encoder enc qm state winkel",
    # not what was measured, or not of the joint
    "wanted": "target desired goal command commanded cmd ref reference setpoint des sp action "
    "error limit max min raw bus input supply",
    "measured": "actual measured meas estimate est feedback",
    # nothing of which joint it is
    "": "joint joints motor observation observations obs header in the output axis data value "
    "values signal log electrical control",
}
_LISTS = {channel: words.split() for channel, words in _WORDS.items()}
_CHANNELS = list(_WORDS)[:7]
# Letters that say something only where they are the whole name.
_LETTERS = {"t", "v", "i", "u"}
_KINDS: dict[str, tuple[units.Kind, ...]] = {
    "time": ("time",),
    "position": ("angle", "length"),
    "velocity": ("angular_speed", "speed"),
    "torque": ("torque", "force"),
    "current": ("current",),
    "voltage": ("voltage",),
}
# Units as they are written in names, where pint would not read them so.
_SPELT: dict[str, dict[str, str]] = {
    "time": {"sec": "s", "secs": "s", "seconds": "s", "msec": "ms", "usec": "us", "nsec": "ns"},
    "position": {"degrees": "deg", "°": "deg", "rev": "turn", "revs": "turn", "turns": "turn"},
    "velocity": {
        **{"rads": "rad/s", "radps": "rad/s", "rad s": "rad/s", "degs": "deg/s", "dps": "deg/s"},
        **{"degps": "deg/s", "deg s": "deg/s", "°/s": "deg/s", "rps": "turn/s", "1/min": "rpm"},
        **{"rev/s": "turn/s", "turns/s": "turn/s", "u/min": "rpm", "hz": "turn/s"},
    },
    "torque": {"nm": "N m", "mnm": "mN m", "n m": "N m", "n": "N"},
    "current": {"a": "A", "ma": "mA", "amps": "A"},
    "voltage": {"v": "V", "mv": "mV", "volts": "V"},
}
_BRACKETS = re.compile(r"[\[(]([^\[\]()]*)[\])]\s*$")
_PARTS = re.compile(r"(?:m[AV]|mNm|Nm)(?![A-Za-z])|[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+|°")


@dataclass(frozen=True)
class Chosen:
    """A column taken for a channel; ``unit`` is empty where neither name nor file tells it."""

    channel: str
    column: str
    unit: str
    others: tuple[str, ...] = ()  # columns that could be meant as well


@dataclass(frozen=True)
class Log:
    """What was recognised in a log."""

    chosen: dict[str, Chosen]  # by channel
    columns: tuple[str | int, ...]  # all that there are
    joint: str = ""  # the one that was chosen of several
    joints: tuple[str, ...] = ()
    where: dict[str, float] = field(default_factory=dict)  # rows of the first recording of several


@dataclass(frozen=True)
class _Signal:
    column: str
    values: Array
    said: Named


def recognise(table: Table, joint: str | None = None) -> Log:
    """Take the columns of one joint, which may be named, out of a table by their names.

    Raises
    ------
    BadInput
        If there is no such joint.
    """
    table, where = _one_episode(table)
    signals = sorted(_signals(table), key=lambda s: s.said.rank)
    places = _of("position", signals)
    sure = [s for s in places if s.said.rank < places[0].said.rank + 0.5 * _WANTED]
    joints = tuple(dict.fromkeys(s.said.joint for s in sure))
    label = _joint(table, joints, joint)
    found = {
        "time": [s for s in _of("time", signals) if np.all(np.diff(s.values) > 0.0)],
        "position": [s for s in places if s.said.joint == label],
        "velocity": _same(_of("velocity", signals), label),
    }
    for channel in _DRIVES:
        same = [s for s in _same(_of(channel, signals), label) if s.said.rank < _WANTED]
        if same:
            rest = [s for s in signals if s.said.channel in _DRIVES and s is not same[0]]
            found[channel] = [same[0], *rest]
            break
    warm = [s for s in _same(_of("temperature", signals), label) if s.said.unit]
    found["temperature"] = warm[:1]
    return Log(
        {key: _chosen(key, same) for key, same in found.items() if same},
        tuple(name or number for number, name in enumerate(table.names, start=1)),
        label,
        joints if len(joints) > 1 else (),
        where,
    )


def _one_episode(table: Table) -> tuple[Table, dict[str, float]]:
    for name in _EPISODES:
        with suppress(BadInput):  # there is none, or it holds text
            numbers = table.column(name)
            if np.ptp(numbers) > 0.0:
                where = {name: float(numbers[0])}
                return table.only(where), where
    return table, {}


def _signals(table: Table) -> Iterator[_Signal]:
    """Read what has a name that tells: vectors, and parts of wider columns."""
    for name, written in zip(table.names, table.units or [""] * len(table.names), strict=True):
        if not named(name).channel:
            continue
        keys = [name]
        try:
            table.column(name)
        except BadInput:
            # the fourth signal of three is refused, which ends a column of several
            keys = [f"{name}[{k}]" for k in range(_MOST_OF_ONE)]
            # a message that names its joints may have them in any order
            if any(other.startswith(f"{name}[") for other in table.names):
                continue
        with suppress(BadInput):
            for key in keys:
                yield _Signal(key, table.column(key), named(key, written))


def _of(channel: str, signals: Sequence[_Signal]) -> list[_Signal]:
    return [s for s in signals if s.said.channel == channel]


def _same(signals: Sequence[_Signal], joint: str) -> list[_Signal]:
    """Take the signals of a joint; those that name none if it has none."""
    for label in (joint, ""):
        if same := [s for s in signals if s.said.joint == label]:
            return same
    return list(signals)


def _joint(table: Table, joints: Sequence[str], wanted: str | None) -> str:
    if wanted is None:
        return joints[0] if joints else ""
    found = next((one for one in joints if one.lower() == wanted.lower()), None)
    if found is None:
        raise BadInput(
            f"{table.where}, --joint {wanted}", "there is no such joint", nearest(wanted, joints)
        )
    return found


def _chosen(channel: str, signals: Sequence[_Signal]) -> Chosen:
    first, *others = signals
    return Chosen(channel, first.column, first.said.unit, tuple(s.column for s in others))


@dataclass(frozen=True)
class Named:
    """What a column's name says."""

    channel: str  # key of a channel, empty if nothing is recognised
    rank: float  # lower is surer; from 10 on it is not what was measured
    joint: str  # which joint, empty if the name does not tell
    unit: str  # empty if the name does not tell


def named(name: str, written: str = "") -> Named:
    """Take a column's name apart; ``written`` is a unit that the file gives for it elsewhere."""
    text, inside = name.strip(), ""
    if found := _BRACKETS.search(text):
        text, inside = text[: found.start()], found[1].strip()
    text = text.rpartition("/")[2].replace("i_q", "iq").replace("I_q", "Iq")
    words = [part.lower() for part in _PARTS.findall(text)]
    channel, rank = _channel(words)
    if not channel:
        return Named("", 0.0, inside, "")
    unit = _unit_of(channel, written) or _unit_of(channel, inside)
    joint = [] if not inside or (unit and not written) else [inside]
    left = [w for w in words if w not in _LISTS[channel]]
    for count in (2, 1):
        if not unit and len(left) >= count:
            unit = _unit_of(channel, " ".join(left[-count:]))
            left = left[:-count] if unit else left
    rank += 10.0 * any(w in _LISTS["wanted"] for w in left)
    rank -= 0.5 * any(w in _LISTS["measured"] for w in left)
    label = [w for w in left if not any(w in known for known in _LISTS.values())]
    return Named(channel, rank, " ".join([*label, *joint]), unit)


def _channel(words: list[str]) -> tuple[str, float]:
    """Choose the channel whose word stands last, as in ``motor current`` and ``pos_estimate``."""
    alone = sum(not word.isdecimal() for word in words) == 1
    for word in reversed(words):
        if word in _LETTERS and not alone:
            continue
        for channel in _CHANNELS:
            if word in _LISTS[channel]:
                return channel, 0.1 * _LISTS[channel].index(word)
    return "", 0.0


def _unit_of(channel: str, text: str) -> str:
    """Give a unit as a configuration writes it; empty where it is none of the channel's kind."""
    text = text.strip().strip("[]()").strip()
    spelt = _SPELT.get(channel, {}).get(text.lower(), text)
    if channel == "temperature":
        return spelt if spelt in ("degC", "°C", "K") else ""
    is_unit = any(map(str.isalpha, spelt))
    return spelt if is_unit and any(units.is_of(spelt, kind) for kind in _KINDS[channel]) else ""
