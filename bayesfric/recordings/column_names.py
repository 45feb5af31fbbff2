"""What the name of a column says: which signal, of which joint, in which unit."""

from __future__ import annotations

import re
from dataclasses import dataclass

from bayesfric.recordings import units

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
    words = name_words(text.rpartition("/")[2].replace("i_q", "iq").replace("I_q", "Iq"))
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


def name_words(name: str) -> list[str]:
    """Split a name at underscores, blanks and capitals, into words in small letters."""
    return [part.lower() for part in _PARTS.findall(name)]


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
