"""From a log to the columns that a recording needs, by their names and the units beside them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from bayesfric.errors import BadInput, nearest
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.column_names import Named, name_words, named
from bayesfric.recordings.tables.table import Table

# Signals of one column that are looked at.
_MOST_OF_ONE = 64
# Columns that number the recordings of a log of several, and those that tell when a motor was on.
_EPISODES = ("episode_index", "episode", "episode_id", "run", "trial")
_USE = {"enable", "enabled", "valid"}
_DRIVES = ("torque", "current", "voltage")
# What has such a rank was wanted, not measured.
_WANTED = 10.0


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
    valid: str = ""  # a column that may tell when the motor was on


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
        next((name for name in table.names if _USE.intersection(name_words(name))), ""),
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
