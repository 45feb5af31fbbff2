"""Recognition of the columns of a log by their names and units."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from bayesfric.base.errors import BadInput, Unfit, nearest
from bayesfric.recordings import checks, units
from bayesfric.recordings.arrays import Array
from bayesfric.recordings.measurement import implausible
from bayesfric.recordings.tables import Table, as_dates
from bayesfric.recordings.units import OPEN

_DRIVES = ("torque", "current", "voltage")
# Words for each channel, the most specific first.
_WORDS = {
    "time": "time timestamp timestamps t ts stamp stamps clock elapsed seconds millis micros "
    "received tout datetime date tick zeit dt",
    "position": "position positions pos q qpos angle theta phi encoder enc qm state counts ticks",
    "velocity": "velocity velocities vel qd dq qvel qdot thetadot speed omega v",
    "torque": "torque torques tau effort efforts trq moment force load",
    "current": "current currents iq curr cur amps ampere i",
    "voltage": "voltage volts volt pwm duty u",
    # not what was measured, or not of the joint
    "wanted": "target desired goal command commanded cmd ref reference setpoint des sp action "
    "demand planned set soll nominal expected model sim error limit max min bus input supply "
    "temperature temp",
    "measured": "actual act measured meas present feedback pv is ist",
    # no name of a joint
    "": "joint joints j motor observation observations obs header in the output axis data value "
    "values signal log electrical control raw estimate est sum of",
}
# Words that count only as the whole name.
_LETTERS = {"t", "v", "i", "u", "counts", "ticks"}
# Added to the rank of a name that says measured, and of one known by its unit or first letter only.
_MEASURED, _UNSURE = -100, 100
_KINDS: dict[str, tuple[units.Kind, ...]] = {
    "time": ("time",),
    "position": ("angle", "length"),
    "velocity": ("angular_speed", "speed"),
    "torque": ("torque", "force"),
    "current": ("current",),
    "voltage": ("voltage",),
}
# Symbols in names, in small letters, and the unit that each is, after any prefix.
_SYMBOLS = {"sec": "s", "nm": "N m", "n m": "N m", "a": "A", "amp": "A", "v": "V"}
_SYMBOLS |= {symbol: symbol for symbol in ("s", "rad", "deg", "rpm")}
_PREFIXES = {"": "", "µ": "u", "μ": "u"} | {p: p for p in ("n", "u", "m", "c", "d", "da", "h", "k")}
_ANGLES = ("rad", "radian", "radians", "deg", "degree", "degrees", "turn", "turns", "rev", "revs")
_POUNDS = [(a, b) for a in ("lb", "lbf", "lbs", "oz", "ozf") for b in ("in", "ft")]
_POUNDS += [(b, a) for a, b in _POUNDS] + [("kg", "cm"), ("kgf", "cm")]
# Units in names, as names write them: a link, a hand, a foot, a toe or a quad is none.
_SPELT = {
    **{f"{p}{word}": f"{x}{unit}" for word, unit in _SYMBOLS.items() for p, x in _PREFIXES.items()},
    **{word: word for word in ("secs", "second", "rps", "dps", "amps", "ampere", "amperes", "°")},
    **{word: word for word in (*_ANGLES, "rotations", "volt", "volts", "mm", "lbf", "kgf")},
    **{f"{p}seconds": f"{p}seconds" for p in ("", "milli", "micro", "nano")},
    **{"millis": "ms", "micros": "us", "m s": "m/s", "mm s": "mm/s", "nmm": "N mm", "ncm": "N cm"},
    **{"metre": "m", "newton": "N", "rads": "rad/s", "radps": "rad/s", "degs": "deg/s"},
    **{"degps": "deg/s", **{f"{a}{gap}{b}": f"{a} {b}" for a, b in _POUNDS for gap in (" ", "")}},
    **{f"{angle} {time}": f"{angle}/{time}" for angle in _ANGLES for time in ("s", "sec", "min")},
}
# Words that are units in one language or trade, and another elsewhere.
_AMBIGUOUS = {"grad", "mil"}
_WORD = re.compile(r"[a-z]{3,}")
_CHANNEL = {
    word: (channel, rank) for channel in _KINDS for rank, word in enumerate(_WORDS[channel].split())
}
_BRACKETS = re.compile(r"[\[(]([^\[\]()]*)[\])]\s*$")
_FACTOR = re.compile(r"\d\.?\d*[A-Za-zµμ°]+$")  # a number before the unit at a name's end
_LONG_PREFIXES = {"nano", "micro", "milli", "centi", "deci", "deca", "hecto", "kilo", "mega"}
_PARTS = re.compile(r"[a-zµμ]{0,2}(?:Nm|[AV])(?![A-Za-z])|[A-Z]?[a-zµμ]+|[A-Z]+(?![a-z])|\d+|°")
_NO_PLACE = {*_WORDS["time"].split(), *_SPELT}  # words of time stamps that say not of what
# The last part of a path, behind a slash or a dot: Axis.ActPos, not N.m or Time.1.
_PATH = re.compile(r"(.*[^N\s])[/.](?!\d|m?s(?:ec)?$)([^/.]+)")
# Names that write N_m, MNm, rad/s or rad_per_s; and a single m or N behind a whole word.
_WRITTEN = (
    (re.compile(r"(?<=N)[ _.·*-](?=m(?![a-z]))"), ""),
    (re.compile(r"[GM](?=Nm)"), "mega "),
    (re.compile(r"_per_|/(?=s$)"), "_"),
    (re.compile(r"(?i)(?<=position)_m$"), "_metre"),
    (re.compile(r"(?<=ffort|force)_N$"), "_newton"),
)
# Parts of a second beside a column of seconds: header.stamp.sec and header.stamp.nanosec.
_PART_OF_SECOND = re.compile(r"(?i)(.*?)(n|u|µ|nano|micro)_?s(?:ec(?:ond)?s?)?")
_SECONDS = ("sec", "secs", "s", "seconds", "second")
# Objects of a drive by CiA 402, and what names say of them.
_OBJECTS = {"6064": "position", "606C": "velocity", "6077": "torque", "6078": "current"}
_OBJECTS |= {"607A": "target_position", "60FF": "target_velocity", "6071": "target_torque"}
_OBJECT = re.compile(rf"(?i)(?<![0-9a-z])(?:0x)?({'|'.join(_OBJECTS)})h?(?![0-9a-z])")


Choice = tuple[str | int, str]  # column, or its number, and its unit, empty if unknown


@dataclass(frozen=True)
class Log:
    """Recognised columns of a log."""

    # by channel
    chosen: dict[str, Choice]
    columns: tuple[str | int, ...]  # all columns
    joint: str = ""  # chosen of several
    joints: tuple[str, ...] = ()
    where: dict[str, float] = field(default_factory=dict)  # rows of the first recording of several
    problems: tuple[str, ...] = ()  # what is wrong with the chosen columns
    decoding: dict[str, tuple[str, int]] = field(default_factory=dict)  # key and bit, by channel


class Named(NamedTuple):
    """Meaning of a column's name."""

    channel: str  # key of a channel, empty if nothing is recognised
    rank: int  # lower is surer
    wanted: bool  # whether it is a command, not measured
    joint: str  # empty if unknown
    unit: str  # empty if unknown


_TICKS = Named("time", _UNSURE, False, "", "")


def recognise(table: Table, joint: str | None = None) -> Log:
    """Choose the columns of one joint, which may be named, by their names."""
    table, where = _one_episode(table)
    problems = dict[str | int, str]()
    signals = [s for s in _signals(table, problems) if not s[2].wanted]
    signals.sort(key=lambda s: s[2].rank)
    ranges = dict[str, float]()
    for _, values, name in signals:
        if name.channel == "position":
            ranges.setdefault(name.joint, float(np.nanmax(values) - np.nanmin(values)))
    if joint is None:  # a constant column is no torque; a joint that is named may stand still
        signals = [s for s in signals if s[2].channel not in _DRIVES or not _is_constant(s[1])]
    joints, least = tuple(ranges), 0.01 * max(ranges.values(), default=0.0)
    # a joint that stands still says nothing; noise of its encoder is no motion
    moving = (j for j in joints if ranges[j] > least) if joint is None else joints
    # joint_2 is joint 2
    wanted = () if joint is None else (joint.lower(), named(f"{joint} position").joint)
    eligible = [j for j in moving if joint is None or j.lower() in wanted]
    # that of which most is recorded: theta_m with omega_m, not theta_el
    channels = {j: len({s[2].channel for s in signals if s[2].joint == j}) for j in eligible}
    label = max(eligible, key=lambda j: channels[j], default=None)
    if label is None and joint is not None:
        where_not = f"{table.where}, --joint {joint}"
        raise BadInput(where_not, "there is no such joint", nearest(joint, joints))
    label = label or ""
    chosen = dict[str, Choice]()
    decoding = dict[str, tuple[str, int]]()
    for channel in ("position", "velocity", *_DRIVES, "time"):
        if channel in _DRIVES and not chosen.keys().isdisjoint(_DRIVES):
            continue
        named_so = [s for s in signals if s[2].channel == channel]
        fitting = _of_joint(named_so, label)
        if channel == "time":  # what else its name has is of a computer, not of a joint
            clocks = _clocks(named_so)
            clock = next((table.clock(c) for c, _ in chosen.values() if c != OPEN), None)
            fitting = [s for s in clocks if s[0] == clock] or _of_joint(clocks, label) or clocks
        if fitting:
            column, values, name = fitting[0]
            equal = [(c, x) for c, x, n in fitting if n.rank == name.rank and not _is_constant(x)]
            rivals = [c for c, x in equal if not np.array_equal(x, values, equal_nan=True)]
            if rivals and channel != "time":
                problems[OPEN] = f"the {channel}: {' or '.join([column, *rivals])}, which differ"
                column, name = OPEN, name._replace(unit="")
            chosen[channel] = column, name.unit
            if channel != "time" and column != OPEN and (code := checks.sign_code(values)):
                key, bit, sentence = code
                decoding[channel] = key, bit
                problems.setdefault(column, f"{channel}: {sentence}; its sign is taken as a bit")
    if "time" not in chosen and (steady := _steady(table, {c for c, _ in chosen.values()})):
        if len(steady) > 1:
            problems[OPEN] = f"the time: {' or '.join(map(str, steady))}, which increase steadily"
        chosen["time"] = steady[0] if len(steady) == 1 else OPEN, ""
    columns = tuple(name or number for number, name in enumerate(table.names, start=1))
    if chosen.get("time", (OPEN, ""))[0] != OPEN:
        chosen = {"time": _checked_time(table, chosen.pop("time"), chosen, problems), **chosen}
    taken = [column for column, _ in chosen.values()]
    wrong = tuple(problems[column] for column in dict.fromkeys(taken) if column in problems)
    # a column that names no joint is none to choose
    joints = tuple(filter(None, joints)) * (len(joints) > 1)
    return Log(chosen, columns, label, joints, where, wrong, decoding)


Signals = list[tuple[str, Array, "Named"]]


def _clocks(signals: Signals) -> Signals:
    """Sort the columns of time, increasing ones first; none that stands still, or is a latency."""
    faults = list[tuple[int, bool, int]]()
    for k, (column, values, _) in enumerate(signals):
        if not _is_constant(values):
            steps = np.diff(checks.unwrapped(values)[0][np.isfinite(values)])
            fault = 2 if np.any(steps < 0.0) else int(np.mean(steps == 0.0) > 0.5)
            faults.append((fault, " + " not in column, k))
    return [signals[k] for x, _, k in sorted(faults) if x < 2 or signals[k][2].rank < _UNSURE]


def _steady(table: Table, excluded: Collection[str | int]) -> list[str | int]:
    """List columns of no other meaning that increase steadily; numbers of rows if no others do."""
    clocks = list[tuple[bool, str | int]]()
    for number, name in enumerate(table.names, start=1):
        meaning, key = named(name), name or number
        if key in excluded or meaning.wanted or meaning.channel:
            continue
        with suppress(BadInput):
            if (steps := increases(table.values(key))) is not None:
                clocks.append((bool(np.all(steps == 1.0)), key))
    return [key for counts, key in clocks if counts == min(clocks)[0]]


def increases(values: Array, *, steadily: float = 0.9) -> Array | None:
    """Return the steps of a column that increases, most of them equal, as those of a clock."""
    steps = np.diff(values[np.isfinite(values)])
    if steps.size < 2 or steps.min() <= 0.0:
        return None
    regular = np.abs(steps - np.median(steps)) < 0.5 * np.median(steps)
    return steps if np.mean(regular) > steadily else None


def _is_constant(values: Array) -> bool:
    return not np.nanmax(values) > np.nanmin(values)


def with_clocks(table: Table) -> Table:
    """Pair columns with the stamps that share their group, word or number, if stamps differ."""
    table = _with_sums(table)
    marks = list(table.units or [""] * len(table.names))
    times, suffixed, dates = dict[str, Array](), dict[str, Array](), dict[str, np.datetime64]()
    for k, name in enumerate(table.names):
        meaning = named(name, marks[k])
        is_time = meaning.channel == "time" and not meaning.wanted
        if (is_time or name.endswith("_t")) and table.names.count(name) == 1:
            with suppress(BadInput):
                if (stamps := as_dates(table.cells(name))) is not None and stamps.dtype.kind == "M":
                    dates[name], marks[k] = stamps[~np.isnat(stamps)].min(), "s"
                    continue
                if not is_time and increases(table.values(name)) is not None:
                    suffixed[name] = table.values(name)
                time = table.values(name) * units.scale([meaning.unit or "s"], "time")
                if is_time and time.size > 1 and np.all(np.diff(time) > 0.0):
                    times[name], marks[k] = time, meaning.unit
    if len(dates) > 1 and not times:
        table = replace(table, epoch=min(dates.values()), units=marks)
        times = {name: table.values(name) for name in dates}
    times = times or suffixed  # of q_t, q, tau_t and tau
    clocks = list[str]()
    for name, time in times.items():
        if not any(_as_one(time, times[other]) for other in clocks):
            clocks.append(name)
    if len(clocks) < 2 or len({marks[table.names.index(name)] == "" for name in clocks}) > 1:
        return table
    grouped = any(_divided(name)[0] for name in table.names)
    pairs, unpaired = dict[str, str](), dict[str, str]()
    for name in (name for name in table.names if name not in times):
        words = _place(name, grouped)
        common = {clock: words & _place(clock, grouped) - _NO_PLACE for clock in clocks}
        shared = sorted((len(common[clock]), clock) for clock in clocks)
        if shared[-1][0] > shared[-2][0]:
            pairs[name] = shared[-1][1]
        elif named(name).channel:
            unpaired[name] = ", ".join(clocks)
    return replace(table, clocks=pairs, unpaired=unpaired, units=marks)


def _with_sums(table: Table) -> Table:
    """Add columns of time: seconds and their parts in another column, and sums of its steps."""
    sums, marks = dict[str, Array](), list[str]()
    names = [name for name in table.names if table.names.count(name) == 1]
    clocks = [name for name in names if named(name).channel == "time"]
    for name in names:
        part = _PART_OF_SECOND.fullmatch(name)
        of_seconds = next((x for s in _SECONDS if part and (x := f"{part[1]}{s}") in names), None)
        with suppress(BadInput):
            if part and of_seconds is not None:
                seconds, unit = table.values(of_seconds), "ns" if part[2][0] in "nN" else "us"
                share = table.values(name) * units.scale([unit], "time")
                if np.nanmax(share) < 1.0 and not np.any(seconds % 1.0 > 0.0):
                    sums[f"{of_seconds} + {name}"] = seconds - seconds[0] + share
                    marks.append("s")
            elif clocks == [name] and {"dt"} & {*_PARTS.findall(name.lower())}:
                steps = table.values(name)
                if np.all(steps > 0.0):
                    sums[f"sum of {name}"] = np.cumsum(steps) - steps[0]
                    marks.append(named(name).unit)
    if not sums:
        return table
    load, count, columns = table.load, len(table.names), list(sums.values())
    return replace(
        table,
        names=[*table.names, *sums],
        load=lambda index: load(index) if index < count else columns[index - count],
        units=[*(table.units or [""] * count), *marks],
    )


def _as_one(time: Array, other: Array) -> bool:
    """Whether stamps are the same, or of other epochs, by which nothing can be paired."""
    if time[-1] < other[0] or other[-1] < time[0]:
        return True
    half = 0.5 * float(np.median(np.diff(time)))
    return time.size == other.size and bool(np.all(np.abs(time - other) < half))


def _place(name: str, grouped: bool) -> set[str]:
    """Return the words and numbers of a column's name, and its group, if the table has any."""
    return {*map(str.lower, _PARTS.findall(name)), *([f"{_divided(name)[0]}/"] * grouped)}


def _divided(name: str) -> tuple[str, str]:
    """Split a path before its last part."""
    divided = _PATH.fullmatch(name)
    return (divided[1], divided[2]) if divided else ("", name)


def _of_joint(signals: Signals, label: str) -> Signals:
    """Select the columns of a joint, else those of none, or all, if no two differ in it."""
    for joint in (label, ""):
        if matching := [s for s in signals if s[2].joint == joint]:
            return matching
    same = len({name.joint for _, _, name in signals}) == 1
    return signals if same and not label else []


def _checked_time(
    table: Table, time: Choice, chosen: dict[str, Choice], problems: dict[str | int, str]
) -> Choice:
    """Return time's column and its unit, open where no joint is recorded so; says what is wrong."""
    column, unit = time
    if column in problems:
        return column, unit
    try:
        columns = [name for name, _ in chosen.values() if name != OPEN]
        once = table.without_repeats(columns, column)
        stamps = once.decoded({column: checks.unwrapped(once.values(column))[0]}, ()).stamps(column)
    except BadInput as error:
        problems[column] = str(error)
        return column, unit
    stamps = stamps[np.isfinite(stamps)]
    scale = units.scale([unit or "s"], "time")
    period = scale * float(np.median(np.diff(stamps)))
    if unit and implausible(period, scale * float(np.ptp(stamps))):
        text = f"time: in {unit} its rows are {period:.3g} s apart, of no joint's motion"
        problems[column], unit = text, ""
    return column, unit


def _one_episode(table: Table) -> tuple[Table, dict[str, float]]:
    """Select the first of several recordings in a log, where a column numbers them."""
    for name in ("episode_index", "episode", "episode_id", "run", "trial"):
        with suppress(BadInput):  # there is none, or it holds text
            numbers = table.column(name)
            if numbers.size and np.ptp(numbers) > 0.0:
                where = {name: float(numbers[0])}
                return table.only(where), where
    return table, {}


def _signals(table: Table, problems: dict[str | int, str]) -> Iterator[tuple[str, Array, Named]]:
    """Read the columns of recognised names: vectors, and parts of wider columns."""
    for name, written in zip(table.names, table.units or [""] * len(table.names), strict=True):
        if name in table.clocks.values() and named(name, written).channel != "time":
            yield name, table.values(name), _TICKS
            continue
        if not named(name, written).channel:
            if name and table.is_dated(name):
                yield name, table.values(name), Named("time", _UNSURE, False, "", "s")
            continue
        try:
            if named(name, written).channel == "time" and table.is_dated(name):
                written = "s"
            values, meaning = _numbers(table, name, problems), named(name, written)
            if name.lower() in _LETTERS and meaning.channel == "position" and len(name) > 1:
                # counts of an encoder, or of a clock
                meaning = meaning if increases(values) is None else _TICKS
            yield name, values, meaning
            continue
        except BadInput as error:
            problems[name] = str(error)
        # a message that names its joints may have them in any order
        if any(other.startswith((f"{name}[", f"{name}.")) for other in table.names):
            continue
        with suppress(BadInput):  # it holds no numbers
            for key in table.signals(name):
                yield key, _numbers(table, key, problems), named(key, written)


def _numbers(table: Table, key: str, problems: dict[str | int, str]) -> Array:
    """Return a column ``(n,)``, NaN where it has no number, and say which cell holds another."""
    values, rows = table.values(key), np.flatnonzero(~table.holes(key))
    if np.isfinite(values).sum() < max(2.0, 0.5 * rows.size):
        raise BadInput(table.label(key), "holds no numbers", "check the export")
    try:
        table.at(rows, values.size).column(key)
    except BadInput as error:
        problems[key] = str(error)
    return values


def named(name: str, written: str = "") -> Named:
    """Parse a column's name, and the unit ``written`` in the file; the last known word counts."""
    text, inside = name.partition(" + ")[0].strip(), ""
    if brackets := _BRACKETS.search(text):
        text, inside = text[: brackets.start()], brackets[1].strip()
    text = _OBJECT.sub(lambda index: _OBJECTS[index[1].upper()], text)
    for pattern, replacement in _WRITTEN:
        text = pattern.sub(replacement, text)
    text = text.replace("i_q", "iq").replace("I_q", "Iq")
    words = [part.lower() for part in _PARTS.findall(text)]
    last = [part.lower() for part in _PARTS.findall(_divided(text)[1])]
    alone = sum(not word.isdecimal() for word in last) == 1
    known = [
        k
        for k, w in enumerate(words)
        if w in _CHANNEL and (w not in _LETTERS or alone or _unit_in_name(_CHANNEL[w][0], last[1:]))
    ]
    if _divided(text)[1].startswith(("t_", "t ")):  # t_enc is a time
        known.append(len(words) - len(last))
    if not known:
        return _named_by_unit(words, inside, written)
    channel, rank = _CHANNEL[words[known[-1]]]
    synonyms = _WORDS[channel].split()
    after = [w for w in words[known[-1] + 1 :] if w not in synonyms]
    left = [w for w in words[: known[-1]] if w not in synonyms] + after
    # a unit stands after the word of its signal, or is that word
    texts = [(" ".join(after[-n:]), n) for n in (2, 1) if len(after) >= n]
    if not _LONG_PREFIXES.isdisjoint(left):
        texts = []
    used = next((n for text, n in texts if _unit_in_name(channel, text.split())), 0)
    unit = _unit_of(channel, written) or _unit_of(channel, inside)
    if not unit and not written and not _FACTOR.search(text):
        unit = _unit_in_name(channel, after[-used:] if used else [words[known[-1]]])
    all_words = " ".join(_WORDS.values()).split()
    label = [w for w in left[: len(left) - used] if w not in all_words]
    label += [inside] if inside and not _unit_of(channel, inside) else []
    wanted = any(w in _WORDS["wanted"].split() for w in left)
    rank += _MEASURED * (not {*left}.isdisjoint(_WORDS["measured"].split()))
    return Named(channel, rank, wanted, " ".join(label), unit)


def _named_by_unit(words: Sequence[str], inside: str, written: str) -> Named:
    """Name a column by a unit of one channel only; of its words a number may be its joint's."""
    ends = [" ".join(words[-n:]) for n in (2, 1) if len(words) >= n]
    texts = [written, inside, *(_SPELT.get(end, "") for end in ends if len(end) > 1)]
    for text in filter(None, texts):
        fitting = [(channel, unit) for channel in _KINDS if (unit := _unit_of(channel, text))]
        if len(fitting) == 1:
            wanted = not {*_WORDS["wanted"].split()}.isdisjoint(words)
            label = " ".join(word for word in words if word.isdecimal())
            return Named(fitting[0][0], _UNSURE, wanted, label, fitting[0][1])
    return Named("", 0, False, inside, "")


def _unit_in_name(channel: str, words: Sequence[str]) -> str:
    """Return the unit that some words of a name spell; empty where they spell none of its kind."""
    return _unit_of(channel, _SPELT.get(" ".join(words), ""))


def _unit_of(channel: str, text: str) -> str:
    """Return a unit as in a configuration; empty where it is not of the channel's kind.

    Also where it is a word for something else, or no joint is measured in it, as in megaseconds.
    """
    text = text.strip().strip("[]()").strip()
    if text.lower() in _AMBIGUOUS or (_WORD.fullmatch(text) and text not in _SPELT):
        return ""
    short = text if text.startswith("M") else text.lower()
    for spelt in dict.fromkeys((_SPELT.get(short, text), text)):
        is_unit = any(map(str.isalpha, spelt)) or "°" in spelt
        with suppress(Unfit):
            if is_unit:
                return spelt if abs(units.quantity(spelt, *_KINDS[channel])) <= 1e3 else ""
    return ""
