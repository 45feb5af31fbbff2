"""From a log to the columns that a recording needs, each with the reason why it was chosen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from bayesfric.errors import BadInput, nearest
from bayesfric.recordings.measurement import Array
from bayesfric.recordings.recognition import values as by_value
from bayesfric.recordings.recognition.angle import angle_unit
from bayesfric.recordings.recognition.names import Named, named, tells_use
from bayesfric.recordings.tables.table import Table
from bayesfric.recordings.units import GUESSED, scale

# Signals that are looked at, and of one column.
_MOST_SIGNALS, _MOST_OF_ONE = 2000, 64
_LEAST = 20
# Columns that number the recordings of a log of several.
_EPISODES = ("episode_index", "episode", "episode_id", "run", "trial")
_DRIVES = ("torque", "current", "voltage")
# Share of a signal that a motion explains if it is what drives it.
_LIKELY = 0.5
_NAME_SETTLES = "by its name"


@dataclass(frozen=True)
class Chosen:
    """A column taken for a channel; ``unit`` ends with ``?`` where values alone suggest it."""

    channel: str
    column: str | int
    unit: str
    why: str
    others: tuple[str | int, ...] = ()  # columns that could be meant as well
    twos_complement: int | None = None
    sign: int = 1


@dataclass(frozen=True)
class Log:
    """What was recognised in a log."""

    chosen: tuple[Chosen, ...]
    rate: str = ""  # where no column tells time
    joint: str = ""  # the one that was chosen of several
    joints: tuple[str, ...] = ()
    where: dict[str, float] = field(default_factory=dict)  # rows that were looked at
    valid: str = ""  # a column that may tell when the motor was on
    unknown: tuple[str, ...] = ()  # one sentence for everything that the log does not tell

    def of(self, channel: str) -> Chosen | None:
        """Give what was taken for a channel."""
        return next((one for one in self.chosen if one.channel == channel), None)


@dataclass(frozen=True)
class _Signal:
    column: str | int
    values: Array
    said: Named


def recognise(table: Table, joint: str | None = None) -> Log:
    """Take the columns of one joint, which may be named, out of a table.

    Raises
    ------
    BadInput
        If no column can be the position, or there is no such joint.
    """
    table, where = _one_episode(table)
    signals = list(_signals(table))
    time = _time(signals)
    if time is not None:
        signals = [s for s in signals if s.column != time.column]
        stamps = _seconds(time, table)
    else:
        count = len(signals[0].values) if signals else 0
        stamps = np.arange(count, dtype=np.float64) * 1e-3
    valid = next((name for name in table.names if tells_use(name)), "")
    # a second clock is no signal
    signals = [s for s in signals if s.said.channel != "time"]
    moving = [s for s in signals if np.ptp(s.values) > 0.0]
    if not any(s.said.channel for s in moving):
        return _unnamed(table, time, stamps, moving, joint, where)
    return replace(_of_names(table, time, stamps, moving, joint, where), valid=valid)


def _one_episode(table: Table) -> tuple[Table, dict[str, float]]:
    for name in _EPISODES:
        with suppress(BadInput):  # there is none, or it holds text
            numbers = table.column(name)
            if np.ptp(numbers) > 0.0:
                where = {name: float(numbers[0])}
                return table.only(where), where
    return table, {}


def _signals(table: Table) -> Iterator[_Signal]:
    """Read whatever is a signal: vectors of the usual length, and parts of wider columns."""
    found: list[_Signal] = []
    for number, name in enumerate(table.names, start=1):
        key: str | int = name or number
        keys: list[str | int] = [key]
        written = table.units[number - 1] if number <= len(table.units) else ""
        try:
            table.column(key)
        except BadInput:
            # the fourth signal of three is refused, which ends a column of several
            keys = [f"{name}[{k}]" for k in range(_MOST_OF_ONE)] if name else []
            # a message that names its joints may have them in any order
            if any(other.startswith(f"{name}[") for other in table.names):
                continue
        for each in keys:
            try:
                values = table.column(each)
            except BadInput:
                break
            found.append(_Signal(each, values, named(str(each) if name else "", written)))
        if len(found) > _MOST_SIGNALS:
            break
    lengths = Counter(s.values.size for s in found if s.values.size >= _LEAST)
    if not lengths:
        raise BadInput(
            table.where,
            f"no column holds {_LEAST} numbers",
            "give the table inside the file with --table, or check the log",
        )
    usual = max(lengths, key=lambda n: (lengths[n], n))
    return iter([s for s in found if s.values.size == usual])


def _time(signals: Sequence[_Signal]) -> Chosen | None:
    """Choose the time stamps: by name, or what increases most evenly where there are no names."""
    rising = [s for s in signals if by_value.increases(s.values)]
    told = sorted((s for s in rising if s.said.channel == "time"), key=lambda s: s.said.rank)
    why = _NAME_SETTLES
    if not told and not any(s.said.channel for s in signals):
        told, why = rising, "the first column that always increases"
    if not told:
        return None
    first, others = told[0], tuple(s.column for s in told[1:])
    if first.said.unit:
        return Chosen("time", first.column, first.said.unit, why, others)
    period = float(np.median(np.diff(first.values)))
    unit = by_value.time_unit(period)
    said = f"{why}; a step of {period:.4g} would be {period:.3g} {unit}"
    return Chosen("time", first.column, unit + GUESSED, said, others)


def _seconds(time: Chosen, table: Table) -> Array:
    unit = time.unit.removesuffix(GUESSED)
    return table.column(time.column) * scale([unit], "time")


def _of_names(
    table: Table,
    time: Chosen | None,
    stamps: Array,
    signals: Sequence[_Signal],
    joint: str | None,
    where: dict[str, float],
) -> Log:
    places = [s for s in signals if s.said.channel == "position"]
    if not places:
        raise BadInput(
            table.where,
            "no column is named as a position",
            "name it 'position', or write the configuration from 'bayesfric init PRESET'",
        )
    best = min(s.said.rank for s in places)
    joints = tuple(dict.fromkeys(s.said.joint for s in places if s.said.rank < best + 5.0))
    chosen_joint = _joint(table, joints, joint)
    position = _best([s for s in places if s.said.joint == chosen_joint])
    others = tuple(
        s.column for s in places if s.said.joint == chosen_joint and s.column != position.column
    )
    speeds = [s for s in signals if s.said.channel == "velocity"]
    speeds = _same(speeds, chosen_joint)
    velocity = _best(speeds) if speeds else None
    told: list[Chosen] = [] if time is None else [time]
    drive, unknown = _drive(signals, {position.column}, chosen_joint, position, stamps)
    effort = next((s.values for s in signals for one in drive if s.column == one.column), None)
    more = tuple(s.column for s in speeds)
    told += [*_motion(position, velocity, stamps, others, more, effort), *drive]
    warm = _same([s for s in signals if s.said.channel == "temperature"], chosen_joint)
    if warm and warm[0].said.unit:
        told.append(Chosen("temperature", warm[0].column, warm[0].said.unit, _NAME_SETTLES))
    return _log(told, time, chosen_joint, joints, where, unknown)


def _log(
    told: Sequence[Chosen],
    time: Chosen | None,
    joint: str,
    joints: tuple[str, ...],
    where: dict[str, float],
    unknown: Sequence[str],
) -> Log:
    more = list(unknown)
    rate = ""
    if time is None:
        rate = f"1 kHz{GUESSED}"
        more.append("no column tells time: give the sampling rate")
    several = joints if len(joints) > 1 else ()
    return Log(tuple(told), rate, joint, several, where, unknown=tuple(more))


def _joint(table: Table, joints: Sequence[str], wanted: str | None) -> str:
    if wanted is None:
        return joints[0]
    found = next((one for one in joints if one.lower() == wanted.lower()), None)
    if found is None:
        raise BadInput(
            f"{table.where}, --joint {wanted}", "there is no such joint", nearest(wanted, joints)
        )
    return found


def _best(signals: Sequence[_Signal]) -> _Signal:
    return min(signals, key=lambda s: s.said.rank)


def _same(signals: Sequence[_Signal], joint: str) -> list[_Signal]:
    """Take the signals of a joint, the surest first; those that name none if it has none."""
    for label in (joint, ""):
        if same := [s for s in signals if s.said.joint == label]:
            return sorted(same, key=lambda s: s.said.rank)
    return sorted(signals, key=lambda s: s.said.rank)


def _motion(
    position: _Signal,
    velocity: _Signal | None,
    stamps: Array,
    others: tuple[str | int, ...],
    speeds: tuple[str | int, ...],
    effort: Array | None = None,
) -> Iterator[Chosen]:
    """Settle the units of position and velocity together: one is the other's derivative."""
    q = position.values
    angle, why = position.said.unit, _NAME_SETTLES
    speed, reason, sign = "", "", 1
    if velocity is not None:
        speed, reason = velocity.said.unit, _NAME_SETTLES
        factor = by_value.speed_factor(q, velocity.values, stamps)
        fit = [] if factor is None else by_value.pairs(factor, angle, speed)
        if factor is None:
            reason = "it is not the position's derivative: look at it, or leave it out"
        elif not fit:
            reason = f"it is {factor:.4g} times the differentiated position, which no unit explains"
        else:
            sign = -1 if factor < 0.0 else 1
            likely = angle_unit(q, stamps, effort)[0]
            first = next((one for one in fit if one[0] == (angle or likely)), fit[0])
            alike = f"{abs(factor):.4g} times the differentiated position"
            if not angle and abs(abs(factor) - 1.0) > 0.5:
                why = f"the velocity is {alike}: {first[0]} and {first[1]}"
                angle = first[0] + GUESSED
            if not speed:
                speed, reason = first[1] + GUESSED, f"it is {alike}: {first[0]} and {first[1]}"
    if not angle:
        angle, why = angle_unit(q, stamps, effort)
        angle += GUESSED
    yield Chosen("position", position.column, angle, why, others)
    if velocity is not None:
        more = tuple(column for column in speeds if column != velocity.column)
        unit = speed or f"rad/s{GUESSED}"
        yield Chosen("velocity", velocity.column, unit, reason, more, sign=sign)


def _drive(
    signals: Sequence[_Signal],
    taken: set[str | int],
    joint: str,
    position: _Signal,
    stamps: Array,
) -> tuple[list[Chosen], list[str]]:
    """Choose what drives the joint: by name, or else what its motion explains best."""
    for channel in _DRIVES:
        same = _same([s for s in signals if s.said.channel == channel], joint)
        same = [s for s in same if s.said.rank < 10.0]
        if same:
            more = tuple(s.column for s in signals if s.said.channel in _DRIVES and s != same[0])
            return [_effort(channel, same[0], _NAME_SETTLES, more)], []
    # what is wanted is no measurement, and what has a name is something else
    left = [s for s in signals if s.column not in taken and not s.said.channel]
    left = [s for s in left if not by_value.increases(s.values)]
    if not left:
        return [], ["no column can be torque, current or voltage"]
    found = _most_explained(left, position, stamps)
    return [found], ["no column is named as torque, current or voltage"]


def _most_explained(
    left: Sequence[_Signal], position: _Signal, stamps: Array, stride: int = 0
) -> Chosen:
    """Choose by what the motion explains, in tables of equal blocks that of the same place."""
    q = position.values
    left = [s for s in left if not by_value.alike(s.values, q)] or list(left)
    shares = {s.column: by_value.explained(s.values, q, stamps) for s in left}
    order = sorted(left, key=lambda s: -shares[s.column])
    first, why = order[0], "of what is left, the joint's motion explains most of it"
    for s in left:
        at = int(s.column) - int(position.column) if stride else 1
        if stride and at % stride == 0 and shares[s.column] > _LIKELY:
            first, why = (
                s,
                f"it stands {at} columns behind the position, and the motion explains it",
            )
            break
    more = tuple(s.column for s in order if s is not first)[:5]
    return _effort("torque", first, f"{why} ({shares[first.column]:.0%})", more)


def _effort(channel: str, signal: _Signal, why: str, more: tuple[str | int, ...]) -> Chosen:
    unit, bits = signal.said.unit, by_value.bits(signal.values)
    if not unit:
        largest = float(np.abs(signal.values).max())
        kind = {"torque": "N m", "current": "A", "voltage": "V"}[channel]
        why += f"; up to {largest:.4g}"
        if by_value.whole(signal.values):
            why += ", whole numbers: counts or thousandths, not in the log of what"
        unit = kind + GUESSED
    return Chosen(channel, signal.column, unit, why, more, twos_complement=bits)


def _unnamed(
    table: Table,
    time: Chosen | None,
    stamps: Array,
    signals: Sequence[_Signal],
    joint: str | None,
    where: dict[str, float],
) -> Log:
    """Look for a position and its speed where no column has a name that tells."""
    found = by_value.derivatives([s.values for s in signals], stamps)
    if not found:
        raise BadInput(
            table.where,
            "no column's name tells what it is, and none is the speed of another",
            "name the columns, or write the configuration from 'bayesfric init PRESET'",
        )
    # of joints that stand next to each other the number counts; else the one that moves most
    numbers = {str(k + 1): pair for k, pair in enumerate(found)}
    most = max(numbers, key=lambda k: float(np.ptp(signals[numbers[k][0]].values)))
    label = most if joint is None else _joint(table, tuple(numbers), joint)
    i, j, _ = numbers[label]
    position, velocity = signals[i], signals[j]
    told = [] if time is None else [time]
    for one in _motion(position, velocity, stamps, (), ()):
        why = (
            "it is the one whose derivative another column is" if one.channel == "position" else ""
        )
        told.append(Chosen(one.channel, one.column, one.unit, f"{why or one.why}", sign=one.sign))
    taken = {signals[k].column for pair in found for k in pair[:2]}
    left = [s for s in signals if s.column not in taken]
    unknown = ["the columns have no names: which is torque or current, and in which unit, the log "
               "does not tell"]  # fmt: skip
    if left:
        stride = int(velocity.column) - int(position.column)
        told.append(_most_explained(left, position, stamps, stride))
    return _log(told, time, label, tuple(numbers), where, unknown)
